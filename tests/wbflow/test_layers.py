"""The engine does not know the vision: stages and what is in their results are named in the pipeline's table only."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import wbflow
from wbflow.graph.pipeline import STAGES

ENGINE = Path(wbflow.__file__).parent
SOURCES = sorted(path for path in ENGINE.rglob("*.py") if path.name != "pipeline.py")

CONTRACTS = {
    "config/load.py": {"pairs"},  # the section of the site file
    "config/explain.py": {"pairs"},
    "results/pair.py": {"pairs"},
    "graph/exports.py": {"depth", "matches", "geometry", "disparity", "frames", "poses"},  # options of export, argument names
    "store/record.py": {"pairs", "poses", "health"},  # keys of run.json
    "store/reference.py": {"pairs"},  # keys of reference.json
}
"""Words of the site file, the command line and the files that a run leaves, which happen to be names of stages too."""


def texts(tree: ast.AST) -> Iterator[str]:
    """String literals of a module, docstrings left out."""
    docs = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
    yield from (n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str) and id(n) not in docs)


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ENGINE)))
def test_no_stage_is_named_outside_the_pipeline(path: Path) -> None:
    names = {stage.name for stage in STAGES} - CONTRACTS.get(str(path.relative_to(ENGINE)), set())
    named = {text for text in texts(ast.parse(path.read_text())) if text.split(" ")[0] in names and len(text.split()) <= 2}
    assert named == set()


@pytest.mark.parametrize("file", CONTRACTS)
def test_every_exception_is_still_one(file: str) -> None:
    said = {text.split(" ")[0] for text in texts(ast.parse((ENGINE / file).read_text()))}
    assert CONTRACTS[file] <= said

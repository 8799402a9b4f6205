"""How the engine's house stands: who spells paths, who imports whom, who swallows what."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import wbflow

HOUSE = Path(wbflow.__file__).parent
FILES = sorted(HOUSE.rglob("*.py"))
LAYERS = ("errors", "task", "store", "graph", "config", "night", "results", "api", "screen", "cli")
"""Who may import whom: each only what stands before it."""
PATHS = r"""(?x)^(
    cache | runs | latest | latest-good | quarantine | lock | \.writing | \.wbflow
    | run\.json | log\.jsonl | cameras\.json | report\.html | ledger\.sqlite.* | captures\.json | functions\.json
    | cloud.*\.ply | .*\.tmp | \.?jpg | \.drawn | \.published)$"""
OWNER = HOUSE / "store" / "layout.py"
OTHERS = {
    HOUSE / "results" / "demo.py": {"cameras.json", ".jpg"},  # of the demo's own folder
    HOUSE / "results" / "init.py": {".jpg"},  # photographs
    HOUSE / "store" / "atomic.py": {".tmp"},
}
"""What looks like a path of the work folder elsewhere, and is none."""


def literals(tree: ast.Module) -> Iterator[str]:
    """Strings of a module, without docstrings."""
    told = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            told.add(node.value)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in told:
            yield node.value


def spelled(source: str) -> set[str]:
    """Paths of the work folder in a module's strings, alone or as parts of a path."""
    parts = (part for text in literals(ast.parse(source)) if " " not in text for part in text.split("/"))
    return {part for part in parts if re.match(PATHS, part)}


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("x = work / 'runs' / name", {"runs"}),
        ("open(f'{folder}/log.jsonl')", {"log.jsonl"}),
        ("p.glob('runs/*/run.json')", {"runs", "run.json"}),
        ("'''of runs'''\nx = 'the cache of runs'", set()),
    ],
)
def test_a_path_that_is_spelled_is_found(source: str, found: set[str]) -> None:
    assert spelled(source) == found


def test_one_file_spells_the_paths_of_the_work_folder() -> None:
    assert len(spelled(OWNER.read_text())) > 10
    elsewhere = {
        file.relative_to(HOUSE): found
        for file in FILES
        if file != OWNER and (found := spelled(file.read_text()) - OTHERS.get(file, set()))
    }
    assert elsewhere == {}


def imported(file: Path) -> Iterator[str]:
    """Rooms of the engine that a file imports from anywhere in it."""
    package = ["wbflow", *file.relative_to(HOUSE).parts[:-1]]
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            full = [*base, *(node.module or "").split(".")] if node.module else base
            names = [full[1]] if len(full) > 1 else [alias.name for alias in node.names]
            yield from (name for name in names if full[0] == "wbflow" and name in LAYERS)


@pytest.mark.parametrize(
    "file", [f for f in FILES if f.parent != HOUSE or f.stem in LAYERS], ids=lambda f: str(f.relative_to(HOUSE))
)
def test_imports_run_one_way(file: Path) -> None:
    room = file.relative_to(HOUSE).parts[0].removesuffix(".py")
    assert [name for name in imported(file) if LAYERS.index(name) > LAYERS.index(room)] == []


def test_the_engine_imports_no_vision_library() -> None:
    heavy = re.compile(r"^\s*(?:import|from) (cv2|open3d|numba|poselib|pycolmap)\b", re.M)
    found = {file.name for file in FILES if heavy.search(file.read_text())}
    assert found <= {"api.py"}, "api.py names open3d for the reader of its types only"
    assert "if TYPE_CHECKING:\n    import open3d" in (HOUSE / "api.py").read_text()


def test_everything_is_caught_in_few_places_only() -> None:
    """Around a task, its picture, the report, a stranger's module, and at the end of the command line."""
    broad = [
        str(file.relative_to(HOUSE))
        for file in FILES
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ExceptHandler) and (node.type is None or ast.unparse(node.type) in {"Exception", "BaseException"})
    ]
    broad = [name for name in broad if name != "store/atomic.py"]  # which clears away its temporary file, and raises again
    assert sorted(broad) == ["cli.py", "graph/signature.py", "night/worker.py", "night/worker.py", "results/publish.py"]


@pytest.mark.parametrize("file", FILES, ids=lambda f: str(f.relative_to(HOUSE)))
def test_no_file_is_longer_than_400_lines_and_no_function_than_70(file: Path) -> None:
    source = file.read_text()
    long = [
        node.name
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and (node.end_lineno or 0) - node.lineno + 1 > 70
    ]
    assert (len(source.splitlines()) <= 400, long) == (True, [])

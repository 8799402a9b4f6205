"""The house: what is installed is what is here, imports run one way, and nothing is longer than a reader can hold."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import networkx
import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted([*ROOT.glob("wbflow/**/*.py"), *ROOT.glob("stages/**/*.py")])
EVERY_FILE = sorted([*SOURCES, *ROOT.glob("scripts/*.py"), *ROOT.glob("tests/**/*.py")])

FLOORS = [
    {"types", "reasons", "core"},
    {"twoview", "matching"},
    {"rectification", "stereo", "sfm", "mvs", "fusion"},
    {"stages", "io"},
    {"synthetic", "exports", "evaluate"},
]
"""Rooms of the vision from the ground up: each imports from its own floor and from those below it.  "stages": the stage files."""


def name_of(file: Path) -> str:
    """The dotted name of a source file; that of a folder for its `__init__.py`."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name_of(file): file for file in SOURCES}


@cache
def parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text())


def for_types_alone(tree: ast.Module) -> set[ast.AST]:
    """Nodes below `if TYPE_CHECKING`."""
    found: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            found |= {inner for statement in node.body for inner in ast.walk(statement)}
    return found


def imports(file: Path) -> Iterator[str]:
    """Dotted names that a file imports when it runs; those of other packages too."""
    package = name_of(file).split(".") if file.name == "__init__.py" else name_of(file).split(".")[:-1]
    passed = for_types_alone(parsed(file))
    for node in ast.walk(parsed(file)):
        if node in passed:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            path = ".".join([*base, *([node.module] if node.module else [])])
            # `from . import x` names the module x
            yield from (f"{path}.{alias.name}" if f"{path}.{alias.name}" in NAMES else path for alias in node.names)


def floor(name: str) -> int | None:
    """On which floor a module of the vision stands; None: the package itself, which may open any door."""
    package, _, rest = name.partition(".")
    if package != "stages" or not rest:
        return None
    room = rest.split(".")[0]
    return next(k for k, rooms in enumerate(FLOORS) if (room if any(room in r for r in FLOORS) else "stages") in rooms)


def test_every_package_is_listed_for_installation() -> None:
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    folders = {name_of(file) for file in SOURCES if file.name == "__init__.py"}
    assert listed == {folder.replace("stages", "wbflow_stages", 1) for folder in folders}


@pytest.mark.parametrize("file", SOURCES, ids=name_of)
def test_the_engine_sees_no_pixel_and_the_vision_no_engine(file: Path) -> None:
    banned = {"cv2", "open3d"} if file.is_relative_to(ROOT / "wbflow") else {"wbflow", "wbflow_stages"}
    assert not {name.split(".")[0] for name in imports(file)} & banned


def test_nothing_is_pickled() -> None:
    banned = {"pickle", "shelve", "marshal", "dill", "cloudpickle"}
    assert not [file for file in SOURCES if {name.split(".")[0] for name in imports(file)} & banned]


def test_imports_of_the_vision_run_one_way() -> None:
    upward = []
    for name, file in NAMES.items():
        here = floor(name)
        for other in imports(file) if here is not None else ():
            there = floor(other)
            if here is not None and there is not None and there > here:
                upward.append(f"{name} imports {other}")
    assert not upward


def test_no_imports_run_in_circles() -> None:
    graph = networkx.DiGraph()
    modules = {name for name, file in NAMES.items() if file.name != "__init__.py"}  # packages open their doors when asked
    for name in modules:
        graph.add_edges_from((name, other) for other in imports(NAMES[name]) if other in modules and other != name)
    assert not [sorted(circle) for circle in networkx.strongly_connected_components(graph) if len(circle) > 1]


def test_files_have_at_most_400_lines() -> None:
    long = {str(file.relative_to(ROOT)): len(file.read_text().splitlines()) for file in EVERY_FILE}
    assert not {name: lines for name, lines in long.items() if lines > 400}


def test_functions_have_at_most_70_lines() -> None:
    long = {}
    for file in EVERY_FILE:
        for node in ast.walk(parsed(file)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                if lines > 70:
                    long[f"{file.relative_to(ROOT)}:{node.name}"] = lines
    assert not long

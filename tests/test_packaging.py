"""What is installed is what is here, and the engine and the vision keep apart."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted([*ROOT.glob("wbflow/**/*.py"), *ROOT.glob("stages/**/*.py")])


def imports(file: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            found.add(node.module.split(".")[0])
    return found


def test_every_package_is_listed_for_installation() -> None:
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    folders = {file.parent.relative_to(ROOT) for file in SOURCES if file.name == "__init__.py"}
    assert listed == {".".join(folder.parts).replace("stages", "wbflow_stages", 1) for folder in folders}


@pytest.mark.parametrize("file", SOURCES, ids=lambda f: str(f.relative_to(ROOT)))
def test_the_engine_sees_no_pixel_and_the_vision_no_engine(file: Path) -> None:
    banned = {"cv2", "open3d"} if file.is_relative_to(ROOT / "wbflow") else {"wbflow", "wbflow_stages"}
    assert not imports(file) & banned


def test_nothing_is_pickled() -> None:
    assert not [file for file in SOURCES if imports(file) & {"pickle", "shelve", "marshal", "dill", "cloudpickle"}]

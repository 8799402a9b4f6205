"""What the engine and the vision share is declared once, in `wbflow_stages.contracts`; the engine imports nothing else of it."""

from __future__ import annotations

import ast
import itertools
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.test_house import CONTRACTS, ENGINE, ENGINE_FILES, ROOT, SOURCES, VISION, imports, parsed
from wbflow_stages.contracts.stated import LensModel
from wbflow_stages.core.lenses import PROJECTIONS

FEWEST_SHARED = 3
"""Dataclasses with fewer common names of fields have nothing in common."""
HEAVY = {"numpy", "cv2", "numba", "open3d", "pycolmap", "scipy", "pydantic"}


def dataclass_fields(file: Path) -> Iterator[tuple[str, frozenset[str]]]:
    """Name and fields of each dataclass of a file; inherited fields do not count."""
    for node in ast.walk(parsed(file)):
        if isinstance(node, ast.ClassDef) and any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list):
            annotated = [inner.target for inner in node.body if isinstance(inner, ast.AnnAssign)]
            fields = frozenset(target.id for target in annotated if isinstance(target, ast.Name))
            yield f"{file.relative_to(ROOT)}:{node.name}", fields


def are_alike(one: frozenset[str], other: frozenset[str]) -> bool:
    """Do two dataclasses share most of their fields?"""
    shared = len(one & other)
    return shared >= FEWEST_SHARED and 2 * shared > max(len(one), len(other))


def test_dataclasses_that_share_most_of_their_fields_are_found() -> None:
    lens = frozenset({"K", "distortion", "width", "height"})
    assert are_alike(lens, lens - {"K"} | {"model"})
    assert not are_alike(lens, frozenset({"width", "height", "name", "x"}))


def test_no_dataclass_of_the_engine_repeats_one_of_the_vision() -> None:
    engine = [entry for file in ENGINE_FILES for entry in dataclass_fields(file)]
    vision = [entry for file in SOURCES if file.is_relative_to(VISION) for entry in dataclass_fields(file)]
    assert len(engine) > 50 and len(vision) > 50
    pairs = itertools.product(engine, vision)
    alike = [(one, other) for (one, fields), (other, others) in pairs if are_alike(fields, others)]
    # both say what was measured, what was expected, and what to do about it: one of a camera's state, the other of a whole night
    assert alike == [("wbflow/records/findings.py:Finding", "stages/contracts/camera_figures.py:Health")]


def test_no_result_of_the_vision_repeats_its_figures() -> None:
    results = [entry for file in SOURCES if file.is_relative_to(VISION / "types") for entry in dataclass_fields(file)]
    contracts = [entry for file in SOURCES if file.is_relative_to(VISION / "contracts") for entry in dataclass_fields(file)]
    pairs = itertools.product(results, contracts)
    alike = [(one, other) for (one, fields), (other, others) in pairs if are_alike(fields, others)]
    # as arrays, an empty history has a default
    assert alike == [("stages/types/health.py:ShiftHistory", "stages/contracts/camera_figures.py:ShiftHistory")]


def numeric_defaults(file: Path) -> Iterator[tuple[str, float]]:
    """Name and value of parameters behind a bare * and of fields of the site file, whose default is written as a number."""
    for node in ast.walk(parsed(file)):
        if isinstance(node, ast.FunctionDef):
            for argument, default in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True):
                if isinstance(default, ast.Constant) and type(default.value) in {int, float}:
                    yield argument.arg, float(str(default.value))
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and isinstance(node.value, ast.Call):
            for word in node.value.keywords:
                if word.arg == "default" and isinstance(word.value, ast.Constant) and type(word.value.value) in {int, float}:
                    yield node.target.id, float(str(word.value.value))


def test_no_default_of_a_parameter_stands_twice() -> None:
    stage_files = [file for file in SOURCES if file.is_relative_to(VISION)]
    counts = Counter(entry for file in [*stage_files, *ENGINE_FILES] for entry in numeric_defaults(file))
    counts[("seconds", 60.0)] = 0  # time limits of a burst of captures and of a command, which have nothing in common
    assert len(counts) > 40
    assert {entry for entry, count in counts.items() if count > 1} == set()


def test_engine_and_vision_names_of_lens_models_are_the_same() -> None:
    assert list(PROJECTIONS) == list(LensModel)


@pytest.mark.parametrize("file", ENGINE_FILES, ids=lambda file: str(file.relative_to(ENGINE)))
def test_the_engine_imports_of_the_vision_only_the_contracts(file: Path) -> None:
    vision = {name for name in imports(file, types_too=True) if name.split(".")[0] == "wbflow_stages"}
    assert all(name.startswith(CONTRACTS) for name in vision)


def test_contracts_need_no_library() -> None:
    modules = [f"{CONTRACTS}.{file.stem}" for file in (VISION / "contracts").glob("[a-z]*.py")]
    program = f"import sys, importlib; [importlib.import_module(name) for name in {modules}]; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not HEAVY & {name.split(".")[0] for name in done.stdout.split()}


RENAMES = (
    ("contracts/pair_figures.py", "vertical_px", "row_offset_px"),
    ("contracts/ground_figures.py", "sample_counts", "samples"),
)
"""File of the vision, a field there, and another name for it."""


@pytest.mark.parametrize(("name", "field", "other"), RENAMES)
def test_mypy_finds_a_figure_that_is_renamed_in_the_contracts_alone(tmp_path: Path, name: str, field: str, other: str) -> None:
    """Both halves read the renamed dataclass, so that mypy finds what still uses the old name."""
    for package in ("wbflow", "stages"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "wbflow_stages").symlink_to("stages")
    contract = tmp_path / "stages" / name
    text = contract.read_text()
    assert re.search(rf"^    {field}: ", text, re.MULTILINE)
    contract.write_text(re.sub(rf"^    {field}: ", f"    {other}: ", text, flags=re.MULTILINE))
    users = []
    for file in [*ENGINE_FILES, *(file for file in SOURCES if file.is_relative_to(VISION))]:
        copy = tmp_path / file.relative_to(ROOT)
        if copy != contract and re.search(rf"\.{field}\b|\b{field}=", copy.read_text()):
            users.append(str(copy.relative_to(tmp_path)).replace("stages/", "wbflow_stages/", 1))
    command = [sys.executable, "-m", "mypy", "--follow-imports=silent", "--ignore-missing-imports", "--config-file", os.devnull]
    command += ["--cache-dir", str(tmp_path / "cache"), "--explicit-package-bases", *users]
    env = {**os.environ, "MYPYPATH": str(tmp_path), "PYTHONPATH": ""}
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    errors = [line for line in done.stdout.splitlines() if ": error: " in line and f'"{field}"' in line]
    assert errors, done.stdout

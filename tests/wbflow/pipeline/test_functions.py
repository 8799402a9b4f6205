"""Parameters and fingerprints are read from source; a change in a helper changes the fingerprint, a comment does not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from wbflow.cache.fingerprint import FunctionError
from wbflow.pipeline.functions import FunctionReader
from wbflow.pipeline.stages import STAGES


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / f"mine_{os.getpid()}_{tmp_path.name[-6:].replace('-', '_')}"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "helper.py").write_text('"""Doc."""\nimport numpy\nHALF = 0.5\n')
    (folder / "unused.py").write_text("x = 1\n")
    (folder / "stage.py").write_text(
        "from typing import Literal\n"
        "from .helper import HALF\n"
        'Mode = Literal["fast", "good"]\n'
        'def work(left, right, *, mode: Mode = "fast", n: int = 3, share: float | None = None, flag: bool = True):\n'
        '    """Doc."""\n    return HALF\n'
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    return folder


def code(package: Path) -> str:
    return FunctionReader().code(f"{package.name}.stage:work")


def test_parameters_have_defaults_and_are_checked_by_type_and_choice(package: Path) -> None:
    parameters = FunctionReader().signature(f"{package.name}.stage:work").parameters
    assert {name: p.default for name, p in parameters.items()} == {"mode": "fast", "n": 3, "share": None, "flag": True}
    assert parameters["mode"].problem("good") is None
    assert "not one of fast, good" in str(parameters["mode"].problem("best"))
    assert parameters["n"].problem(True) is not None
    assert parameters["n"].problem(2.5) is not None
    assert parameters["share"].problem(None) is None
    assert parameters["share"].problem(1) is None


@pytest.mark.parametrize(
    ("more", "default"),
    [
        ("def other():\n    COUNT = 4\n    return COUNT\n", 3),  # a name of its own
        ("def other():\n    global COUNT\n    COUNT = 4\n", None),
        ("if HALF:\n    COUNT = 4\n", None),
        ("for COUNT in range(2):\n    pass\n", None),
    ],
)
def test_a_constant_is_a_default_only_if_it_is_assigned_once(package: Path, more: str, default: int | None) -> None:
    text = f"from .helper import HALF\nCOUNT = 3\n{more}def work(left, right, *, n: int = COUNT):\n    return n\n"
    (package / "stage.py").write_text(text)
    parameter = FunctionReader().signature(f"{package.name}.stage:work").parameters["n"]
    assert (parameter.default, parameter.source) == (default, "" if default else "COUNT")


def test_a_helper_changes_the_fingerprint_and_a_comment_does_not(package: Path) -> None:
    before = code(package)
    helper = package / "helper.py"
    helper.write_text('"""Another doc."""\n# and a comment\nimport numpy\n\nHALF = 0.5\n')
    (package / "unused.py").write_text("x = 2\n")
    assert code(package) == before
    helper.write_text("import numpy\nHALF = 0.6\n")
    assert code(package) != before


def test_a_remembered_module_is_read_again_when_it_changes(package: Path, tmp_path: Path) -> None:
    memo = tmp_path / "memo.json"
    name = f"{package.name}.stage:work"
    reader = FunctionReader(memo)
    before = reader.code(name), reader.signature(name)
    reader.save()
    remembered = FunctionReader(memo)
    assert (remembered.code(name), remembered.signature(name)) == before
    (package / "stage.py").write_text("def work(*, other: int = 1):\n    return 1\n")
    after = FunctionReader(memo)
    assert set(after.signature(name).parameters) == {"other"}
    assert after.code(name) != before[0]


@pytest.mark.parametrize("dotted", ["nowhere:f", "json:", "wbflow_stages.frames:no_such"])
def test_a_function_that_does_not_exist_is_refused(dotted: str) -> None:
    with pytest.raises(FunctionError):
        FunctionReader().code(dotted)
    with pytest.raises(FunctionError):
        FunctionReader().signature(dotted)


@pytest.mark.parametrize("stage", STAGES, ids=lambda s: s.name)
def test_every_stage_function_takes_the_inputs_listed_in_the_table(stage: object) -> None:
    import importlib
    import inspect

    from wbflow.pipeline.stages import Stage

    assert isinstance(stage, Stage)
    module, _, name = stage.function.partition(":")
    signature = inspect.signature(getattr(importlib.import_module(module), name))
    keyword_only = {p.name: p.default for p in signature.parameters.values() if p.kind is inspect.Parameter.KEYWORD_ONLY}
    inputs = [p for p in signature.parameters.values() if p.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD]
    assert {p.name for p in inputs if p.default is p.empty} <= set(stage.inputs) <= {p.name for p in inputs}
    read = FunctionReader().signature(stage.function).parameters
    assert {name: p.default for name, p in read.items()} == keyword_only
    assert set(keyword_only) & set(stage.inputs) == set()

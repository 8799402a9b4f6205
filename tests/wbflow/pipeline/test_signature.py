"""Signatures read from source: literal defaults are resolved wherever they are defined, others are left to the function."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wbflow.pipeline.functions import FunctionReader
from wbflow.pipeline.signature import Parameter, Signature


def signature(folder: Path, text: str, **others: str) -> Signature:
    for name, content in others.items():
        (folder / f"{name}.py").write_text(content)
    (folder / "sample.py").write_text(text)
    return FunctionReader(folder=folder).signature("sample:f")


@pytest.mark.parametrize(
    ("default", "value"),
    [("3", 3), ("-1.5", -1.5), ("[[1]]", [[1]]), ("LIMIT", 7), ("FAR", 9), ("None", None), ('{"a": 1}', {"a": 1})],
)
def test_literal_defaults_are_known_by_value(tmp_path: Path, default: str, value: object) -> None:
    text = f"from away import FAR\nLIMIT: int = 7\ndef f(*, x={default}):\n    pass\n"
    parameter = signature(tmp_path, text, away="FAR = 9\n").parameters["x"]
    assert (parameter.default, parameter.source) == (value, "")


@pytest.mark.parametrize("default", ["BASE * 2", "TWICE", "(1, 2)", "float('nan')", "SOMETIMES", "object()"])
def test_defaults_that_are_not_literals_are_left_to_the_function(tmp_path: Path, default: str) -> None:
    text = "BASE = 1\nTWICE = 1\nTWICE = 2\nif BASE:\n    SOMETIMES = 3\n" + f"def f(*, x={default}):\n    pass\n"
    assert signature(tmp_path, text).parameters["x"].source == default


@pytest.mark.parametrize(
    ("head", "annotation"),
    [
        ("from typing import Literal", 'Literal["a", "b"]'),
        ("import typing as t", 't.Literal["a", "b"]'),
        ("from typing import Literal, Optional", 'Optional[Literal["a", "b"]]'),
        ("from typing import Annotated, Literal", 'Annotated[Literal["a", "b"], "why"]'),
        ("from typing import Literal as L\nMode: object = L['a', 'b']", "Mode | None"),
        ("from away import Mode", "Mode"),
        ("from again import Mode", "Mode"),
        ("import away", "away.Mode"),
        ("if 1:\n    from typing import Literal as Only", "Only['a', 'b']"),
    ],
)
def test_choices_are_known_wherever_they_are_defined(tmp_path: Path, head: str, annotation: str) -> None:
    away = 'from typing import Literal\nMode = Literal["a", "b"]\n'
    text = f"{head}\ndef f(*, x: {annotation} = 'a'):\n    pass\n"
    parameter = signature(tmp_path, text, away=away, again="from away import Mode as Mode\n").parameters["x"]
    assert parameter.choices == ("a", "b")


def test_a_circularly_imported_annotation_accepts_any_value(tmp_path: Path) -> None:
    text = "from away import Mode\ndef f(*, x: Mode = 1):\n    pass\n"
    parameter = signature(tmp_path, text, away="from again import Mode\n", again="from away import Mode\n").parameters["x"]
    assert parameter.problem("whatever") is None


@pytest.mark.parametrize(
    ("annotation", "fits", "does_not"),
    [
        ("list[list[str]]", [["gate", "roof"]], [["gate", 1]]),
        ("tuple[float, float]", [1, 2.5], [1, 2, 3]),
        ("Sequence[int] | None", None, [1.5]),
        ("dict[str, float]", {"a": 1}, {"a": "b"}),
        ("list[Annotated[int, 'pixels']]", [1], ["a"]),
    ],
)
def test_nested_values_are_checked(tmp_path: Path, annotation: str, fits: object, does_not: object) -> None:
    head = "from collections.abc import Sequence\nfrom typing import Annotated\n"
    parameter = signature(tmp_path, f"{head}def f(*, x: {annotation}):\n    pass\n").parameters["x"]
    assert parameter.problem(fits) is None
    assert parameter.problem(does_not) is not None


@pytest.mark.parametrize("annotation", ["Path", "list['Path']", "Itself", "1 / 0", "'no type'"])
@pytest.mark.parametrize("value", ["a", None, [1]])
def test_classes_and_annotations_that_are_no_types_accept_any_value(tmp_path: Path, annotation: str, value: object) -> None:
    text = f"from pathlib import Path\nItself = Itself\ndef f(*, x: {annotation}, y=Itself):\n    pass\n"
    assert signature(tmp_path, text).parameters["x"].problem(value) is None


def test_a_union_of_a_type_and_choices_accepts_both() -> None:
    parameter = Parameter("x", "auto", annotation="float | Literal['auto']")
    assert parameter.problem("auto") is None
    assert parameter.problem(0.5) is None
    assert parameter.problem("half") == "'half' is not of type float or one of auto"


@given(st.one_of(st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text()))
def test_a_value_fits_its_own_type_and_no_other(value: object) -> None:
    kinds = {"None": type(None), "bool": bool, "int": int, "float": (int, float), "str": str}
    for kind, types in kinds.items():
        fits = isinstance(value, types) and (kind == "bool" or not isinstance(value, bool))  # type: ignore[arg-type]
        if kind != "None":
            assert (Parameter("x", annotation=kind).problem(value) is None) == fits


def test_a_remembered_signature_is_read_again_if_an_imported_choice_changes(tmp_path: Path) -> None:
    text = "from away import Mode\ndef f(*, x: Mode = 'a'):\n    pass\n"
    signature(tmp_path, text, away='from typing import Literal\nMode = Literal["a", "b"]\n')
    memo = tmp_path / "memo.json"
    reader = FunctionReader(memo, tmp_path)
    assert reader.signature("sample:f").parameters["x"].choices == ("a", "b")
    reader.save()
    (tmp_path / "away.py").write_text('from typing import Literal\nMode = Literal["a", "b", "c"]\n')
    assert FunctionReader(memo, tmp_path).signature("sample:f").parameters["x"].choices == ("a", "b", "c")

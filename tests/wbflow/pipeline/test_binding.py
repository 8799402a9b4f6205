"""Stages and their methods: inputs are bound by argument name, and only the chosen method's parameters are known."""

from __future__ import annotations

from pathlib import Path

import pytest

from wbflow.cache.fingerprint import FunctionError
from wbflow.pipeline.binding import Binding, bind, method_parameters
from wbflow.pipeline.functions import FunctionReader
from wbflow.pipeline.stages import Method, Stage, own

STAGE = '''\
METHODS = {"plain": "beside:plain", "rich": "beside:rich"}

def work(left, right, *, frame=None, how: str = "plain", least: int = 8, **options):
    """Do it."""

def plain(left, right, *, ratio: float = 0.8):
    """Plainly."""

def rich(frame, *, depth: int = SIZE):
    """Richly."""

def wrong(left, picture):
    """Asks for what nobody has."""

SIZE = len("abc")
'''

ROW = Stage(
    "toy",
    scope="pair",
    function="beside:work",
    inputs={"left": own("a"), "right": own("a")},
    offers={"frame": own("b")},
    method=Method("how", "beside:METHODS"),
)


@pytest.fixture
def reader(tmp_path: Path) -> FunctionReader:
    (tmp_path / "beside.py").write_text(STAGE)
    return FunctionReader(folder=tmp_path)


def bound(reader: FunctionReader, **values: object) -> Binding:
    return bind(ROW, None, values, reader)


def test_parameters_are_those_of_the_stage_and_of_the_chosen_method(reader: FunctionReader) -> None:
    assert bound(reader).defaults() == {"how": "plain", "least": 8, "ratio": 0.8}
    assert list(bound(reader, how="rich").parameters) == ["how", "least", "depth"]
    assert bound(reader, how="rich").left_to_function() == {"depth": "default SIZE"}


def test_an_offered_input_is_bound_only_if_the_method_takes_it(reader: FunctionReader) -> None:
    assert set(bound(reader).inputs) == {"left", "right"}
    assert set(bound(reader, how="rich").inputs) == {"left", "right", "frame"}


def test_each_method_has_a_fingerprint_of_its_own(reader: FunctionReader, tmp_path: Path) -> None:
    assert bound(reader).code != bound(reader, how="rich").code
    assert bound(reader).code == bound(reader, how="beside:plain").code


def test_a_user_method_is_found_by_its_dotted_name(reader: FunctionReader, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def method(right, *, depth: int = 3):\n    return right\n")
    assert "depth" in bound(reader, how="mine:method").parameters


def test_an_unknown_method_is_refused_with_a_list_of_known_ones(reader: FunctionReader) -> None:
    with pytest.raises(FunctionError, match="'magic' is not one of plain, rich"):
        bound(reader, how="magic")


def test_a_method_that_takes_an_unavailable_input_is_reported(reader: FunctionReader) -> None:
    assert bound(reader).faults() == []
    (fault,) = bound(reader, how="beside:wrong").faults()
    assert "has the required argument 'picture', which is not an available input; toy can provide frame, left, right" in fault


def test_the_parameters_of_every_method_of_a_stage_are_listed(reader: FunctionReader) -> None:
    readers = method_parameters(ROW, reader)
    assert {name: list(parameters) for name, parameters in readers.items()} == {"plain": ["ratio"], "rich": ["depth"]}


def test_a_method_table_that_is_not_a_literal_is_refused(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text(STAGE.replace('METHODS = {"plain": "beside:plain",', 'METHODS = {"plain": str(1),'))
    with pytest.raises(FunctionError, match="has no dictionary literal METHODS"):
        bind(ROW, None, {}, FunctionReader(folder=tmp_path))

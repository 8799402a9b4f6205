"""Methods are chosen by name or as a dotted function, receive inputs by name, and accept only their own parameters."""

from __future__ import annotations

import sys
import types

import pytest

from wbflow_stages.core.methods import bind, method

TABLE = {"first": "a_module_of_methods:first", "second": "a_module_of_methods:second"}


@pytest.fixture(autouse=True)
def methods(monkeypatch: pytest.MonkeyPatch) -> None:
    """A module with the two methods of the table, and a third one that is not in it."""
    module = types.ModuleType("a_module_of_methods")
    code = (
        "def first(left, *, ratio=0.5): return 'first', left, ratio\n"
        "def second(right, picture, *, rounds=3): return 'second', right, picture, rounds\n"
        "def third(left, picture=None, **anything): return 'third', left, picture, anything\n"
    )
    exec(code, module.__dict__)
    monkeypatch.setitem(sys.modules, "a_module_of_methods", module)


INPUTS: dict[str, object] = {"left": "L", "right": "R", "picture": None}


def test_a_method_receives_the_inputs_it_names_and_its_own_parameters() -> None:
    assert bind(TABLE, "first", INPUTS, {"ratio": 0.7})() == ("first", "L", 0.7)
    assert bind(TABLE, "second", INPUTS | {"picture": "P"}, {})() == ("second", "R", "P", 3)


def test_a_dotted_function_is_called_without_being_in_the_table() -> None:
    assert bind(TABLE, "a_module_of_methods:third", INPUTS, {"depth": 2})() == ("third", "L", None, {"depth": 2})


@pytest.mark.parametrize(
    "name", ["frist", "third", "a_module_of_methods:frist", "no_such_module:first", "a_module_of_methods.deeper:first"]
)
def test_an_unknown_method_name_is_refused_with_a_list_of_the_known_ones(name: str) -> None:
    with pytest.raises(ValueError, match="first, second"):
        method(TABLE, name)


def test_a_method_module_with_a_missing_import_names_that_import(tmp_path: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    with open(f"{tmp_path}/needs_more.py", "w") as file:  # noqa: PTH123
        file.write("import a_library_that_nobody_has\ndef run(left): pass\n")
    with pytest.raises(ModuleNotFoundError, match="a_library_that_nobody_has"):
        method(TABLE, "needs_more:run")


def test_a_parameter_of_another_method_is_refused_with_a_list_of_its_own() -> None:
    with pytest.raises(TypeError, match=r"'first' does not read 'rounds'; its parameters: ratio"):
        bind(TABLE, "first", INPUTS, {"rounds": 2})


def test_a_missing_input_is_named_in_the_error() -> None:
    with pytest.raises(ValueError, match="'second' needs picture"):
        bind(TABLE, "second", INPUTS, {})


def test_inputs_are_not_accepted_as_parameters() -> None:
    with pytest.raises(TypeError, match="does not read 'left'"):
        bind(TABLE, "first", INPUTS, {"left": "X"})

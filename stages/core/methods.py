"""Methods: where a stage can be done in several ways, a table names the functions that do it, and anybody's function may join.

A table is a dictionary of names to `package.module:function`, so that it can be read without importing anything.  A stage
function takes the name of the method, or a dotted function that stands in no table, and hands all parameters that are not its own
to it.

A method asks for its inputs *by argument name*, among those that the stage has; its parameters are keyword-only with defaults.
A parameter that the method does not have is an error, in which the methods that have it are named.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

Table = Mapping[str, str]
"""Names of methods and the functions behind them, "package.module:function"."""


def method(table: Table, name: str) -> Callable[..., Any]:
    """The function behind a name of the table, or behind `package.module:function`.

    Raises
    ------
    ValueError
        The name is not in the table, or the dotted name leads nowhere; the names that are known are listed.
    """
    if name not in table and ":" not in name:
        raise ValueError(
            f"there is no method {name!r}: choose {', '.join(table)}, or a function of your own as package.module:function"
        )
    module, _, function = table.get(name, name).partition(":")
    try:
        found = getattr(importlib.import_module(module), function, None)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise  # the module is there, and lacks something itself
        found = None
    if not callable(found):
        raise ValueError(
            f"method {name!r}: there is no function {function!r} in a module {module!r}; known are {', '.join(table)}"
        )
    return found  # type: ignore[no-any-return]


def bind(table: Table, name: str, inputs: Mapping[str, object], options: Mapping[str, object]) -> Callable[[], Any]:
    """A method with those of the inputs that it asks for, and its parameters: ready to be called.

    Parameters
    ----------
    table : the methods that have a name.
    name : one of them, or `package.module:function`.
    inputs : by argument name; None: not at hand.
    options : the parameters of the method.

    Raises
    ------
    ValueError
        The name is unknown, or the method asks for an input that is not at hand.
    TypeError
        The method does not read one of the parameters.
    """
    function = method(table, name)
    wanted = inspect.signature(function).parameters
    asked = [p for p in wanted if p in inputs]
    for p in asked:
        if inputs[p] is None and wanted[p].default is inspect.Parameter.empty:
            raise ValueError(f"method {name!r} needs {p}: give {p}=")
    if not any(p.kind is inspect.Parameter.VAR_KEYWORD for p in wanted.values()):
        for option in options:
            if option not in wanted or option in inputs:
                raise TypeError(_unread(table, name, option, [p for p in wanted if p not in inputs]))
    return partial(function, **{p: inputs[p] for p in asked}, **options)


def _unread(table: Table, name: str, option: str, own: list[str]) -> str:
    """What is wrong with a parameter that a method does not have."""
    readers = [other for other in table if other != name and option in inspect.signature(method(table, other)).parameters]
    where = f"{option!r} is read by {', '.join(readers)} only" if readers else f"no method reads {option!r}"
    has = f"{name!r} reads {', '.join(own)}" if own else f"{name!r} has no parameters of its own"
    return f"method {name!r} does not read {option!r}: {where}; {has}"

"""Methods: alternative implementations of a stage, listed by name in a table; users can add functions of their own.

A table maps names to `package.module:function`, so that it can be read without importing anything.  A stage function takes the
name of a method, or `package.module:function` for one that is in no table, and passes on all parameters that are not its own.
A method takes its inputs *by argument name*, among those of the stage; its parameters are keyword-only with defaults.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from ..types.checking import check_result


def method(table: Mapping[str, str], name: str) -> Callable[..., Any]:
    """Return the function behind a name of the table, or behind `package.module:function`.

    Raises ValueError, with the known names, if no function is found.
    """
    module_name, _, function_name = table.get(name, name).partition(":")
    function = None
    if function_name:
        try:
            function = getattr(importlib.import_module(module_name), function_name, None)
        except ModuleNotFoundError as error:
            if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
                raise  # the module exists, but fails to import another one
    if not callable(function):
        choices = ", ".join(table)
        raise ValueError(f"there is no method {name!r}: choose {choices}, or a function of your own as package.module:function")
    return function  # type: ignore[no-any-return]


def bind(
    table: Mapping[str, str],
    name: str,
    inputs: Mapping[str, object],
    options: Mapping[str, object],
    returns: Any = Any,
    lengths: Mapping[str, int] | None = None,
) -> Callable[[], Any]:
    """Return a method with its inputs and parameters bound, ready to be called.  Results of methods in no table are checked.

    Raises ValueError if the name is unknown or the method needs an input that is not available; TypeError if the method lacks
    one of the options.

    Parameters
    ----------
    table : the methods that have a name.
    name : one of them, or `package.module:function`.
    inputs : the stage's inputs by argument name; None: not available.
    options : parameters of the method, by name.
    returns, lengths : what a method returns (see `types.checking.check_result`).
    """
    function = method(table, name)
    arguments = inspect.signature(function).parameters

    # inputs: those that the method names, and needs
    for argument, value in inputs.items():
        if value is None and argument in arguments and arguments[argument].default is inspect.Parameter.empty:
            raise ValueError(f"method {name!r} needs {argument}: give {argument}=")
    wanted_inputs = {argument: inputs[argument] for argument in arguments if argument in inputs}

    # options: any, if the method takes **options
    parameters = [argument for argument in arguments if argument not in inputs]
    takes_any = any(argument.kind is inspect.Parameter.VAR_KEYWORD for argument in arguments.values())
    if not takes_any:
        for option in options:
            if option not in parameters:
                known = ", ".join(parameters) or "none"
                raise TypeError(f"method {name!r} does not read {option!r}; its parameters: {known}")
    bound = partial(function, **wanted_inputs, **options)
    if name in table:
        return bound

    def checked() -> Any:
        result = bound()
        check_result(result, name, returns, lengths)
        return result

    return checked

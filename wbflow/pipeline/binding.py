"""Binds a stage to the function and the method that a site uses for it: their inputs and parameters.

The names of a function's arguments select its inputs: any that the stage's row needs or offers.  All other arguments are
parameters, and must come after a bare `*`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace
from typing import Any

from ..cache.checksum import content_digest
from ..cache.fingerprint import FunctionError
from .signature import Functions, Parameter, Signature
from .stages import Adapt, Method, Source, Stage


@dataclass(frozen=True)
class Binding:
    """A stage with the function that a site uses for it."""

    stage: Stage
    function: Signature
    method: Signature | None
    """The chosen method, if the function chooses among methods."""
    code: str
    """Fingerprint of all code that the function and the method run."""
    inputs: dict[str, Source]
    """The inputs that are passed, by argument name."""
    parameters: dict[str, Parameter]
    """Parameters of the function and of the chosen method."""

    def defaults(self) -> dict[str, Any]:
        """Values of the parameters that have a literal default."""
        return {name: p.default for name, p in self.parameters.items() if not p.source and not p.required}

    def left_to_function(self) -> dict[str, str]:
        """Source text of the defaults that are not literals, which only the function can evaluate."""
        return {name: f"default {p.source}" for name, p in self.parameters.items() if p.source}

    def faults(self) -> list[str]:
        """What is wrong with the signatures, in words."""
        faults = _faults_of(self.function, self.stage, self.stage.sources.keys())
        if self.method and self.stage.method:
            passed = _passed_to_method(self.function, self.stage)
            faults += _faults_of(self.method, self.stage, passed | set(self.stage.method.inputs))
        return faults


@dataclass(frozen=True)
class Bindings:
    """Keeps each binding: a stage with a section in the site file is bound when that is checked, others when first asked for.

    Binding reads all code that a stage runs, which no command should have to do that only shows a run.
    """

    reader: Functions
    _bound: dict[str, Binding] = field(default_factory=dict, repr=False)
    """Bindings by stage, or by the function of the `Adapt` that replaces the stage's own."""

    def bind_section(self, stage: Stage, use: str | None, values: Mapping[str, Any]) -> Binding:
        """Bind a stage to the function and the method that its section names (`bind`).  Raises FunctionError."""
        self._bound[stage.name] = bind(stage, use, values, self.reader)
        return self._bound[stage.name]

    def of(self, stage: Stage) -> Binding:
        """The binding of a stage to the function that the site uses for it."""
        if stage.name not in self._bound:
            self._bound[stage.name] = bind(stage, None, {}, self.reader)
        return self._bound[stage.name]

    def of_adapt(self, stage: Stage, adapt: Adapt) -> Binding:
        """The binding of a stage to the function that derives its result from the reference's; it takes no method."""
        if adapt.function not in self._bound:
            adapting = dataclasses.replace(stage, function=adapt.function, inputs=adapt.inputs, offers={}, method=None)
            self._bound[adapt.function] = bind(adapting, None, {}, self.reader)
        return self._bound[adapt.function]


def bind(stage: Stage, use: str | None, values: Mapping[str, Any], reader: Functions) -> Binding:
    """Bind a stage.  Raises FunctionError if the function or the method does not exist.

    Parameters
    ----------
    stage, reader : Stage, Functions
        The row of the stage, and the reader of functions.
    use : str or None
        The function that the site file names for the stage; None for the one in the stage's row.
    values : mapping
        Parameters that the site file sets, by name.
    """
    choice = stage.method if use is None else None
    function = reader.signature(use or stage.function)
    parameters = {name: p for name, p in function.parameters.items() if name not in stage.sources}
    if choice is None:
        method = None
        requested = function.names | (stage.inputs.keys() if function.takes_any else set())
    else:
        value = values.get(choice.parameter, parameters[choice.parameter].default)
        method = reader.signature(_chosen_method(choice, value, reader))
        provided = {*stage.sources, *choice.inputs, *parameters}
        parameters |= {name: p for name, p in method.parameters.items() if name not in provided}
        requested = (function.names & stage.inputs.keys()) | (method.names & _passed_to_method(function, stage))
    required = {argument.name for argument in function.arguments if argument.required}
    inputs = {name: source for name, source in stage.sources.items() if name in requested}
    # an input for which the function has no default is required, even if its source has an `unless`
    inputs |= {name: replace(source, unless=()) for name, source in inputs.items() if name in required}
    code = code_of(stage, function.dotted, method.dotted if method else "", reader)
    return Binding(stage, function, method, code, inputs, parameters)


def code_of(stage: Stage, function: str, method: str, reader: Functions) -> str:
    """Return the fingerprint of all code that a stage's function and its method run.  Raises FunctionError.

    Parameters
    ----------
    stage, reader : Stage, Functions
        As for `bind`.
    function, method : str
        Dotted names; no method: "".
    """
    if not method or stage.method is None:
        return reader.code(function)
    # the other methods of the table do not matter
    of_function = reader.code(function, stage.method.table)
    return content_digest(f"{of_function} {reader.code(method)}".encode())


def method_parameters(stage: Stage, reader: Functions) -> dict[str, dict[str, Parameter]]:
    """Parameters, by method of a stage's table, that the stage's function does not have itself.  Raises FunctionError."""
    if stage.method is None:
        return {}
    taken = {*stage.sources, *stage.method.inputs, *reader.signature(stage.function).parameters}
    return {
        name: {n: p for n, p in reader.signature(dotted).parameters.items() if n not in taken}
        for name, dotted in reader.table(stage.method.table).items()
    }


def methods_with_file(stage: Stage, name: str, reader: Functions) -> list[str]:
    """The methods of a stage's table that take the file input `name`.  Raises FunctionError."""
    if stage.method is None or name not in stage.files:
        return []
    return [method for method, dotted in reader.table(stage.method.table).items() if name in reader.signature(dotted).names]


def _chosen_method(choice: Method, value: Any, reader: Functions) -> str:
    """Dotted name of the method that a value of the parameter selects."""
    table = reader.table(choice.table)
    if isinstance(value, str) and (value in table or ":" in value):
        return table.get(value, value)
    raise FunctionError(f"{value!r} is not one of {', '.join(table)}, and not a package.module:function")


def _passed_to_method(function: Signature, stage: Stage) -> set[str]:
    """Inputs that a stage's function passes on to its method: those among its own arguments, and files if it has `**parameters`,
    through which files are passed."""
    files = set(stage.files) if function.takes_any else set()
    return (function.names & stage.sources.keys()) | files


def _faults_of(function: Signature, stage: Stage, offered: Set[str]) -> list[str]:
    faults = []
    inputs = f"{stage.name} can provide {', '.join(sorted(offered))}"
    for argument in function.arguments:
        if not argument.by_name:
            fault = f"takes {argument.name!r} by position only: remove the '/': inputs are passed by name"
        elif argument.name in offered:
            continue
        elif argument.required:
            fault = f"has the required argument {argument.name!r}, which is not an available input; {inputs}"
        else:
            fault = f"has {argument.name!r} among its inputs; {inputs}; parameters must come after a bare *"
        faults.append(f"{function.dotted} {fault}")
    return faults

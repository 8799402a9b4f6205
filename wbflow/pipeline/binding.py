"""Binds a stage to the function and the method that a site uses for it: their inputs and parameters.

The names of a function's arguments select its inputs: any that the stage's row needs or offers.  All other arguments are
parameters, and must come after a bare `*`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from ..cache.checksum import content_digest
from ..cache.fingerprint import FunctionError
from .functions import FunctionInfo, FunctionReader, Parameter, Signature
from .stages import Source, Stage


@dataclass(frozen=True)
class Binding:
    """A stage with the function that a site uses for it."""

    stage: Stage
    function: FunctionInfo
    method: FunctionInfo | None
    """The chosen method, if the function chooses among methods."""
    inputs: dict[str, Source]
    """The inputs that are passed, by argument name."""
    parameters: dict[str, Parameter]
    """Parameters of the function and of the chosen method."""

    @cached_property
    def code(self) -> str:
        """Fingerprint of all code that the function and the method run."""
        if self.method is None:
            return self.function.code
        return content_digest(f"{self.function.code} {self.method.code}".encode())

    def defaults(self) -> dict[str, Any]:
        """Values of the parameters that have a literal default."""
        return {name: p.default for name, p in self.parameters.items() if not p.source and not p.required}

    def left_to_function(self) -> dict[str, str]:
        """Source text of the defaults that are not literals, which only the function can evaluate."""
        return {name: f"default {p.source}" for name, p in self.parameters.items() if p.source}

    def faults(self) -> list[str]:
        """What is wrong with the signatures, in words."""
        offered = {*self.stage.inputs, *self.stage.offers}
        faults = _signature_faults(self.function, self.stage, offered)
        if self.method and self.stage.method:
            passed = _passed_to_method(self.function.signature, self.stage)
            faults += _signature_faults(self.method, self.stage, passed | set(self.stage.method.given))
        return faults


def bind(stage: Stage, use: str | None, values: Mapping[str, Any], reader: FunctionReader) -> Binding:
    """Bind a stage.  Raises FunctionError if the function or the method does not exist.

    Parameters
    ----------
    stage, reader : Stage, FunctionReader
        The row of the stage, and the reader of functions.
    use : str or None
        The function that the site file names for the stage; None for the one in the stage's row.
    values : mapping
        Parameters that the site file sets, by name.
    """
    choice = stage.method if use is None else None
    function = reader.read(use or stage.function, choice.table if choice else "")
    inputs = {**stage.inputs, **stage.offers}
    signature = function.signature
    parameters = {name: p for name, p in signature.parameters.items() if name not in inputs}
    if choice is None:
        requested = _names_of(signature) | (set(stage.inputs) if signature.takes_any else set())
        return Binding(stage, function, None, _select_inputs(inputs, requested, signature), parameters)
    method = reader.read(_chosen_method(stage, values, parameters, reader))
    provided = {*inputs, *choice.given}
    parameters |= {n: p for n, p in method.signature.parameters.items() if n not in provided and n not in parameters}
    requested = (_names_of(signature) & set(stage.inputs)) | (_names_of(method.signature) & _passed_to_method(signature, stage))
    return Binding(stage, function, method, _select_inputs(inputs, requested, signature), parameters)


def method_parameters(stage: Stage, reader: FunctionReader) -> dict[str, dict[str, Parameter]]:
    """Parameters, by method of a stage's table, that the stage's function does not have itself.  Raises FunctionError."""
    if stage.method is None:
        return {}
    taken = {*stage.inputs, *stage.offers, *stage.method.given, *reader.signature(stage.function).parameters}
    return {
        name: {n: p for n, p in reader.signature(dotted).parameters.items() if n not in taken}
        for name, dotted in reader.table(stage.method.table).items()
    }


def methods_with_file(stage: Stage, name: str, reader: FunctionReader) -> list[str]:
    """The methods of a stage's table that take the file input `name`.  Raises FunctionError."""
    source = stage.offers.get(name)
    if stage.method is None or source is None or source.kind != "file":
        return []
    return [method for method, dotted in reader.table(stage.method.table).items() if name in _names_of(reader.signature(dotted))]


def _chosen_method(stage: Stage, values: Mapping[str, Any], parameters: Mapping[str, Parameter], reader: FunctionReader) -> str:
    """Dotted name of the method that the site file selects, or else the default."""
    assert stage.method
    name = stage.method.parameter
    choice = values.get(name, parameters[name].default)
    table = reader.table(stage.method.table)
    if isinstance(choice, str) and choice in table:
        return table[choice]
    if isinstance(choice, str) and ":" in choice:
        return choice
    raise FunctionError(f"{choice!r} is not one of {', '.join(table)}, and not a package.module:function")


def _passed_to_method(signature: Signature, stage: Stage) -> set[str]:
    """Inputs that a stage's function passes on to its method: those among its own arguments, and files if it has `**parameters`,
    through which files are passed."""
    files = {name for name, source in stage.offers.items() if source.kind == "file"} if signature.takes_any else set()
    return (_names_of(signature) & {*stage.inputs, *stage.offers}) | files


def _names_of(signature: Signature) -> set[str]:
    return {a.name for a in signature.arguments} | set(signature.parameters)


def _select_inputs(inputs: Mapping[str, Source], names: set[str], signature: Signature) -> dict[str, Source]:
    """The inputs with these names.  One for which `signature` has no default is required, even if its source has an `unless`."""
    required = {argument.name for argument in signature.arguments if argument.required}
    selected = {name: source for name, source in inputs.items() if name in names}
    for name in required & set(selected):
        source = selected[name]
        if source.unless:
            selected[name] = replace(source, unless=())
    return selected


def _signature_faults(info: FunctionInfo, stage: Stage, offered: set[str]) -> list[str]:
    faults = []
    inputs = f"{stage.name} can provide {', '.join(sorted(offered))}"
    for argument in info.signature.arguments:
        if not argument.by_name:
            faults.append(f"{info.dotted} takes {argument.name!r} by position only: remove the '/': inputs are passed by name")
        elif argument.name not in offered and argument.required:
            faults.append(f"{info.dotted} has the required argument {argument.name!r}, which is not an available input; {inputs}")
        elif argument.name not in offered:
            faults.append(f"{info.dotted} has {argument.name!r} among its inputs; {inputs}; parameters must come after a bare *")
    return faults

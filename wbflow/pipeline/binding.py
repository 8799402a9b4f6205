"""A stage bound to the function, and the method, that a site has it done by: what these are handed, and their parameters.

What a function receives is decided by the names of its arguments: any input that the stage's row needs or offers.  Everything
else that it takes is a parameter, and stands after a bare `*`.
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
    """A stage as a site has it done."""

    stage: Stage
    function: FunctionInfo
    method: FunctionInfo | None
    """Where the function chooses among methods, the chosen one."""
    inputs: dict[str, Source]
    """Inputs that are handed over, by argument name."""
    parameters: dict[str, Parameter]
    """The function's own, and those of the chosen method."""

    @cached_property
    def code(self) -> str:
        """Fingerprint of all code that runs."""
        if self.method is None:
            return self.function.code
        return content_digest(f"{self.function.code} {self.method.code}".encode())

    def defaults(self) -> dict[str, Any]:
        """Values of the parameters that have a literal default."""
        return {name: p.default for name, p in self.parameters.items() if not p.source and not p.required}

    def left_to_function(self) -> dict[str, str]:
        """Text of the defaults that only the function can work out."""
        return {name: f"default {p.source}" for name, p in self.parameters.items() if p.source}

    def faults(self) -> list[str]:
        """What is wrong with the signatures, in words."""
        offered = {*self.stage.inputs, *self.stage.offers}
        found = _faults(self.function, self.stage, offered)
        if self.method and self.stage.method:
            handed_on = _handed_on(self.function.signature, self.stage)
            found += _faults(self.method, self.stage, handed_on | set(self.stage.method.given))
        return found


def bind(stage: Stage, use: str | None, values: Mapping[str, Any], reader: FunctionReader) -> Binding:
    """Bind a stage.  Raises FunctionError where there is no such function, or no such method.

    Parameters
    ----------
    stage, reader : Stage, FunctionReader
        Its row, and what knows the functions.
    use : str or None
        The function that the site file names for it; None for the row's own.
    values : mapping
        Parameters that the site file sets, by name.
    """
    chooser = stage.method if use is None else None
    function = reader.read(use or stage.function, chooser.table if chooser else "")
    inputs = {**stage.inputs, **stage.offers}
    own = function.signature
    parameters = {name: p for name, p in own.parameters.items() if name not in inputs}
    if chooser is None:
        asked = _asked(own) | (set(stage.inputs) if own.takes_any else set())
        return Binding(stage, function, None, _wanted(inputs, asked, own), parameters)
    method = reader.read(_chosen(stage, values, parameters, reader))
    given = {*inputs, *chooser.given}
    parameters |= {n: p for n, p in method.signature.parameters.items() if n not in given and n not in parameters}
    asked = (_asked(own) & set(stage.inputs)) | (_asked(method.signature) & _handed_on(own, stage))
    return Binding(stage, function, method, _wanted(inputs, asked, own), parameters)


def method_parameters(stage: Stage, reader: FunctionReader) -> dict[str, dict[str, Parameter]]:
    """Parameters of each method of a stage's table that the stage has not itself.  Raises FunctionError."""
    if stage.method is None:
        return {}
    taken = {*stage.inputs, *stage.offers, *stage.method.given, *reader.signature(stage.function).parameters}
    return {
        name: {n: p for n, p in reader.signature(dotted).parameters.items() if n not in taken}
        for name, dotted in reader.table(stage.method.table).items()
    }


def methods_with_file(stage: Stage, name: str, reader: FunctionReader) -> list[str]:
    """The methods of a stage's table that read a file of this name.  Raises FunctionError."""
    need = stage.offers.get(name)
    if stage.method is None or need is None or need.kind != "file":
        return []
    return [method for method, dotted in reader.table(stage.method.table).items() if name in _asked(reader.signature(dotted))]


def _chosen(stage: Stage, values: Mapping[str, Any], parameters: Mapping[str, Parameter], reader: FunctionReader) -> str:
    """Dotted name of the method that the site file, or the default, chooses."""
    assert stage.method
    name = stage.method.parameter
    wanted = values.get(name, parameters[name].default)
    table = reader.table(stage.method.table)
    if isinstance(wanted, str) and wanted in table:
        return table[wanted]
    if isinstance(wanted, str) and ":" in wanted:
        return wanted
    raise FunctionError(f"{wanted!r} is not one of {', '.join(table)}, and not a package.module:function")


def _handed_on(own: Signature, stage: Stage) -> set[str]:
    """Inputs that a stage's function hands to the method that it chooses: those that it names, and files, which go with the
    parameters that it only passes through."""
    files = {name for name, need in stage.offers.items() if need.kind == "file"} if own.takes_any else set()
    return (_asked(own) & {*stage.inputs, *stage.offers}) | files


def _asked(signature: Signature) -> set[str]:
    return {a.name for a in signature.arguments} | set(signature.parameters)


def _wanted(inputs: Mapping[str, Source], names: set[str], own: Signature) -> dict[str, Source]:
    """The inputs of these names.  What the function has no default for must be there, whatever else is."""
    required = {argument.name for argument in own.arguments if argument.required}
    found = {name: need for name, need in inputs.items() if name in names}
    for name in required & set(found):
        need = found[name]
        if need.unless:
            found[name] = replace(need, unless=())
    return found


def _faults(info: FunctionInfo, stage: Stage, offered: set[str]) -> list[str]:
    found = []
    inputs = f"{stage.name} can hand over {', '.join(sorted(offered))}"
    for argument in info.signature.arguments:
        if not argument.by_name:
            found.append(f"{info.dotted} takes {argument.name!r} by position only: remove the '/', inputs come by name")
        elif argument.name not in offered and argument.required:
            found.append(f"{info.dotted} asks for {argument.name!r}, which is not there; {inputs}")
        elif argument.name not in offered:
            found.append(f"{info.dotted} has {argument.name!r} among its inputs; {inputs}; a parameter stands after a bare *")
    return found

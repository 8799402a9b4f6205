"""A stage bound to the function, and the method, that a site has it done by: what these are handed, and their parameters, with
default, unit and meaning from signatures and docstrings alone.

What a function receives is decided by the names of its arguments: any input that the stage's row needs or offers.  Everything
else that it takes is a parameter, and stands after a bare `*`.
"""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from ..cache.checksum import content_digest
from ..cache.fingerprint import FunctionError
from .functions import FunctionInfo, FunctionReader, Parameter, Signature
from .stages import COMPONENT, FUSE, Source, Stage


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


_TYPES = re.compile(r"(?:int|float|bool|str|list|tuple|dict|None|optional|\{[^}]*\}|\"[^\"]*\"| |or|of|\||,|\[[^\]]*\])+")
_UNITS = {
    "_px": "pixels",
    "_deg": "degrees",
    "_mm": "millimetres",
    "_m": "metres",
    "_s": "seconds",
    "_share": "share, 0 to 1",
    "_probability": "0 to 1",
}
"""By the end of a parameter's name; what the docstring says goes first."""
_WIDTH = 110
"""Of the lines that are printed."""


@dataclass(frozen=True)
class ParameterDoc:
    """A parameter, and what the docstring of its function has of it."""

    parameter: Parameter
    unit: str
    meaning: str


def document(dotted: str, parameters: Iterable[Parameter], reader: FunctionReader) -> tuple[str, list[ParameterDoc]]:
    """What the docstring of a function says: its first paragraph in one line, and unit and meaning of parameters."""
    _, _, node = reader.modules.function(dotted)
    text = ast.get_docstring(node) or ""
    known = _parameter_texts(text)
    docs = []
    for parameter in parameters:
        unit, meaning = known.get(parameter.name, ("", ""))
        by_name = next((words for ending, words in _UNITS.items() if parameter.name.endswith(ending)), "")
        docs.append(ParameterDoc(parameter, unit or by_name, meaning))
    return " ".join(text.split("\n\n")[0].split()), docs


def describe(stage: Stage, reader: FunctionReader) -> list[str]:
    """A stage and its methods as a person reads them at a terminal."""
    own = reader.signature(stage.function).parameters
    inputs = {*stage.inputs, *stage.offers}
    meaning, docs = document(stage.function, [p for name, p in own.items() if name not in inputs], reader)
    offers = f"; a function of one's own may also ask for {', '.join(stage.offers)}" if stage.offers else ""
    found = [f"{stage.name}  (each {stage.scope})  {meaning}", f"  {stage.function}, from {', '.join(stage.inputs)}{offers}"]
    found += [line for doc in docs for line in _lines(doc, "  ", _elsewhere(stage, doc.parameter.name))]
    for name, dotted in reader.table(stage.method.table).items() if stage.method else ():
        meaning, docs = document(dotted, method_parameters(stage, reader)[name].values(), reader)
        default = stage.method and own[stage.method.parameter].default
        found.append(f"  {name}{' (default)' if name == default else ''}: {meaning}")
        found += [line for doc in docs for line in _lines(doc, "    ")]
    return found


def _parameter_texts(docstring: str) -> dict[str, tuple[str, str]]:
    """Unit and meaning of what the section Parameters of a docstring lists, by name."""
    found: dict[str, tuple[str, str]] = {}
    for head, body in _entries(docstring):
        names, _, text = head.partition(" : ") if " : " in head else head.partition(": ")
        text = text.strip()
        typed = _TYPES.match(text)
        ends_there = typed and (typed.end() == len(text) or text[: typed.end()].rstrip().endswith(","))
        unit = text[typed.end() :].strip() if typed and ends_there else ""
        meaning = " ".join([*([] if ends_there else [text]), *body]).strip()
        found |= {name.strip(): (unit, meaning) for name in names.replace("*", "").split(",")}
    return found


def _entries(docstring: str) -> list[tuple[str, list[str]]]:
    """Head line and further lines of each entry of the section Parameters."""
    lines = docstring.splitlines()
    entries: list[tuple[str, list[str]]] = []
    inside = False
    for line, below in zip(lines, [*lines[1:], ""], strict=True):
        if below and not below.strip("-") and not line.startswith(" "):
            inside = line.strip() in {"Parameters", "Other Parameters"}
        elif inside and line.strip("-") and line.startswith(" ") and entries:
            entries[-1][1].append(line.strip())
        elif inside and line.strip("-"):
            entries.append((line.strip(), []))
    return entries


def _elsewhere(stage: Stage, name: str) -> str:
    """Where in a site file a parameter is set that is not set in the stage's section."""
    section, _, key = stage.set_by_site().get(name, "").rpartition(".")
    if key:
        return f", set by {f'{key} in the section {section}' if section else f'{key} at the top'} of the site file"
    return ", each component in turn" if (stage.name, name) == (FUSE, COMPONENT) else ""


def _lines(doc: ParameterDoc, indent: str, elsewhere: str = "") -> list[str]:
    head = f"{indent}{doc.parameter.name} = {doc.parameter.shown}{elsewhere}{f' [{doc.unit}]' if doc.unit else ''}"
    choices = [str(choice) for choice in doc.parameter.choices]
    unnamed = [choice for choice in choices if choice not in doc.meaning]
    words = f"{doc.meaning} One of {', '.join(choices)}.".strip() if unnamed else doc.meaning
    return [head, *textwrap.wrap(words, _WIDTH, initial_indent=f"{indent}    ", subsequent_indent=f"{indent}    ")]

"""Every parameter of every stage and of its methods: default, unit, meaning; from signatures and docstrings alone."""

from __future__ import annotations

import ast
import re
import textwrap
from dataclasses import dataclass

from .binding import method_parameters
from .functions import FunctionReader
from .names import FUSE
from .signature import Parameter
from .stages import COMPONENT, STAGES, Stage

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


@dataclass(frozen=True)
class ParameterDoc:
    """What a docstring has of one parameter."""

    unit: str = ""
    meaning: str = ""


def summary(function: ast.FunctionDef) -> str:
    """The first paragraph of a docstring, in one line."""
    text = ast.get_docstring(function) or ""
    return " ".join(text.split("\n\n")[0].split())


def parameter_docs(function: ast.FunctionDef) -> dict[str, ParameterDoc]:
    """What the section Parameters of a docstring says, by name."""
    found: dict[str, ParameterDoc] = {}
    for head, body in _entries(ast.get_docstring(function) or ""):
        names, _, text = head.partition(" : ") if " : " in head else head.partition(": ")
        text = text.strip()
        typed = _TYPES.match(text)
        ends_there = typed and (typed.end() == len(text) or text[: typed.end()].rstrip().endswith(","))
        unit = text[typed.end() :].strip() if typed and ends_there else ""
        meaning = " ".join([*([] if ends_there else [text]), *body]).strip()
        for name in names.replace("*", "").split(","):
            found[name.strip()] = ParameterDoc(unit or unit_of(name.strip()), meaning)
    return found


def unit_of(name: str) -> str:
    """The unit that a parameter's name ends with, in words."""
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), "")


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


WIDTH = 110
"""Of the lines that are printed."""


@dataclass(frozen=True)
class ParameterRow:
    """One parameter."""

    name: str
    default: str
    """In words; of a parameter that is set elsewhere, where."""
    choices: tuple[str, ...]
    unit: str
    meaning: str


@dataclass(frozen=True)
class MethodRow:
    """A method of a stage, and the parameters that only it reads."""

    name: str
    meaning: str
    chosen: bool
    """It is the default."""
    parameters: tuple[ParameterRow, ...]


@dataclass(frozen=True)
class StageRow:
    """A stage: what it does, its inputs, its parameters, its methods."""

    name: str
    scope: str
    function: str
    meaning: str
    needs: tuple[str, ...]
    offers: tuple[str, ...]
    """Further inputs that another function in its place may ask for."""
    parameters: tuple[ParameterRow, ...]
    methods: tuple[MethodRow, ...]


def describe(stage: Stage, reader: FunctionReader) -> StageRow:
    """A stage and its methods."""
    _, _, node = reader.modules.function(stage.function)
    inputs = {*stage.inputs, *stage.offers}
    own = reader.signature(stage.function).parameters
    docs = parameter_docs(node)
    rows = tuple(_row(p, docs, _elsewhere(stage, name)) for name, p in own.items() if name not in inputs)
    return StageRow(
        stage.name,
        stage.scope,
        stage.function,
        summary(node),
        tuple(stage.inputs),
        tuple(stage.offers),
        rows,
        _methods(stage, own, reader),
    )


def describe_all(reader: FunctionReader) -> list[StageRow]:
    """All stages, in the order of the pipeline."""
    return [describe(stage, reader) for stage in STAGES]


def lines(row: StageRow) -> list[str]:
    """A stage as a person reads it at a terminal."""
    offers = f"; a function of one's own may also ask for {', '.join(row.offers)}" if row.offers else ""
    found = [f"{row.name}  (each {row.scope})  {row.meaning}", f"  {row.function}, from {', '.join(row.needs)}{offers}"]
    found += [line for parameter in row.parameters for line in _lines(parameter, "  ")]
    for method in row.methods:
        found.append(f"  {method.name}{' (default)' if method.chosen else ''}: {method.meaning}")
        found += [line for parameter in method.parameters for line in _lines(parameter, "    ")]
    return found


def _methods(stage: Stage, own: dict[str, Parameter], reader: FunctionReader) -> tuple[MethodRow, ...]:
    if stage.method is None:
        return ()
    table, default = reader.table(stage.method.table), own[stage.method.parameter].default
    found = []
    for name, parameters in method_parameters(stage, reader).items():
        _, _, node = reader.modules.function(table[name])
        docs = parameter_docs(node)
        rows = tuple(_row(p, docs, "") for p in parameters.values())
        found.append(MethodRow(name, summary(node), name == default, rows))
    return tuple(found)


def _elsewhere(stage: Stage, name: str) -> str:
    """Where in a site file a parameter is set that is not set in the stage's section."""
    if key := stage.set_by_site().get(name):
        return f", set by {_place(key)} of the site file"
    return ", each component in turn" if (stage.name, name) == (FUSE, COMPONENT) else ""


def _place(key: str) -> str:
    section, _, name = key.rpartition(".")
    return f"{name} in the section {section}" if section else f"{name} at the top"


def _row(parameter: Parameter, docs: dict[str, ParameterDoc], elsewhere: str) -> ParameterRow:
    doc = docs.get(parameter.name, ParameterDoc(unit_of(parameter.name)))
    choices = tuple(map(str, parameter.choices))
    return ParameterRow(parameter.name, f"{parameter.shown}{elsewhere}", choices, doc.unit, doc.meaning)


def _lines(row: ParameterRow, indent: str) -> list[str]:
    unit = f" [{row.unit}]" if row.unit else ""
    head = f"{indent}{row.name} = {row.default}{unit}"
    unnamed = [choice for choice in row.choices if choice not in row.meaning]
    words = f"{row.meaning} One of {', '.join(row.choices)}.".strip() if unnamed else row.meaning
    return [head, *textwrap.wrap(words, WIDTH, initial_indent=f"{indent}    ", subsequent_indent=f"{indent}    ")]

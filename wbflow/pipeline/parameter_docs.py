"""Default, unit and meaning of the stages' parameters, from signatures and docstrings, for `wbflow stages`."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass

from .binding import method_parameters
from .signature import Functions, Parameter, Signature
from .stages import COMPONENT, FUSE, Stage

_SECTION = re.compile(r"^(?:Other )?Parameters\n-+\n(.*?)(?=^[^\n]+\n-+$|\Z)", re.MULTILINE | re.DOTALL)
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
"""Units by the ending of a parameter's name; a unit in the docstring takes precedence."""
_WIDTH = 110
"""Width of the printed lines, in characters."""


@dataclass(frozen=True)
class ParameterDoc:
    """A parameter, with its unit and meaning from the docstring of its function."""

    parameter: Parameter
    unit: str
    meaning: str

    def lines(self, indent: str, where_set: str = "") -> list[str]:
        """Its lines at a terminal.  where_set: where it is set, if not in the stage's section, as text."""
        head = f"{indent}{self.parameter.name} = {self.parameter.shown}{where_set}{f' [{self.unit}]' if self.unit else ''}"
        choices = [str(choice) for choice in self.parameter.choices]
        is_complete = all(choice in self.meaning for choice in choices)
        words = self.meaning if is_complete else f"{self.meaning} One of {', '.join(choices)}.".strip()
        return [head, *textwrap.wrap(words, _WIDTH, initial_indent=f"{indent}    ", subsequent_indent=f"{indent}    ")]


def describe(stage: Stage, reader: Functions) -> list[str]:
    """The lines that describe a stage and its methods at a terminal."""
    function = reader.signature(stage.function)
    parameters = function.parameters
    meaning, docs = document(function, [p for name, p in parameters.items() if name not in stage.sources])
    offers = f"; a function of your own may also take {', '.join(stage.offers)}" if stage.offers else ""
    lines = [f"{stage.name}  (each {stage.scope})  {meaning}", f"  {stage.function}, from {', '.join(stage.inputs)}{offers}"]
    lines += [line for doc in docs for line in doc.lines("  ", _where_set(stage, doc.parameter.name))]
    if stage.method:
        table, own_parameters = reader.table(stage.method.table), method_parameters(stage, reader)
        for name, dotted in table.items():
            method = reader.signature(dotted)
            files = [Parameter(file, required=True) for file in stage.files if file in method.names]
            meaning, docs = document(method, [*files, *own_parameters[name].values()])
            is_default = name == parameters[stage.method.parameter].default
            lines.append(f"  {name}{' (default)' if is_default else ''}: {meaning}")
            lines += [line for doc in docs for line in doc.lines("    ")]
    return lines


def document(function: Signature, parameters: Iterable[Parameter]) -> tuple[str, list[ParameterDoc]]:
    """The first paragraph of a function's docstring in one line, and unit and meaning of parameters."""
    texts = _parameter_texts(function.doc)
    docs = []
    for parameter in parameters:
        unit, meaning = texts.get(parameter.name, ("", ""))
        default_unit = next((words for ending, words in _UNITS.items() if parameter.name.endswith(ending)), "")
        docs.append(ParameterDoc(parameter, unit or default_unit, meaning))
    return " ".join(function.doc.split("\n\n")[0].split()), docs


def _parameter_texts(docstring: str) -> dict[str, tuple[str, str]]:
    """Unit and meaning of the parameters in the section Parameters of a docstring, by name."""
    texts: dict[str, tuple[str, str]] = {}
    for entry in re.split(r"\n(?=\S)", "\n".join(_SECTION.findall(docstring))):
        head, *body = [line.strip() for line in entry.splitlines() if line.strip()] or [""]
        names, _, text = head.partition(" : ") if " : " in head else head.partition(": ")
        text = text.strip()
        type_match = _TYPES.match(text)
        is_type = type_match and (type_match.end() == len(text) or text[: type_match.end()].rstrip().endswith(","))
        unit = text[type_match.end() :].strip() if type_match and is_type else ""
        meaning = " ".join([*([] if is_type else [text]), *body]).strip()
        texts |= {name.strip(): (unit, meaning) for name in names.replace("*", "").split(",")}
    return texts


def _where_set(stage: Stage, name: str) -> str:
    """The key of the site file that sets a parameter, as text, if it is not set in the stage's section."""
    section, _, key = stage.set_by_site().get(name, "").rpartition(".")
    if key:
        return f", set by {f'{key} in the section {section}' if section else f'{key} at the top'} of the site file"
    return ", each component in turn" if (stage.name, name) == (FUSE, COMPONENT) else ""

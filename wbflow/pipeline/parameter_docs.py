"""Default, unit and meaning of the stages' parameters, from signatures and docstrings, for `wbflow stages`."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass

from .binding import method_parameters
from .functions import FunctionReader, Parameter
from .stages import COMPONENT, FUSE, Stage

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


def document(dotted: str, parameters: Iterable[Parameter], reader: FunctionReader) -> tuple[str, list[ParameterDoc]]:
    """The first paragraph of a function's docstring in one line, and unit and meaning of parameters."""
    _, _, node = reader.modules.function(dotted)
    text = ast.get_docstring(node) or ""
    texts = _parameter_texts(text)
    docs = []
    for parameter in parameters:
        unit, meaning = texts.get(parameter.name, ("", ""))
        default_unit = next((words for ending, words in _UNITS.items() if parameter.name.endswith(ending)), "")
        docs.append(ParameterDoc(parameter, unit or default_unit, meaning))
    return " ".join(text.split("\n\n")[0].split()), docs


def describe(stage: Stage, reader: FunctionReader) -> list[str]:
    """The lines that describe a stage and its methods at a terminal."""
    parameters = reader.signature(stage.function).parameters
    inputs = {*stage.inputs, *stage.offers}
    meaning, docs = document(stage.function, [p for name, p in parameters.items() if name not in inputs], reader)
    offers = f"; a function of your own may also take {', '.join(stage.offers)}" if stage.offers else ""
    lines = [f"{stage.name}  (each {stage.scope})  {meaning}", f"  {stage.function}, from {', '.join(stage.inputs)}{offers}"]
    lines += [line for doc in docs for line in _parameter_lines(doc, "  ", _where_set(stage, doc.parameter.name))]
    for name, dotted in reader.table(stage.method.table).items() if stage.method else ():
        meaning, docs = document(dotted, method_parameters(stage, reader)[name].values(), reader)
        default = stage.method and parameters[stage.method.parameter].default
        lines.append(f"  {name}{' (default)' if name == default else ''}: {meaning}")
        lines += [line for doc in docs for line in _parameter_lines(doc, "    ")]
    return lines


def _parameter_texts(docstring: str) -> dict[str, tuple[str, str]]:
    """Unit and meaning of the parameters in the section Parameters of a docstring, by name."""
    texts: dict[str, tuple[str, str]] = {}
    for head, body in _docstring_entries(docstring):
        names, _, text = head.partition(" : ") if " : " in head else head.partition(": ")
        text = text.strip()
        type_match = _TYPES.match(text)
        is_type = type_match and (type_match.end() == len(text) or text[: type_match.end()].rstrip().endswith(","))
        unit = text[type_match.end() :].strip() if type_match and is_type else ""
        meaning = " ".join([*([] if is_type else [text]), *body]).strip()
        texts |= {name.strip(): (unit, meaning) for name in names.replace("*", "").split(",")}
    return texts


def _docstring_entries(docstring: str) -> list[tuple[str, list[str]]]:
    """The head line and the further lines of each entry in the section Parameters."""
    lines = docstring.splitlines()
    entries: list[tuple[str, list[str]]] = []
    in_section = False
    for line, next_line in zip(lines, [*lines[1:], ""], strict=True):
        if next_line and not next_line.strip("-") and not line.startswith(" "):
            in_section = line.strip() in {"Parameters", "Other Parameters"}
        elif in_section and line.strip("-") and line.startswith(" ") and entries:
            entries[-1][1].append(line.strip())
        elif in_section and line.strip("-"):
            entries.append((line.strip(), []))
    return entries


def _where_set(stage: Stage, name: str) -> str:
    """The key of the site file that sets a parameter, as text, if it is not set in the stage's section."""
    section, _, key = stage.set_by_site().get(name, "").rpartition(".")
    if key:
        return f", set by {f'{key} in the section {section}' if section else f'{key} at the top'} of the site file"
    return ", each component in turn" if (stage.name, name) == (FUSE, COMPONENT) else ""


def _parameter_lines(doc: ParameterDoc, indent: str, where_set: str = "") -> list[str]:
    head = f"{indent}{doc.parameter.name} = {doc.parameter.shown}{where_set}{f' [{doc.unit}]' if doc.unit else ''}"
    choices = [str(choice) for choice in doc.parameter.choices]
    unlisted = [choice for choice in choices if choice not in doc.meaning]
    words = f"{doc.meaning} One of {', '.join(choices)}.".strip() if unlisted else doc.meaning
    return [head, *textwrap.wrap(words, _WIDTH, initial_indent=f"{indent}    ", subsequent_indent=f"{indent}    ")]

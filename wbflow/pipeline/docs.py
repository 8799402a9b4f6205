"""What docstrings say of parameters (NumPy style), read from source without importing."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass

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
    """What is said of one parameter."""

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
        names, _, told = head.partition(" : ") if " : " in head else head.partition(": ")
        told = told.strip()
        typed = _TYPES.match(told)
        ends_there = typed and (typed.end() == len(told) or told[: typed.end()].rstrip().endswith(","))
        unit = told[typed.end() :].strip() if typed and ends_there else ""
        meaning = " ".join([*([] if ends_there else [told]), *body]).strip()
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

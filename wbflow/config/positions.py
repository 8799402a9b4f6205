"""YAML read with the place of everything in it, so that an error can point at a line and a column."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from ..errors import ExitCode, WbflowError

Place = tuple[str | int, ...]
"""Where a value is: keys and list positions from the top."""

try:
    from yaml import CSafeLoader as _Loader
except ImportError:  # pragma: no cover  (PyYAML built without libyaml)
    from yaml import SafeLoader as _Loader  # type: ignore[assignment]


@dataclass(frozen=True)
class SiteProblem:
    """One thing that is wrong with an input file."""

    file: Path
    line: int
    """From 1; 0 where there is no such place."""
    column: int
    where: str
    """The place in words: `cameras[3].intrinsics`."""
    what: str
    remedy: str = ""

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}:{self.column}" if self.line else f"{self.file}"
        head = f"{place}: {self.where}: {self.what}" if self.where else f"{place}: {self.what}"
        return f"{head}\n  {self.remedy}" if self.remedy else head


class SiteError(WbflowError, ValueError):
    """The site file, or a file that it names, cannot be used.  `problems` holds everything found, not just the first."""

    exit_code = ExitCode.USAGE

    def __init__(self, problems: list[SiteProblem]) -> None:
        super().__init__("\n".join(map(str, problems)))
        self.problems = problems


@dataclass(frozen=True)
class Document:
    """A YAML file, and where everything stands in it."""

    path: Path
    data: Any
    """The YAML as Python."""
    marks: dict[Place, tuple[int, int]] = field(default_factory=dict)
    """(line, column) of each value."""
    key_marks: dict[Place, tuple[int, int]] = field(default_factory=dict)
    """Of each key."""
    texts: dict[Place, str] = field(default_factory=dict)
    """Scalars as written."""

    def problem(self, place: Place, what: str, remedy: str = "", key: bool = False) -> SiteProblem:
        """A problem at a place; where that place is not in the file, at the nearest one around it.

        Parameters
        ----------
        place : Place
            Keys and indices that lead there.
        what : str
            What is wrong.
        remedy : str
            What to do.
        key : bool
            Point at the key and not at its value?
        """
        marks = self.key_marks if key else self.marks
        at = place
        while at and at not in marks:
            at = at[:-1]
        line, column = marks.get(at, (1, 1))
        return SiteProblem(self.path, line, column, spell(place), what, remedy)


def spell(place: Place) -> str:
    """A place in words: `cameras[3].intrinsics`."""
    words = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in place)
    return words.removeprefix(".")


def load_yaml(path: Path) -> Document:
    """Read a YAML file.

    Raises
    ------
    SiteError
        It cannot be read, is not YAML, holds a key twice, or uses tags beyond plain data.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "is not UTF-8 text"
        raise SiteError([SiteProblem(path, 0, 0, "", f"cannot be read: {reason}", "give the path of a site file")]) from None
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        data = loader.construct_document(node) if node is not None else None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        remedy = "check indentation, colons and quotes around this place"
        raise SiteError([SiteProblem(path, line, column, "", f"not valid YAML: {error.problem}", remedy)]) from None
    except yaml.YAMLError as error:
        raise SiteError([SiteProblem(path, 1, 1, "", f"not valid YAML: {error}")]) from None
    finally:
        loader.dispose()
    document = Document(path, data)
    problems: list[SiteProblem] = []
    if node is not None:
        _walk(node, (), document, problems)
    if problems:
        raise SiteError(problems)
    return document


def _walk(node: Any, place: Place, document: Document, problems: list[SiteProblem]) -> None:
    document.marks[place] = (node.start_mark.line + 1, node.start_mark.column + 1)
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            inner = (*place, str(key.value))
            if inner in document.key_marks:
                mark = key.start_mark
                first = document.key_marks[inner][0]
                what, remedy = f"{key.value!r} stands here and on line {first}", "keep one of them"
                problems.append(SiteProblem(document.path, mark.line + 1, mark.column + 1, spell(inner), what, remedy))
            document.key_marks[inner] = (key.start_mark.line + 1, key.start_mark.column + 1)
            _walk(value, inner, document, problems)
    elif isinstance(node, yaml.SequenceNode):
        for position, item in enumerate(node.value):
            _walk(item, (*place, position), document, problems)
    else:
        document.texts[place] = node.value

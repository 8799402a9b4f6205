"""YAML with the line and column of every value and key, and problems reported at their location."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from yaml.constructor import ConstructorError
from yaml.events import CollectionEndEvent, CollectionStartEvent

from ..cache.untrusted import MOST_TEXT_BYTES, Unreadable, read_untrusted
from ..errors import ExitCode, WbflowError
from ..words import LONGEST, printable

try:
    from yaml import CSafeLoader as _Loader
except ImportError:  # pragma: no cover  (PyYAML built without libyaml)
    from yaml import SafeLoader as _Loader  # type: ignore[assignment]
Loader = _Loader

Location = tuple[str | int, ...]
"""Path to a value: keys and list indices from the top."""

_MOST_LEVELS = 40
"""Largest nesting depth that is accepted; a site file needs eight levels."""
_MOST_VALUES = 500_000
"""Largest number of values once aliases are expanded; a site with a thousand cameras has 30,000."""
_NESTED_INLINE = re.compile(r"[-?:] +(?=[-?])")
"""Matches block collections that are nested on one line."""
_LARGEST_INTEGER = 10**15
"""Largest magnitude of an integer that is accepted."""


@dataclass(frozen=True)
class Problem:
    """One problem in an input file."""

    file: Path
    line: int
    """From 1; 0 if the problem has no line."""
    column: int
    where: str
    """The location as text: `cameras[3].intrinsics`."""
    what: str
    remedy: str = ""

    @property
    def mark(self) -> str:
        """File, line and column."""
        return f"{self.file}:{self.line}:{self.column}" if self.line else f"{self.file}"

    def __str__(self) -> str:
        head = f"{self.mark}: {self.where}: {self.what}" if self.where else f"{self.mark}: {self.what}"
        return printable(f"{head}\n  {self.remedy}" if self.remedy else head, 4 * LONGEST)


class SiteError(WbflowError, ValueError):
    """The site file, or a file that it names, cannot be used.  `problems` holds all problems found, not just the first."""

    exit_code = ExitCode.USAGE

    def __init__(self, problems: list[Problem]) -> None:
        super().__init__("\n".join(map(str, problems)))
        self.problems = problems


class CalibrationError(WbflowError, ValueError):
    """A calibration file cannot be used; the message contains the problem and its place."""

    exit_code = ExitCode.USAGE

    @classmethod
    def from_site_error(cls, error: SiteError, remedy: str = "") -> CalibrationError:
        """The error for a file that could not be read, made from its first problem."""
        problem = error.problems[0]
        return cls(problem.what, where=problem.mark, remedy=remedy)


@dataclass(frozen=True)
class Document:
    """A YAML file with the line and column of every value and key."""

    path: Path
    data: Any
    """The content as Python objects."""
    marks: dict[Location, tuple[int, int]] = field(default_factory=dict)
    """(line, column) of each value."""
    key_marks: dict[Location, tuple[int, int]] = field(default_factory=dict)
    """(line, column) of each key."""
    texts: dict[Location, str] = field(default_factory=dict)
    """Each scalar as written."""

    def problem(self, location: Location, what: str, remedy: str = "", key: bool = False) -> Problem:
        """A problem at a location; if the file has no such location, at the nearest enclosing one.

        Parameters
        ----------
        location, key : Location, bool
            Path to the value; whether to point at its key instead of the value.
        what, remedy : str
            What is wrong, and how to fix it.
        """
        marks = self.key_marks if key else self.marks
        nearest = location
        while nearest and nearest not in marks:
            nearest = nearest[:-1]
        line, column = marks.get(nearest, (1, 1))
        return Problem(self.path, line, column, _location_text(location), what, remedy)


@dataclass(frozen=True)
class Problems:
    """The problems of a document, collected so that all are reported at once."""

    document: Document
    found: list[Problem] = field(default_factory=list)

    def add(self, location: Location, what: str, remedy: str, *, key: bool = False) -> None:
        """Add a problem.

        Parameters
        ----------
        location, what, remedy, key
            As for `Document.problem`.
        """
        self.found.append(self.document.problem(location, what, remedy, key))


def _location_text(location: Location) -> str:
    """A location as text: `cameras[3].intrinsics`."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in location).removeprefix(".")


ID = re.compile(r"[A-Za-z0-9_.-]{1,100}")
"""Characters and length of names of cameras and sites; `is_name` also excludes names that consist of dots only."""


def is_name(name: str) -> bool:
    """Is this a valid name for a camera or a site?  It becomes the name of a folder."""
    return bool(ID.fullmatch(name) and name.strip("."))


def resolve_path(path: str, location: Location, problems: Problems) -> Path:
    """A path from the site file, resolved relative to that file; an invalid path is added to `problems` at its location."""
    try:
        expanded = Path(path).expanduser()
    except (RuntimeError, ValueError) as error:
        remedy = "write a path relative to the site file, or from the root: /srv/captures"
        problems.add(location, f"{path!r} is not a path: {printable(error)}", remedy)
        expanded = Path(path)
    return Path(os.path.normpath(problems.document.path.resolve().parent / expanded))


def suggest(word: str, known: Iterable[str], otherwise: str) -> str:
    """A remedy that suggests the known word most similar to `word`, or `otherwise` if none is similar."""
    matches = difflib.get_close_matches(word, known, 1)
    return f"did you mean {printable(matches[0])!r}?" if matches else otherwise


def similar(path: Path) -> str:
    """A remedy that suggests a file with a similar name in the folder of a path that does not exist; "" if there is none."""
    try:
        names = [entry.name for entry in path.parent.iterdir()]
    except OSError:
        return ""
    return suggest(path.name, names, "")


def read_text(path: Path) -> str:
    """The text of an untrusted file.  Raises SiteError if it cannot be read or is not UTF-8."""
    try:
        return read_untrusted(path, MOST_TEXT_BYTES).decode("utf-8-sig")
    except Unreadable as error:
        raise SiteError([Problem(path, 0, 0, "", error.what, "give the path of a site file")]) from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        column = error.start - error.object.rfind(b"\n", 0, error.start)
        raise SiteError([Problem(path, line, column, "", "is not UTF-8 text", "save the file as UTF-8")]) from None


def load_yaml(path: Path) -> Document:
    """Read a YAML file.

    Raises SiteError if it cannot be read, is not YAML, has a duplicate key or tags beyond plain data, or would exhaust memory.
    """
    return parse_yaml(read_text(path), path)


def parse_yaml(text: str, path: Path) -> Document:
    """Parse the text of a YAML file.  Raises SiteError, as `load_yaml` does."""
    loader = None
    try:
        _refuse_deep_nesting(text)
        loader = _CheckingLoader(text)
        node = loader.get_single_node()
        if "&" in text and "*" in text:
            _refuse_alias_bomb(node)
        data = loader.construct_document(node) if node is not None else None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        what = f"not valid YAML: {printable(error.problem)}"
        raise SiteError([Problem(path, line, column, "", what, _remedy_at(text, line))]) from None
    except yaml.YAMLError as error:
        raise SiteError([Problem(path, 1, 1, "", f"not valid YAML: {printable(error)}", "save it as plain text")]) from None
    finally:
        if loader:
            loader.dispose()
    document = Document(path, data)
    problems: list[Problem] = []
    if node is not None:
        _record_marks(node, (), document, problems)
    if problems:
        raise SiteError(problems)
    return document


def _remedy_at(text: str, line: int) -> str:
    """A remedy for invalid YAML near a line, from the most frequent mistakes."""
    lines = text.splitlines()
    nearby = lines[max(0, line - 2) : line]
    if any("\t" in text_line[: len(text_line) - len(text_line.lstrip())] for text_line in nearby):
        return "indent with spaces: YAML allows no tabs there"
    if any(re.search(r"[:\[,-]\s+\{(camera|date|time)\b", text_line) for text_line in nearby):
        return "put what has {camera} or {date} in it in quotes: pattern: '{camera}.jpg'"
    return "check indentation, colons and quotes around this place"


class _CheckingLoader(Loader):
    """A loader that reports the location of values that are malformed (`!!int x`, `2026-99-99`) or too large."""

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        try:
            value = super().construct_object(node, deep=deep)
        except (ValueError, OverflowError, TypeError, KeyError, IndexError, AttributeError) as error:
            what = f"{_excerpt(node)} cannot be read: {printable(error, 80)}"
            raise ConstructorError(None, None, what, node.start_mark) from None
        if isinstance(value, int) and abs(value) > _LARGEST_INTEGER:
            raise ConstructorError(None, None, f"{_excerpt(node)} is too large a number", node.start_mark)
        return value


def _excerpt(node: Any) -> str:
    return printable(node.value if isinstance(node, yaml.ScalarNode) else "this", 40)


def _refuse_deep_nesting(text: str) -> None:
    """Refuse deep nesting from the parser's events: recursive construction would overflow the stack.  Raises MarkedYAMLError."""
    if text.count("[") + text.count("{") + len(_NESTED_INLINE.findall(text)) < _MOST_LEVELS and " " * _MOST_LEVELS not in text:
        return
    try:
        _check_depth(Loader(text))
    except yaml.MarkedYAMLError as error:
        if "nesting depth" not in str(error.problem):
            raise
        _check_depth(yaml.SafeLoader(text))  # libyaml's own limit marks the place where its look-ahead stopped


def _check_depth(loader: Any) -> None:
    try:
        depth = 0
        while (event := loader.get_event()) is not None:
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if depth > _MOST_LEVELS:
                raise ConstructorError(None, None, f"values are nested more than {_MOST_LEVELS} levels deep", event.start_mark)
    finally:
        loader.dispose()


def _refuse_alias_bomb(node: Any) -> None:
    """Refuse aliases that expand to more values than a machine can hold.  Raises YAMLError."""
    sizes: dict[int, int] = {}

    def size(part: Any) -> int:
        if isinstance(part, yaml.ScalarNode):
            return 1
        if id(part) in sizes:
            if sizes[id(part)] < 0:
                raise ConstructorError(None, None, "an alias that contains itself", part.start_mark)
            return sizes[id(part)]
        sizes[id(part)] = -1
        inner = [n for entry in part.value for n in (entry if isinstance(entry, tuple) else (entry,))]
        sizes[id(part)] = total = 1 + sum(map(size, inner))
        if total > _MOST_VALUES:
            raise ConstructorError(None, None, f"aliases that stand for more than {_MOST_VALUES:,} values", part.start_mark)
        return total

    if node is not None:
        size(node)


def _record_marks(node: Any, location: Location, document: Document, problems: list[Problem]) -> None:
    """Record the places of a value and of everything in it; duplicate keys are added to `problems`."""
    document.marks[location] = (node.start_mark.line + 1, node.start_mark.column + 1)
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            inner = (*location, str(key.value))
            mark = (key.start_mark.line + 1, key.start_mark.column + 1)
            if inner in document.key_marks:
                what = f"{key.value!r} is already given on line {document.key_marks[inner][0]}"
                problems.append(Problem(document.path, *mark, _location_text(inner), what, "keep one of them"))
            document.key_marks[inner] = mark
            _record_marks(value, inner, document, problems)
    elif isinstance(node, yaml.SequenceNode):
        for position, item in enumerate(node.value):
            _record_marks(item, (*location, position), document, problems)
    else:
        document.texts[location] = node.value

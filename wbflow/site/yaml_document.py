"""YAML with the line and column of every value and key, and problems reported at their location."""

from __future__ import annotations

import difflib
import os
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml
from yaml.constructor import ConstructorError
from yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, ScalarEvent

from ..cache.untrusted import MOST_TEXT_BYTES, Unreadable, read_untrusted
from ..errors import ExitCode, Location, WbflowError
from ..words import LONGEST, printable

try:
    from yaml import CSafeLoader as _Loader
except ImportError:  # pragma: no cover  (PyYAML built without libyaml)
    from yaml import SafeLoader as _Loader  # type: ignore[assignment]
Loader = _Loader

_MOST_LEVELS = 40
"""Largest nesting depth that is accepted; a site file needs eight levels."""
_MOST_VALUES = 500_000
"""Largest number of values once aliases are expanded; a site with a thousand cameras has 30,000."""
_LINES_OF_A_SLIP = 3
"""How many lines up to the one that YAML complains of are searched for the mistake that it is due to, without empty ones and
comments."""
_LARGEST_INTEGER = 10**15
"""Largest magnitude of an integer that is accepted."""


@dataclass(frozen=True)
class Problem:
    """One problem in an input file."""

    file: Path
    what: str
    remedy: str = ""
    line: int = 0
    """From 1; 0 if the problem has no line."""
    column: int = 0
    """From 1; 0 if the problem has no column."""
    where: str = ""
    """The location as text: `cameras[3].intrinsics`."""

    @property
    def mark(self) -> str:
        """File, line and column, as far as the problem has them."""
        return ":".join(str(part) for part in (self.file, self.line, self.column) if part)

    def __str__(self) -> str:
        text = f"{self.mark}: "
        if self.where:
            text += f"{self.where}: "
        text += self.what
        if self.remedy:
            text += f"\n  {self.remedy}"
        return printable(text, 4 * LONGEST)


class SiteError(WbflowError, ValueError):
    """The site file, or a file that it names, cannot be used.  `problems` holds all problems found, in the order of the file."""

    exit_code = ExitCode.USAGE

    def __init__(self, *problems: Problem) -> None:
        self.problems = sorted(problems, key=lambda problem: (str(problem.file), problem.line, problem.column))
        super().__init__("\n".join(map(str, self.problems)))


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

    def place(self, location: Location, key: bool = False) -> tuple[int, int]:
        """(line, column) of a value, or of its key; if the file has no such location, of the nearest enclosing one."""
        marks = self.key_marks if key else self.marks
        while location and location not in marks:
            location = location[:-1]
        return marks.get(location, (1, 1))


@dataclass(frozen=True)
class Problems:
    """The problems of a document, collected so that all are reported at once."""

    document: Document
    found: list[Problem] = field(default_factory=list)

    def add(self, location: Location, what: str, remedy: str, *, key: bool = False) -> None:
        """Add a problem.

        Parameters
        ----------
        location, key : Location, bool
            Path to the value; whether to point at its key instead of the value.
        what, remedy : str
            What is wrong, and how to fix it.
        """
        where = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in location).removeprefix(".")
        self.found.append(Problem(self.document.path, what, remedy, *self.document.place(location, key), where))


def is_name(name: str) -> bool:
    """Is this a valid name for a camera or a site?  It becomes the name of a folder."""
    return bool(re.fullmatch(r"[A-Za-z0-9_.-]{1,100}", name) and name.strip("."))


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
    if not matches:
        return otherwise
    return f"did you mean {printable(matches[0])!r}?"


def similar(path: Path) -> str:
    """A remedy that suggests a file with a similar name in the folder of a path that does not exist; "" if there is none."""
    try:
        names = [entry.name for entry in path.parent.iterdir()]
    except OSError:
        return ""
    for name in names:
        # macOS and some NAS write a letter and its accent as two characters: another name that looks the same
        if name != path.name and unicodedata.normalize("NFC", name) == unicodedata.normalize("NFC", path.name):
            how = "with its accents written in another way (Unicode NFC, NFD)"
            return f"{printable(name)} is there, {how}: copy its name from there"
    return suggest(path.name, names, "")


_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
"""How text files of UTF-16 begin, in which zero bytes are usual."""


def read_text(path: Path, remedy: str = "") -> str:
    """The text of an untrusted file.  Raises SiteError if it cannot be read (with this remedy) or is not UTF-8."""
    try:
        return read_untrusted(path, MOST_TEXT_BYTES).decode("utf-8-sig")
    except Unreadable as error:
        raise SiteError(Problem(path, error.what, remedy)) from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        column = error.start - error.object.rfind(b"\n", 0, error.start)
        if b"\0" in error.object and not error.object.startswith(_UTF_16):
            remedy = "export what it holds as text, such as JSON or YAML"
            raise SiteError(Problem(path, "is a binary file, not text", remedy, line, column)) from None
        raise SiteError(Problem(path, "is not UTF-8 text", "save the file as UTF-8", line, column)) from None


def load_yaml(path: Path) -> Document:
    """Read a YAML file.

    Raises SiteError if it cannot be read, is not YAML, has a duplicate key or tags beyond plain data, or would exhaust memory.
    """
    return parse_yaml(read_text(path, "give the path of a site file"), path)


def parse_yaml(text: str, path: Path) -> Document:
    """Parse the text of a YAML file.  Raises SiteError, as `load_yaml` does."""
    loader = None
    try:
        _refuse_bombs(text)
        loader = _CheckingLoader(text)
        node = loader.get_single_node()
        if node is None:
            return Document(path, None)
        data = loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        column = mark.column + 1 if mark else 1
        slip = _slip_before(text, line)
        if slip:
            raise SiteError(replace(slip, file=path)) from None
        what = f"not valid YAML: {printable(error.problem)}"
        raise SiteError(Problem(path, what, _remedy_at(text, line), line, column)) from None
    except yaml.YAMLError as error:
        raise SiteError(Problem(path, f"not valid YAML: {printable(error)}", "save it as plain text", 1, 1)) from None
    finally:
        if loader:
            loader.dispose()
    # the tree of nodes is walked for the places: the data have none
    problems = Problems(Document(path, data))
    _record_marks(node, (), problems)
    if problems.found:
        raise SiteError(*problems.found)
    return problems.document


def _slip_before(text: str, line: int) -> Problem | None:
    """A key without a space after its colon, or with `=`, on this line or the ones before it.

    YAML takes it for a text that goes on, and reports the next line.
    """
    lines = text.splitlines()
    written = [number for number in range(1, min(line, len(lines)) + 1) if lines[number - 1].split("#")[0].strip()]
    for number in reversed(written[-_LINES_OF_A_SLIP:]):
        match = re.match(r"(\s*(?:- )?)([A-Za-z_]\w*)(:|\s*=\s*)([^\s/=:].*)$", lines[number - 1])
        if match:
            before, key, sign, value = match.groups()
            if sign == ":":
                what = f"there is no space after the colon of {key!r}"
            else:
                what = f"{key!r} is followed by '=', not a colon"
            return Problem(Path(), what, f"write {key}: {printable(value, 80)}", number, len(before) + 1)
    return None


def _remedy_at(text: str, line: int) -> str:
    """A remedy for invalid YAML near a line, from the most frequent mistakes."""
    lines = text.splitlines()
    nearby = lines[max(0, line - 2) : line]
    for nearby_line in nearby:
        indentation = nearby_line[: len(nearby_line) - len(nearby_line.lstrip())]
        if "\t" in indentation:
            return "indent with spaces: YAML allows no tabs there"
    for nearby_line in nearby:
        if re.search(r"[:\[,-]\s+\{(camera|date|time)\b", nearby_line):
            return "put what has {camera} or {date} in it in quotes: pattern: '{camera}.jpg'"
    return "check indentation, colons and quotes around this place"


class _CheckingLoader(Loader):
    """A loader that reports the location of values that are malformed (`!!int x`, `2026-99-99`) or too large."""

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        # PyYAML lets the errors of Python's own conversions through, without a place
        try:
            value = super().construct_object(node, deep=deep)
        except (ValueError, OverflowError, TypeError, KeyError, IndexError, AttributeError) as error:
            what = f"{_excerpt(node)} cannot be read: {printable(error, 80)}"
            raise ConstructorError(None, None, what, node.start_mark) from None
        if isinstance(value, int) and abs(value) > _LARGEST_INTEGER:
            raise ConstructorError(None, None, f"{_excerpt(node)} is too large a number", node.start_mark)
        return value


def _excerpt(node: Any) -> str:
    """The value of a node as it is written, shortened; "this" for a mapping or a list."""
    text = node.value if isinstance(node, yaml.ScalarNode) else "this"
    return printable(text, 40)


def _refuse_bombs(text: str) -> None:
    """Refuse nesting that would overflow the stack, and aliases that expand to more values than a machine can hold.

    The parser's events suffice for this; nothing is constructed.  Raises YAMLError.
    """
    try:
        _check_events(Loader(text))
    except yaml.MarkedYAMLError as error:
        if "nesting depth" not in str(error.problem):
            raise
        _check_events(yaml.SafeLoader(text))  # libyaml's own limit marks the place where its look-ahead stopped


def _check_events(loader: Any) -> None:
    """Count nesting and values from the events of a parser.  Raises YAMLError."""
    open_collections: list[Any] = []
    counts = [0]  # number of values in the document, and in each open collection
    sizes: dict[str | None, int] = {}  # number of values that an alias stands for, by anchor
    try:
        while True:
            event = loader.get_event()
            if event is None:
                return
            if isinstance(event, CollectionStartEvent):
                open_collections.append(event)
                counts.append(1)
                if len(open_collections) > _MOST_LEVELS:
                    what = f"values are nested more than {_MOST_LEVELS} levels deep"
                    raise ConstructorError(None, None, what, open_collections[-1].start_mark)
            elif isinstance(event, CollectionEndEvent):
                start = open_collections.pop()
                size = counts.pop()
                if size > _MOST_VALUES:
                    what = f"aliases that stand for more than {_MOST_VALUES:,} values"
                    raise ConstructorError(None, None, what, start.start_mark)
                sizes[start.anchor] = size
                counts[-1] += size
            elif isinstance(event, AliasEvent):
                # an anchor is known only at the end of what it names: inside of that, the alias is a circle
                for start in open_collections:
                    if start.anchor == event.anchor:
                        raise ConstructorError(None, None, "an alias that contains itself", start.start_mark)
                counts[-1] += sizes.get(event.anchor, 1)
            elif isinstance(event, ScalarEvent):
                counts[-1] += 1
    finally:
        loader.dispose()


def _record_marks(node: Any, location: Location, problems: Problems) -> None:
    """Record the places of a value and of everything in it in the document; duplicate keys are added to `problems`."""
    document = problems.document
    document.marks[location] = (node.start_mark.line + 1, node.start_mark.column + 1)
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            inner = (*location, str(key.value))
            # PyYAML takes the last of two equal keys in silence
            first_mark = document.key_marks.get(inner)
            document.key_marks[inner] = (key.start_mark.line + 1, key.start_mark.column + 1)
            if first_mark:
                problems.add(inner, f"{key.value!r} is already given on line {first_mark[0]}", "keep one of them", key=True)
            _record_marks(value, inner, problems)
    elif isinstance(node, yaml.SequenceNode):
        for position, item in enumerate(node.value):
            _record_marks(item, (*location, position), problems)
    else:
        document.texts[location] = node.value

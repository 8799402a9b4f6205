"""YAML read with the place of everything in it, so that an error can point at a line and a column."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml
from yaml.constructor import ConstructorError
from yaml.events import CollectionEndEvent, CollectionStartEvent

from ..cache.artifact import digest
from ..cache.untrusted import MOST_TEXT_BYTES, Unreadable, read_outside
from ..errors import printable
from .places import Document, Place, SiteError, SiteProblem, spell

try:
    from yaml import CSafeLoader as _Loader
except ImportError:  # pragma: no cover  (PyYAML built without libyaml)
    from yaml import SafeLoader as _Loader  # type: ignore[assignment]

_DEEPEST = 40
"""Levels of values within values; a site file has eight."""
_MOST_VALUES = 500_000
"""Values that aliases may make of a file; a site of a thousand cameras has 30,000."""
_INLINE = re.compile(r"[-?:] +(?=[-?])")
"""Where block collections are nested on one line."""
_LARGEST = 10**15
"""Of whole numbers."""


def load_yaml(path: Path) -> Document:
    """Read a YAML file.

    Raises
    ------
    SiteError
        It cannot be read, is not YAML, holds a key twice, uses tags beyond plain data, or is made to exhaust whoever reads it.
    """
    try:
        text = read_outside(path, MOST_TEXT_BYTES).decode("utf-8-sig")
    except Unreadable as error:
        raise SiteError([SiteProblem(path, 0, 0, "", error.what, "give the path of a site file")]) from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        column = error.start - error.object.rfind(b"\n", 0, error.start)
        remedy = "save the file as UTF-8"
        raise SiteError([SiteProblem(path, line, column, "", "cannot be read: is not UTF-8 text", remedy)]) from None
    return parse_yaml(text, path)


def parse_yaml(text: str, path: Path) -> Document:
    """The same, of text that has been read.  path: for the words of an error."""
    loader = None
    try:
        _refuse_depth(text)
        loader = _Careful(text)
        node = loader.get_single_node()
        if "&" in text and "*" in text:
            _refuse_bomb(node)
        data = loader.construct_document(node) if node is not None else None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        remedy = _remedy_at(text, line)
        raise SiteError([SiteProblem(path, line, column, "", f"not valid YAML: {printable(error.problem)}", remedy)]) from None
    except yaml.YAMLError as error:
        raise SiteError([SiteProblem(path, 1, 1, "", f"not valid YAML: {printable(error)}", "save it as plain text")]) from None
    finally:
        if loader:
            loader.dispose()
    document = Document(path, data, digest=digest(text.encode()))
    problems: list[SiteProblem] = []
    if node is not None:
        _walk(node, (), document, problems)
    if problems:
        raise SiteError(problems)
    return document


def _remedy_at(text: str, line: int) -> str:
    """What to do about text that is no YAML, by what people write most."""
    lines = text.splitlines()
    near = lines[max(0, line - 2) : line]
    if any("\t" in each[: len(each) - len(each.lstrip())] for each in near):
        return "indent with spaces: YAML allows no tabs there"
    if any(re.search(r"[:\[,-]\s+\{(camera|date|time)\b", each) for each in near):
        return "put what has {camera} or {date} in it in quotes: pattern: '{camera}.jpg'"
    return "check indentation, colons and quotes around this place"


class _Careful(_Loader):
    """Says where a value stands that is none (`!!int x`, `2026-99-99`), or that no computer reckons with."""

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        try:
            value = super().construct_object(node, deep=deep)
        except (ValueError, OverflowError, TypeError, KeyError, IndexError, AttributeError) as error:
            raise ConstructorError(
                None, None, f"{_shown(node)} cannot be read: {printable(error, 80)}", node.start_mark
            ) from None
        if isinstance(value, int) and abs(value) > _LARGEST:
            raise ConstructorError(None, None, f"{_shown(node)} is too large a number", node.start_mark)
        return value


def _shown(node: Any) -> str:
    return printable(node.value if isinstance(node, yaml.ScalarNode) else "this", 40)


def _refuse_depth(text: str) -> None:
    """Told from the events alone: what is made of deep text is made recursively, and would overflow.  Raises MarkedYAMLError."""
    if text.count("[") + text.count("{") + len(_INLINE.findall(text)) < _DEEPEST and " " * _DEEPEST not in text:
        return
    loader: Any = _Loader(text)
    try:
        depth = 0
        while (event := loader.get_event()) is not None:
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if depth > _DEEPEST:
                raise ConstructorError(None, None, f"values within values, {_DEEPEST} deep", event.start_mark)
    finally:
        loader.dispose()


def _refuse_bomb(node: Any) -> None:
    """An alias stands for all that its anchor holds: a few lines can mean more values than any machine has.  Raises YAMLError."""
    sizes: dict[int, int] = {}

    def size(part: Any) -> int:
        if isinstance(part, yaml.ScalarNode):
            return 1
        if id(part) in sizes:
            if sizes[id(part)] < 0:
                raise ConstructorError(None, None, "an alias that stands for what it is in", part.start_mark)
            return sizes[id(part)]
        sizes[id(part)] = -1
        inner = [n for entry in part.value for n in (entry if isinstance(entry, tuple) else (entry,))]
        sizes[id(part)] = total = 1 + sum(map(size, inner))
        if total > _MOST_VALUES:
            raise ConstructorError(None, None, f"aliases that stand for more than {_MOST_VALUES:,} values", part.start_mark)
        return total

    if node is not None:
        size(node)


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

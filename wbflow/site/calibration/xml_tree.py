"""XML of calibrations: a plain tree with line numbers, and OpenCV's storage in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

from .calibrated import Faulty

_MOST_LEVELS = 40
"""Largest nesting depth; Metashape's files have eight levels."""


@dataclass
class Element:
    """An element with its place in the file."""

    tag: str
    attributes: dict[str, str]
    line: int
    text: str = ""
    children: list[Element] = field(default_factory=list)

    def find(self, *tags: str) -> Element | None:
        """The first element on a path of tags below this one; None if there is none."""
        return next(self.all(*tags), None)

    def all(self, *tags: str) -> Iterator[Element]:
        """All elements on a path of tags below this one."""
        first, *rest = tags
        for child in self.children:
            if child.tag != first:
                continue
            if rest:
                yield from child.all(*rest)
            else:
                yield child


def parse_xml(text: str) -> Element:
    """The root of an XML file.  Raises Faulty, whose location is a line.

    Declarations of document types and entities are refused: no calibration needs them, and they can exhaust memory.
    """
    parser = expat.ParserCreate()
    open_elements = [Element("", {}, 0)]

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, parser.CurrentLineNumber)
        open_elements[-1].children.append(element)
        open_elements.append(element)
        if len(open_elements) > _MOST_LEVELS:
            raise Faulty(f"elements are nested more than {_MOST_LEVELS} levels deep", (element.line,))

    def end(_: str) -> None:
        open_elements.pop()

    def characters(data: str) -> None:
        open_elements[-1].text += data

    def doctype(*_: object) -> None:
        raise Faulty("declares a document type, which no calibration needs", (parser.CurrentLineNumber,), "remove <!DOCTYPE ...>")

    parser.buffer_text = True  # one call for each text, not one for each line of it
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = characters
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        what = f"not valid XML: {expat.ErrorString(error.code)}"
        raise Faulty(what, (error.lineno,), "save the file again with the program that wrote it") from None
    except ValueError as error:
        if isinstance(error, Faulty):
            raise
        raise Faulty(f"not XML that can be read: {error}", (1,)) from None
    return open_elements[0].children[0]


def storage_data(element: Element) -> Any:
    """The value of an element of OpenCV's storage: a mapping, a list, a matrix with rows, cols and data, a number or a text."""
    if element.children:
        if all(child.tag == "_" for child in element.children):  # OpenCV's tag for the items of a list
            return [storage_data(child) for child in element.children]
        data = {child.tag: storage_data(child) for child in element.children}
        # a matrix is a mapping like any other: rows, cols, data
        if len(data) < len(element.children):
            raise Faulty(f"<{element.tag}> holds a key twice", (element.line,), "keep one of them")
        return data
    words = element.text.split()
    values = [_scalar(word) for word in words]
    if len(values) == 1:
        return values[0]
    # several words that are not all numbers are one text
    if not values or any(isinstance(value, str) for value in values):
        return element.text.strip().strip('"')
    return values


def _scalar(word: str) -> Any:
    """A word as an int or a float if it is one, else as text without quotes."""
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word.strip('"')

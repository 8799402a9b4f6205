"""Edit single values in the text of a YAML file: every other byte, including comments and layout, stays unchanged.

A library that rewrites the whole file moves comments between sections, and joins lists that are written over several lines;
here only the text of the changed value is replaced.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

from ..errors import Location
from ..site.yaml_document import Loader

Splice = tuple[int, int, str]
"""Start and end index in the text, and the replacement."""


class NotEditable(ValueError):
    """A value cannot be changed in the text: it is shared through an alias, or written in a form that is not supported."""


def put(text: str, location: Location, value: Any) -> str:
    """Return the text with a new value at a location, whose last step may be a new key of a mapping.  Raises NotEditable."""
    parent = _node_at(text, location[:-1])
    if isinstance(parent, yaml.MappingNode) and not any(key.value == str(location[-1]) for key, _ in parent.value):
        splice = _new_key(text, parent, str(location[-1]), value)
    else:
        splice = _replacement(text, _node_at(text, location), value)
    expected, container, key = _expected(text, location)
    container[key] = value
    return _apply(text, splice, expected)


def append(text: str, location: Location, value: Any) -> str:
    """Return the text with an item appended to the list at a location, which is not empty.  Raises NotEditable."""
    node = _node_at(text, location)
    end = _value_end(node.value[-1])
    if node.flow_style:
        splice = end, end, f", {flow(value)}"
    else:
        line_end = _line_end(text, end)
        splice = line_end, line_end, f"\n{' ' * node.start_mark.column}- {flow(value)}"
    expected, container, key = _expected(text, location)
    container[key].append(value)
    return _apply(text, splice, expected)


def remove(text: str, location: Location) -> str:
    """Return the text without an item of a list.  Raises NotEditable."""
    node = _node_at(text, location[:-1])
    index = location[-1]
    assert isinstance(index, int)
    if len(node.value) == 1:
        return put(text, location[:-1], [])
    item = node.value[index]
    if not node.flow_style:
        # whole lines, with the dash before the item and a comment after it
        start = text.rfind("\n", 0, item.start_mark.index) + 1
        end = _line_end(text, _value_end(item)) + 1
    elif index + 1 < len(node.value):
        # with the comma after it
        start = item.start_mark.index
        end = node.value[index + 1].start_mark.index
    else:
        # with the comma before it
        start = _value_end(node.value[index - 1])
        end = _value_end(item)
    splice = start, end, ""
    expected, container, key = _expected(text, location)
    del container[key]
    return _apply(text, splice, expected)


def flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    dumped = yaml.safe_dump(
        _with_integers(value), default_flow_style=True, width=float("inf"), sort_keys=False, allow_unicode=True
    )
    return str(dumped).removesuffix("...\n").strip()


def _with_integers(value: Any) -> Any:
    """Return a value with whole-numbered floats as int, so that 2.0 is written as 2."""
    if isinstance(value, dict):
        return {key: _with_integers(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_with_integers(inner) for inner in value]
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def _replacement(text: str, node: Any, value: Any) -> Splice:
    start = node.start_mark.index
    end = _value_end(node)
    if isinstance(node, yaml.CollectionNode) and not node.flow_style:
        # a block starts below its key, perhaps after comments; the new value is written on the key's line
        key_end = _key_end(text, start)
        return key_end, end, f" {flow(value)}{text[key_end:start].rstrip()}"
    is_empty_after_colon = start == end and text[start - 1 : start] == ":"
    space = " " if is_empty_after_colon else ""
    return start, end, f"{space}{flow(value)}"


def _key_end(text: str, start: int) -> int:
    """Return the end of the colon before a block; only comments and white space may be in between."""
    preceding = text[:start]
    while True:
        stripped = preceding.rstrip()
        line = stripped[stripped.rfind("\n") + 1 :]
        comment = re.search(r"(^|\s)#", line)
        if comment is None:
            if not stripped.endswith(":"):
                raise NotEditable("it has an anchor, or a tag")
            return len(stripped)
        preceding = stripped[: len(stripped) - len(line) + comment.start()]


def _new_key(text: str, mapping: Any, key: str, value: Any) -> Splice:
    if not mapping.value:
        return mapping.start_mark.index, mapping.end_mark.index, flow({key: value})
    end = _value_end(mapping.value[-1][1])
    entry = flow({key: value})[1:-1]
    if mapping.flow_style:
        return end, end, f", {entry}"
    end = _line_end(text, end)
    return end, end, f"\n{' ' * mapping.value[0][0].start_mark.column}{entry}"


def _value_end(node: Any) -> int:
    """Return where a value's own text ends, without the white space and comments that follow a block collection."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last_item = node.value[-1]
        return _value_end(last_item[1] if isinstance(last_item, tuple) else last_item)
    if isinstance(node, yaml.ScalarNode) and node.style in {"|", ">"}:
        raise NotEditable("it is a text over several lines")
    return int(node.end_mark.index)


def _line_end(text: str, index: int) -> int:
    end = text.find("\n", index)
    return len(text) if end < 0 else end


def _node_at(text: str, location: Location) -> Any:
    node: Any = yaml.compose(text, Loader)
    for step in location:
        if isinstance(step, int) and isinstance(node, yaml.SequenceNode):
            node = node.value[step]
        else:
            node = _value_of_key(node, str(step))
    return node


def _value_of_key(node: Any, name: str) -> Any:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if key.value == name:
                return value
    raise NotEditable("it is written in a way that cannot be changed here")


def _apply(text: str, splice: Splice, expected: Any) -> str:
    """Return the text with a splice applied; raise NotEditable unless its data are then as expected.

    The check makes this safe: whatever YAML the file has, an edit changes what it should, and nothing else, or is refused.
    """
    start, end, replacement = splice
    edited = f"{text[:start]}{replacement}{text[end:]}"
    try:
        is_expected = yaml.load(edited, Loader) == expected
    except yaml.YAMLError:
        is_expected = False
    if not is_expected:
        raise NotEditable("it shares its text with others (an alias), or is written in a way that cannot be changed here")
    return edited


def _expected(text: str, location: Location) -> tuple[Any, Any, Any]:
    """Return the data of a text, which the caller then changes as the text should change; and the list or mapping in it that
    contains the value at a location, with the value's index or key."""
    container = data = _without_aliases(yaml.load(text, Loader))
    for step in location[:-1]:
        container = container[_actual_key(container, step)]
    return data, container, _actual_key(container, location[-1])


def _without_aliases(data: Any) -> Any:
    """Return a copy of the data in which values shared through aliases are separate."""
    if isinstance(data, dict):
        return {key: _without_aliases(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_without_aliases(value) for value in data]
    return data


def _actual_key(data: Any, step: str | int) -> Any:
    """Return the key as the file has it: YAML reads an id that looks like a number as a number."""
    if isinstance(data, dict):
        for key in data:
            if str(key) == step:
                return key
    return step

"""Edit single values in the text of a YAML file: every other byte, including comments and layout, stays unchanged.

A library that rewrites the whole file moves comments between sections, and joins lists that are written over several lines;
here only the text of the changed value is replaced.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Sequence
from typing import Any

import yaml

from ..site.yaml_document import Loader, Location

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
    return _apply_checked(text, splice, location, lambda data: _set_value(data, location, value))


def append(text: str, location: Location, value: Any) -> str:
    """Return the text with an item appended to the list at a location.  Raises NotEditable."""
    node = _node_at(text, location)
    if not isinstance(node, yaml.SequenceNode) or not node.value:
        return put(text, location, [value])
    end = _value_end(node.value[-1])
    if node.flow_style:
        splice = end, end, f", {flow(value)}"
    else:
        line_end = _line_end(text, end)
        splice = line_end, line_end, f"\n{' ' * node.start_mark.column}- {flow(value)}"
    return _apply_checked(text, splice, location, lambda data: _value_at(data, location).append(value))


def remove(text: str, location: Location) -> str:
    """Return the text without an item of a list.  Raises NotEditable."""
    *list_location, index = location
    assert isinstance(index, int)
    node = _node_at(text, tuple(list_location))
    if len(node.value) == 1:
        return put(text, tuple(list_location), [])
    item = node.value[index]
    if not node.flow_style:
        splice = text.rfind("\n", 0, item.start_mark.index) + 1, _line_end(text, _value_end(item)) + 1, ""
    elif index + 1 < len(node.value):
        splice = item.start_mark.index, node.value[index + 1].start_mark.index, ""
    else:
        splice = _value_end(node.value[index - 1]), _value_end(item), ""
    return _apply_checked(text, splice, location, lambda data: _value_at(data, tuple(list_location)).pop(index))


def flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    dumped = yaml.safe_dump(value, default_flow_style=True, width=float("inf"), sort_keys=False, allow_unicode=True)
    return str(dumped).removesuffix("...\n").strip()


def _replacement(text: str, node: Any, value: Any) -> Splice:
    start, end = node.start_mark.index, _value_end(node)
    if isinstance(node, yaml.CollectionNode) and not node.flow_style:
        # a block starts below its key, perhaps after comments; the new value is written on the key's line
        key_end = _key_end(text, start)
        return key_end, end, f" {flow(value)}{text[key_end:start].rstrip()}"
    return start, end, f" {flow(value)}" if start == end and text[start - 1 : start] == ":" else flow(value)


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
    end = _value_end(mapping)
    entry = flow({key: value})[1:-1]
    if mapping.flow_style:
        end = _value_end(mapping.value[-1][1])
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
        elif isinstance(node, yaml.MappingNode) and (values := [v for key, v in node.value if key.value == str(step)]):
            node = values[0]
        else:
            raise NotEditable("it is written in a way that cannot be changed here")
    return node


def _apply_checked(text: str, splice: Splice, location: Location, change: Any) -> str:
    """Return the text with a splice applied; raise NotEditable unless it changes the data exactly as `change` does."""
    start, end, replacement = splice
    edited = f"{text[:start]}{replacement}{text[end:]}"
    expected = copy.deepcopy(_without_aliases(yaml.load(text, Loader)))
    change(expected)
    try:
        is_expected = yaml.load(edited, Loader) == expected
    except yaml.YAMLError:
        is_expected = False
    if not is_expected:
        raise NotEditable("it shares its text with others (an alias), or is written in a way that cannot be changed here")
    return edited


def _without_aliases(data: Any) -> Any:
    """Return a copy of the data in which values shared through aliases are separate."""
    if isinstance(data, dict):
        return {key: _without_aliases(value) for key, value in data.items()}
    return [_without_aliases(value) for value in data] if isinstance(data, list) else data


def _value_at(data: Any, location: Sequence[str | int]) -> Any:
    for step in location:
        data = data[_actual_key(data, step)]
    return data


def _set_value(data: Any, location: Location, value: Any) -> None:
    parent = _value_at(data, location[:-1])
    parent[_actual_key(parent, location[-1])] = value


def _actual_key(data: Any, step: str | int) -> Any:
    """Return the key as the file has it: YAML reads an id that looks like a number as a number."""
    return next((key for key in data if str(key) == step), step) if isinstance(data, dict) else step

"""Editing one value of a YAML file keeps every other byte."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

import pytest
import yaml

from wbflow.edit.splice import NotEditable, append, put, remove

TEMPLATE = Path(__file__).resolve().parents[3] / "sites" / "template.yaml"


def lines(before: str, after: str) -> list[str]:
    """The removed and added lines, marked with - and +."""
    return [line for line in difflib.ndiff(before.splitlines(), after.splitlines()) if line[0] in "-+"]


def test_a_new_item_is_appended_directly_below_the_last_one() -> None:
    text = "points:\n  - {id: a}   # first\n\n# What follows is of another section.\nresolution: 1600\n"
    assert append(text, ("points",), {"id": "b"}) == text.replace("# first\n", "# first\n  - {id: b}\n")


@pytest.mark.parametrize(
    ("text", "location", "value", "expected"),
    [
        ("a: 1  # one\n", ("a",), 2, "a: 2  # one\n"),
        ("a:\nb: 2\n", ("a",), [1], "a: [1]\nb: 2\n"),
        ("a: {b: 1, }  # x\n", ("a", "c"), "on", "a: {b: 1, c: 'on', }  # x\n"),
        ("a: {}\n", ("a", "c"), 1, "a: {c: 1}\n"),
        ("a:\n  b: 1   # one\n\nd: 2\n", ("a", "c"), 3, "a:\n  b: 1   # one\n  c: 3\n\nd: 2\n"),
        ("a:  # why\n  # and how\n  - [1, 2]\n  - [3, 4]\nb: 1\n", ("a",), [[5, 6]], "a: [[5, 6]]  # why\n  # and how\nb: 1\n"),
        ("- gate   # x\n- roof", (0,), {"id": "gate"}, "- {id: gate}   # x\n- roof"),
        ("b: 1", ("a",), [], "b: 1\na: []"),
        ("# Größe – ok 🚢\na: {b: 'ü'}  # ñ\n", ("a", "c"), "é", "# Größe – ok 🚢\na: {b: 'ü', c: é}  # ñ\n"),
        ("12: {x: 1}\n", ("12", "x"), 2, "12: {x: 2}\n"),
    ],
)
def test_putting_a_value_changes_only_that_value(text: str, location: tuple[str | int, ...], value: Any, expected: str) -> None:
    assert put(text, location, value) == expected


@pytest.mark.parametrize(
    ("text", "location", "expected"),
    [
        ("a: [1, 2, 3]  # x\n", ("a", 1), "a: [1, 3]  # x\n"),
        ("a: [1, 2, 3]\n", ("a", 2), "a: [1, 2]\n"),
        ("a: [1]\n", ("a", 0), "a: []\n"),
        ("a:\n- x: 1\n  y: 2  # of x\n# of z\n- z: 1\nb: 1\n", ("a", 0), "a:\n# of z\n- z: 1\nb: 1\n"),
        ("a:\n  - 1\n  - - 2\n    - 3\n\n# b\nb: 1\n", ("a", 1), "a:\n  - 1\n\n# b\nb: 1\n"),
        ("a:\n  - - 2\n    - 3\n\n# b\nb: 1\n", ("a", 0), "a: []\n\n# b\nb: 1\n"),
    ],
)
def test_removing_an_item_keeps_everything_else(text: str, location: tuple[str | int, ...], expected: str) -> None:
    assert remove(text, location) == expected


def test_values_shared_by_an_alias_are_not_editable() -> None:
    text = "a: &shared [1, 2]\nb: *shared\n"
    with pytest.raises(NotEditable, match="alias"):
        append(text, ("b",), 3)
    with pytest.raises(NotEditable, match="alias"):
        put(text, ("a", 0), 7)


def test_edits_of_the_template_change_only_their_own_lines() -> None:
    text = TEMPLATE.read_text()
    data = yaml.safe_load(text)
    for k, point in enumerate(data["control_points"]):
        after = put(text, ("control_points", k, "pixels", "crane-2"), [1, 2])
        assert len(lines(text, after)) == 2
        assert yaml.safe_load(after)["control_points"][k]["pixels"] == {**point["pixels"], "crane-2": [1, 2]}
    for k in range(len(data["cameras"])):
        whole = data["cameras"][k] if isinstance(data["cameras"][k], dict) else {"id": data["cameras"][k]}
        if isinstance(data["cameras"][k], dict):
            after = put(text, ("cameras", k, "mask"), "masks/new.png")
        else:
            after = put(text, ("cameras", k), {**whole, "mask": "masks/new.png"})
        assert len(lines(text, after)) <= 2
        assert yaml.safe_load(after)["cameras"][k] == {**whole, "mask": "masks/new.png"}

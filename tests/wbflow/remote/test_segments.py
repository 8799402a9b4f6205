"""Segments of an object store: what they tell comes back as it was, and nothing else is believed."""

from __future__ import annotations

import pytest

from wbflow.cache.signed import Damaged
from wbflow.remote.segments import Entry, Segment, many, next_name, outdated, whole_name

SEGMENT = Segment(
    {"cache/a/b.wbf": Entry(3, "d", "at"), "cache/a/b.json": Entry(2, "e")}, {"cache/a/b.json": b"\xff{"}, ("runs/x",)
)


def test_a_segment_comes_back_as_it_was_under_its_own_name_only() -> None:
    data = SEGMENT.encoded("index/1-a")
    assert Segment.decoded("index/1-a", data) == SEGMENT
    for name, found in (
        ("index/2-a", data),
        ("index/1-a", data[:-1]),
        ("index/1-a", b""),
        ("index/1-a", data[:20] + b"?" + data[21:]),
    ):
        with pytest.raises(Damaged):
            Segment.decoded(name, found)


@pytest.mark.parametrize("place", ["/etc/passwd", "../other/cache/x", "cache/../../x"])
def test_a_segment_tells_of_nothing_outside_the_work_folder(place: str) -> None:
    data = Segment({place: Entry(1, "d")}, {place: b"x"}).encoded("n")
    with pytest.raises(Damaged, match="not of a work folder"):
        Segment.decoded("n", data)


def test_names_count_and_what_two_whole_ones_follow_may_go() -> None:
    names: list[str] = []
    for k in range(60):
        names.append(next_name(names))
        if k % 20 == 19:
            names.append(whole_name(next_name(names)))
    assert names == sorted(names) and len(set(names)) == 63
    wholes = [name for name in names if name.endswith("-whole")]
    assert outdated(names) == names[: names.index(wholes[-2])] and outdated(names[:30]) == []
    assert not many(names) and many(names + [next_name(names)] * 30)

"""A change keeps its id for as long as it stands, whatever single nights show of it; ids are never given again."""

from __future__ import annotations

from functools import cache

from tests.helpers.changed_yard import CRATE, Box, BoxNight, box_night
from wbflow_stages.changes import find_changes
from wbflow_stages.contracts.ground_figures import UsedIds
from wbflow_stages.types import Changes

BOX: Box = ((2.2, -2.4, 0.0), (3.6, -1.2, 0.9))
ALL_BUT_ONE = ("c0", "c1", "c2")
SCREEN: Box = ((3.6, -5.4, 0.0), (5.6, -2.6, 4.0))
"""Hides `BOX` from the last camera."""


@cache
def night(*boxes: Box, seed: int = 1, blind: tuple[str, ...] = ()) -> BoxNight:
    return box_night(boxes, seed=seed, blind=blind)


def through(*nights: BoxNight, reference: BoxNight | None = None) -> list[Changes]:
    """The changes of each night, which knows those of the night before."""
    then = (reference or night(CRATE, seed=0)).arguments("reference_")
    found: list[Changes] = []
    for tonight in nights:
        found.append(find_changes(**tonight.arguments(), **then, previous=found[-1] if found else None))
    return found


def ids(found: Changes) -> list[str]:
    assert list(found.changes) == [change.id for change in found.changes.values()]
    return list(found.changes)


def test_a_change_keeps_its_id_through_a_night_that_does_not_see_it() -> None:
    hidden = night(CRATE, BOX, SCREEN, blind=ALL_BUT_ONE, seed=2)
    first, dark, third = through(night(CRATE, BOX), hidden, night(CRATE, BOX, seed=3))
    assert ids(first) == ids(third) == ["C1"]
    assert [found.changes["C1"].seen for found in (first, dark, third)] == [True, False, True]
    assert [found.changes["C1"].nights for found in (first, dark, third)] == [1, 1, 2]
    assert abs(dark.changes["C1"].volume - first.changes["C1"].volume) < 0.1
    volumes = dark.cut_fill
    assert volumes and volumes.gained_most > 1.4 * 1.2 * 0.9


def test_what_is_gone_ends_and_what_comes_back_is_another_change() -> None:
    first, gone, back = through(night(CRATE, BOX), night(CRATE, seed=2), night(CRATE, BOX, seed=3))
    assert (ids(first), ids(gone), ids(back)) == (["C1"], [], ["C2"])
    assert back.changes["C2"].nights == 1


def test_a_thing_that_vanished_keeps_its_id_until_it_is_back() -> None:
    first, second, back = through(
        night(CRATE), night(CRATE, seed=2), night(CRATE, BOX, seed=3), reference=night(CRATE, BOX, seed=0)
    )
    assert ids(first) == ids(second) == ["C1"]
    assert (second.changes["C1"].kind, second.changes["C1"].nights) == ("vanished", 2)
    assert ids(back) == []


def test_what_comes_to_stand_beside_a_change_is_another_one_and_they_never_merge() -> None:
    beside: Box = ((3.6, -2.4, 0.0), (5.0, -1.2, 0.9))
    both = [night(CRATE, BOX, beside, seed=seed) for seed in (2, 3)]
    first, second, third = through(night(CRATE, BOX), *both)
    assert ids(first) == ["C1"]
    assert sorted(ids(second)) == sorted(ids(third)) == ["C1", "C2"]
    assert third.changes["C1"].x < 3.2 and third.changes["C2"].x > 4.0


def test_a_change_that_grows_keeps_its_id() -> None:
    low: Box = ((2.2, -2.4, 0.0), (3.6, -1.2, 0.5))
    long: Box = ((2.2, -2.4, 0.0), (4.1, -1.2, 0.9))
    grown = through(night(CRATE, low), night(CRATE, BOX, seed=2), night(CRATE, long, seed=3))
    assert [ids(found) for found in grown] == [["C1"], ["C1"], ["C1"]]
    volumes = [found.changes["C1"].volume for found in grown]
    assert volumes == sorted(volumes)
    assert volumes[2] > 2 * volumes[0]


def test_a_moved_thing_has_one_id_and_what_was_two_stays_two() -> None:
    there: Box = ((-4.0, -2.9, 0.0), (-2.6, -1.7, 0.9))
    then = night(CRATE, BOX, seed=0)
    at_once = through(night(CRATE, there), night(CRATE, there, seed=2), reference=then)
    assert [(ids(found), found.changes["C1"].kind) for found in at_once] == [(["C1"], "moved")] * 2
    one_by_one = through(night(CRATE), night(CRATE, there, seed=2), reference=then)
    assert sorted(ids(one_by_one[1])) == ["C1", "C2"]
    assert {change.kind for change in one_by_one[1].changes.values()} == {"new", "vanished"}


def test_ids_of_other_references_are_not_given_again() -> None:
    found = find_changes(
        **night(CRATE, BOX).arguments(), **night(CRATE, seed=0).arguments("reference_"), used_ids=UsedIds(highest=16)
    )
    assert (ids(found), found.highest_id) == (["C17"], 17)


def test_a_night_that_cannot_be_compared_passes_on_what_is_known() -> None:
    (first,) = through(night(CRATE, BOX))
    lost = find_changes(**night(CRATE).arguments(), previous=first)
    assert not lost.compared
    third = find_changes(**night(CRATE, BOX).arguments(), **night(CRATE, seed=0).arguments("reference_"), previous=lost)
    assert ids(third) == ["C1"]

"""Volumes are intervals: what is seen, and what cameras cannot exclude; another camera or night that sees more narrows them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.helpers.changed_yard import CRATE, Box, BoxNight, box_night
from wbflow_stages.changes import find_changes
from wbflow_stages.types import Changes

BOX: Box = ((2.2, -2.4, 0.0), (3.6, -1.2, 0.9))
VOLUME = 1.4 * 1.2 * 0.9
TWO_AND_THE_BACK = (-20.0, 20.0, 175.0)
"""Directions of two cameras on one side, and of one opposite them."""


@cache
def night(*boxes: Box, seed: int = 1, back: bool = False) -> BoxNight:
    return box_night(boxes, seed=seed, turns_deg=TWO_AND_THE_BACK, blind=() if back else ("c2",))


def compared(tonight: BoxNight, then: BoxNight, previous: Changes | None = None) -> Changes:
    return find_changes(**tonight.arguments(), **then.arguments("reference_"), previous=previous)


def test_the_interval_holds_the_truth_and_shrinks_when_another_night_sees_the_back() -> None:
    then = night(CRATE, seed=0, back=True)
    front = compared(night(CRATE, BOX), then)
    both = compared(night(CRATE, BOX, seed=2, back=True), then, front)
    front_again = compared(night(CRATE, BOX, seed=3), then, both)
    widths = []
    for found in (front, both, front_again):
        change = found.changes["C1"]
        assert change.volume_least <= VOLUME <= change.volume_most
        assert abs(change.volume - VOLUME) < 2 * change.volume_sigma
        whole = found.cut_fill
        assert whole and whole.gained_least <= VOLUME <= whole.gained_most
        widths.append(change.volume_most - change.volume_least)
    assert widths[1] < 0.7 * widths[0]
    assert widths[2] < 0.7 * widths[0], "what was seen to be free stays free"


def test_the_interval_of_a_vanished_thing_holds_the_truth() -> None:
    found = compared(night(CRATE, back=True), night(CRATE, BOX, seed=0))
    change = found.changes["C1"]
    assert change.kind == "vanished"
    assert change.volume_least <= VOLUME <= change.volume_most
    assert found.cut_fill and found.cut_fill.lost_least <= VOLUME <= found.cut_fill.lost_most


def test_free_space_of_before_does_not_bind_a_thing_that_has_grown() -> None:
    then = night(CRATE, seed=0, back=True)
    first = compared(night(CRATE, BOX, back=True), then)
    long: Box = ((2.2, -2.4, 0.0), (4.6, -0.6, 1.4))
    grown = compared(night(CRATE, long, seed=2), then, first).changes["C1"]
    assert grown.volume_least <= 2.4 * 1.8 * 1.4 <= grown.volume_most


def test_a_site_without_changes_has_narrow_intervals_about_zero() -> None:
    whole = compared(night(CRATE), night(CRATE, seed=0)).cut_fill
    assert whole
    assert (whole.gained_least, whole.lost_least) == (0, 0)
    assert (whole.gained_most, whole.lost_most) == pytest.approx((0, 0), abs=0.1)


def sides_only(night: BoxNight, box: Box) -> BoxNight:
    """The night without the top of a box: low cameras and few pixels leave no more than its sides."""
    low, high = np.array(box)
    points = night.cloud.points
    over = np.all((points[:, :2] > low[:2] - 0.05) & (points[:, :2] < high[:2] + 0.05), axis=1)
    kept = ~(over & (night.cloud.normals[:, 2] > 0.5) & (points[:, 2] > high[2] - 0.1))
    cloud = night.cloud
    cloud = replace(
        cloud,
        points=cloud.points[kept],
        normals=cloud.normals[kept],
        colors=cloud.colors[kept],
        confidence=cloud.confidence[kept],
        views=cloud.views[kept],
        sigma_mm=cloud.sigma_mm[kept],
    )
    return replace(night, cloud=cloud)


def test_a_thing_of_which_only_sides_are_seen_is_in_the_balance_with_all_that_it_may_hide() -> None:
    whole = compared(sides_only(night(CRATE, BOX), BOX), night(CRATE, seed=0)).cut_fill
    assert whole
    assert whole.gained_least <= VOLUME <= whole.gained_most
    assert abs(whole.gained - VOLUME) < 2 * whole.gained_sigma
    assert whole.gained_most < 6 * VOLUME, "only what cameras could not see through"


def test_a_strip_of_wall_that_seems_to_have_moved_hides_nothing() -> None:
    strip: Box = ((-4.0, 4.93, 0.5), (-3.6, 5.0, 2.0))
    found = compared(night(CRATE, strip), night(CRATE, seed=0))
    assert found.count == 0
    assert found.cut_fill and 0.4 * 0.07 * 1.5 <= found.cut_fill.gained_most < 0.06

"""What appears, vanishes or moves is found at its place, with its volume; what no camera sees is unknown; no false changes."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest

from tests.helpers.changed_yard import CRATE, Box, BoxNight, box_night
from wbflow_stages.changes import find_changes
from wbflow_stages.exports.ground import changes_files, changes_preview
from wbflow_stages.types import NEW, UNKNOWN, VANISHED, Change, Changes, DepthMap, Float64s

NEW_BOX: Box = ((2.2, -2.4, 0.0), (3.6, -1.2, 0.9))


@cache
def night(*boxes: Box, seed: int = 0, brightness: float = 1.0, blind: tuple[str, ...] = ()) -> BoxNight:
    return box_night(boxes, seed=seed, brightness=brightness, blind=blind)


def compared(tonight: BoxNight, then: BoxNight, **parameters: Any) -> Changes:
    return find_changes(**tonight.arguments(), **then.arguments("reference_"), **parameters)


def only_change(found: Changes) -> Change:
    assert list(found.changes) == ["C1"]
    return found.changes["C1"]


def assert_matches_box(change: Change, box: Box) -> None:
    low, high = np.array(box)
    assert np.linalg.norm((low + high) / 2 - (change.x, change.y, change.z)) < 0.15
    assert change.volume == pytest.approx(float(np.prod(high - low)), rel=0.2)
    assert abs(change.volume - float(np.prod(high - low))) < 4 * change.volume_sigma
    assert (change.length, change.width) == pytest.approx(sorted((high - low)[:2])[::-1], abs=0.2)
    assert change.height == pytest.approx(high[2], abs=0.05)


def test_a_box_that_appeared_is_new() -> None:
    found = compared(night(CRATE, NEW_BOX, seed=1), night(CRATE))
    change = only_change(found)
    assert change.kind == "new"
    assert_matches_box(change, NEW_BOX)
    assert len(change.cameras.split(",")) >= 3
    inside = found.blob == 1
    assert set(found.label[inside]) == {NEW}
    assert np.median(found.distance[inside & np.isfinite(found.distance)]) > 0.2


def test_gained_and_lost_volumes_are_those_of_the_boxes_in_total_and_per_zone() -> None:
    zones = [
        {"name": "east", "polygon": [[2.9, -5], [6, -5], [6, 0], [2.9, 0]]},
        {"name": "far", "polygon": [[50, 0], [54, 0], [54, 4], [50, 4]]},
        {"name": "all", "polygon": [[-8, -5], [8, -5], [8, 4.8], [-8, 4.8]]},
    ]
    found = compared(night(NEW_BOX, seed=1), night(CRATE), zones=zones)
    whole, east, far = found.cut_fill, found.zones["east"], found.zones["far"]
    assert whole
    new, crate = 1.4 * 1.2 * 0.9, 2.0 * 1.6 * 1.2
    assert (whole.gained, whole.lost) == pytest.approx((new, crate), rel=0.1)
    assert abs(whole.gained - new) < 2 * whole.gained_sigma
    assert abs(whole.lost - crate) < 2 * whole.lost_sigma
    assert east.gained == pytest.approx(new / 2, rel=0.1)
    assert east.lost == 0.0
    assert 0 < east.lost_sigma < 0.1, "less than the least change may be there"
    assert (far.gained, far.area) == (0.0, 0.0)
    assert far.unseen == pytest.approx(16.0)
    assert found.zones["all"].gained == pytest.approx(whole.gained)


def test_a_night_without_changes_has_gained_and_lost_nothing() -> None:
    found = compared(night(CRATE, seed=1), night(CRATE)).cut_fill
    assert found
    assert (found.gained, found.lost) == (0.0, 0.0)
    assert found.area > 20 * found.unseen
    assert 0.01 < found.level < 0.1
    assert found.common_sigma < 0.002


def test_a_box_that_was_taken_away_has_vanished() -> None:
    found = compared(night(NEW_BOX, seed=1), night(CRATE, NEW_BOX))
    change = only_change(found)
    assert change.kind == "vanished"
    assert_matches_box(change, CRATE)
    assert set(found.label[found.blob == 1]) == {VANISHED}


def test_a_box_that_stands_elsewhere_has_moved() -> None:
    there: Box = ((-4.0, -2.9, 0.0), (-2.6, -1.7, 0.9))
    change = only_change(compared(night(CRATE, there, seed=1), night(CRATE, NEW_BOX)))
    assert change.kind == "moved"
    assert_matches_box(change, there)
    assert (change.from_x, change.from_y) == pytest.approx((2.9, -1.8), abs=0.15)


def test_a_new_object_of_another_shape_is_not_taken_for_a_moved_one() -> None:
    long: Box = ((-5.0, -2.5, 0.0), (-2.9, -1.7, 0.9))
    found = compared(night(CRATE, long, seed=1), night(CRATE, NEW_BOX))
    new, gone = sorted(found.changes.values(), key=lambda change: change.kind)
    assert (new.kind, gone.kind) == ("new", "vanished")
    assert new.volume == pytest.approx(gone.volume, rel=0.25)


@pytest.mark.parametrize("brightness", [1.0, 0.5, 1.5])
def test_a_change_of_light_is_not_reported_as_a_change(brightness: float) -> None:
    found = compared(night(CRATE, seed=1, brightness=brightness), night(CRATE))
    assert found.compared
    assert (found.count, found.changed_share) == (0, 0)
    assert found.noise == pytest.approx(1.0, abs=0.3)


def test_what_no_camera_sees_tonight_is_unknown_and_has_not_vanished() -> None:
    then = night(CRATE, NEW_BOX)
    blind = ("c0", "c1", "c2")
    found = compared(night(CRATE, NEW_BOX, seed=1, blind=blind), then)  # the one camera that is left does not see everything
    assert found.count == 0
    assert 0.01 < found.unknown_share < 0.5
    assert np.sum(found.label == UNKNOWN) > 100
    assert np.sum(found.label == VANISHED) == 0


def test_a_low_slab_is_reported_and_a_very_thin_one_is_not() -> None:
    slab: Box = ((2.0, -3.0, 0.0), (4.0, -1.0, 0.06))
    change = only_change(compared(night(CRATE, slab, seed=1), night(CRATE)))
    assert change.height == pytest.approx(0.06, abs=0.02)
    assert change.volume == pytest.approx(0.24, rel=0.25)
    thin: Box = ((2.0, -3.0, 0.0), (4.0, -1.0, 0.004))
    assert compared(night(CRATE, thin, seed=1), night(CRATE)).count == 0


def test_a_change_of_most_of_the_site_is_not_taken_for_noise() -> None:
    floor: Box = ((-6.0, -3.5, 0.0), (6.0, 4.9, 0.3))
    change = only_change(compared(night(CRATE, floor, seed=1), night(CRATE)))
    assert change.kind == "new"
    assert change.height == pytest.approx(0.3, abs=0.03)


def test_depths_that_the_pictures_contradict_give_no_change() -> None:
    correct, wrong = night(CRATE, seed=1), night(CRATE, NEW_BOX, seed=1)
    # frames of a night without the box, depths and cloud of one with it
    inconsistent = BoxNight(correct.cameras, correct.frames, wrong.depths, wrong.cloud)
    assert compared(wrong, night(CRATE)).count == 1
    assert compared(inconsistent, night(CRATE)).count == 0


def test_a_box_that_too_few_cameras_see_through_has_not_vanished() -> None:
    then, tonight = night(CRATE, NEW_BOX), night(CRATE, seed=1)
    assert only_change(compared(tonight, then)).kind == "vanished"
    # a lattice: tonight two cameras measure what is behind it, and the other two have no depth there
    depths = dict(tonight.depths)
    for name in ("c0", "c2"):
        seen = depths[name]
        gone = seen.depth > then.depths[name].depth + 0.1
        depths[name] = replace(seen, depth=np.where(gone, np.nan, seen.depth).astype(np.float32))
    assert compared(replace(tonight, depths=depths), then).count == 0
    # a night of few depths: three cameras see through the box in only five of eight columns
    for name in ("c0", "c1", "c2"):
        seen = tonight.depths[name]
        gone = (seen.depth > then.depths[name].depth + 0.1) & (np.arange(seen.depth.shape[1]) % 8 < 3)
        depths[name] = replace(seen, depth=np.where(gone, np.nan, seen.depth).astype(np.float32))
    found = compared(replace(tonight, depths=depths), then)
    assert found.cut_fill and found.cut_fill.lost == found.count == 0
    assert 2 * found.cut_fill.lost_sigma > 1.4 * 1.2 * 0.9, "a doubt is said"


def test_each_depth_map_is_read_once() -> None:
    reads: Counter[str] = Counter()

    class Read(dict[str, DepthMap]):
        def __getitem__(self, name: str) -> DepthMap:
            reads[name] += 1
            return super().__getitem__(name)

    tonight, then = night(CRATE, NEW_BOX, seed=1).arguments(), night(CRATE).arguments("reference_")
    tonight["depths"], then["reference_depths"] = Read(tonight["depths"]), Read(then["reference_depths"])
    find_changes(**tonight, **then)
    assert set(reads) == set(tonight["depths"])
    assert set(reads.values()) == {2}  # once for each night


def test_only_changes_in_a_zone_are_reported() -> None:
    tonight, then = night(CRATE, NEW_BOX, seed=1), night(CRATE)
    around = {"name": "quay", "polygon": [[1, -4], [5, -4], [5, 0], [1, 0]]}
    assert only_change(compared(tonight, then, zones=[around])).zone == "quay"
    assert compared(tonight, then, zones=[around | {"least_m": 3.0}]).count == 0
    assert compared(tonight, then, zones=[around | {"polygon": [[-5, -4], [-1, -4], [-1, 0]]}]).count == 0


def test_without_a_reference_nothing_is_compared() -> None:
    found = find_changes(**night(CRATE).arguments())
    assert (found.compared, found.count, found.changes) == (False, 0, {})
    assert list(changes_files(found)) == []
    assert cv2.imdecode(changes_preview(found), 1) is not None


def test_a_night_solved_in_another_frame_is_not_compared() -> None:
    tonight = night(CRATE, NEW_BOX, seed=1).arguments()
    poses = tonight["poses"]
    shifted = {name: replace(camera, C=camera.C + np.array([30.0, 0, 0])) for name, camera in poses.cameras.items()}
    found = find_changes(**{**tonight, "poses": replace(poses, cameras=shifted)}, **night(CRATE).arguments("reference_"))
    assert not found.compared


def picture(content: bytes) -> Float64s:
    """(h, w, 3) the values of a JPEG file."""
    image = cv2.imdecode(np.frombuffer(content, np.uint8), 1)
    assert image is not None
    return image.astype(np.float64)


def test_changes_are_written_as_cloud_json_and_pictures() -> None:
    found = compared(night(CRATE, NEW_BOX, seed=1), night(CRATE))
    files: dict[str, Any] = dict(changes_files(found))
    assert list(files) == ["changes.ply", "changes.json", "change-C1-before.jpg", "change-C1-after.jpg", "change-C1.jpg"]
    reported = json.loads(files["changes.json"])
    (row,) = reported["changes"]
    assert (row["id"], row["kind"], row["picture"]) == ("C1", "new", "change-C1.jpg")
    assert np.linalg.norm(np.subtract(row["position"], (2.9, -1.8, 0.45))) < 0.15
    columns = files["changes.ply"]
    assert {len(column) for column in columns.values()} == {len(found.points)}
    assert (row["before"], row["after"]) == ("change-C1-before.jpg", "change-C1-after.jpg")
    before = picture(files["change-C1-before.jpg"])
    after = picture(files["change-C1-after.jpg"])
    difference = np.abs(before - after).mean()
    assert difference > 5, "the two nights differ"
    both = picture(files["change-C1.jpg"])
    assert np.abs(both[:, : before.shape[1]] - before).mean() < 0.5 * difference, "the earlier night is on the left"
    assert np.abs(both[:, -after.shape[1] :] - after).mean() < 0.5 * difference
    assert cv2.imdecode(changes_preview(found), 1) is not None

"""Which findings follow from the cameras that are left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from tests.wbflow.verdict.test_rules import NAMES, PAIRS, camera, lost, night, pair, verdict_of
from wbflow.pipeline.summaries import PairFigures
from wbflow.records.acknowledgement import Acknowledgement
from wbflow.records.findings import Finding
from wbflow.records.record import CameraRecord, PairRecord, RunRecord
from wbflow.site.models import Expected
from wbflow.verdict.consequences import with_causes
from wbflow.verdict.facts import Facts

WHOLE = night("2026-11-19")


def without(*names: str) -> list[CameraRecord]:
    """The cameras, these being lost."""
    return [lost(name) if name in names else camera(name) for name in NAMES]


def usable(*names: str, rejected: Sequence[tuple[str, str]] = ()) -> list[PairRecord]:
    """All pairs; those of these cameras are skipped, and some are rejected."""
    found = []
    for left, right in PAIRS:
        outcome = "skipped" if {left, right} & set(names) else "rejected" if (left, right) in rejected else "ok"
        found.append(pair(left, right, outcome))
    return found


def found(record: RunRecord, kind: str) -> Finding:
    return next(finding for finding in verdict_of(record).findings if finding.kind == kind)


def test_pairs_and_points_that_a_lost_camera_costs_follow_from_it() -> None:
    tonight = night(cameras=without("roof"), pairs=usable("roof"), points=40_000, past=[WHOLE])
    assert found(tonight, "camera-lost").follows == ()
    assert found(tonight, "fewer-points").follows == ("roof",)
    assert found(tonight, "fewer-pairs").follows == ("roof",)
    assert tonight.exit_code == 3


def test_a_loss_that_the_camera_cannot_explain_stands_by_itself() -> None:
    tonight = night(cameras=without("roof"), pairs=usable("roof"), points=6_000, past=[WHOLE])
    assert found(tonight, "fewer-points").follows == ()
    assert found(tonight, "fewer-pairs").follows == ("roof",)


def test_pairs_of_other_cameras_that_find_nothing_do_not_follow_from_a_lost_one() -> None:
    tonight = night(cameras=without("roof"), pairs=usable("roof", rejected=[("crane", "gate"), ("gate", "mast")]), past=[WHOLE])
    assert found(tonight, "fewer-pairs").follows == ()


def test_a_pair_that_gave_most_of_the_cloud_explains_most_of_the_loss() -> None:
    """On the last good night, pairs of the roof gave depth for 90 % of their pictures, the others for 10 %."""
    shares = [replace(pair(*names), figures=PairFigures(density=0.9 if "roof" in names else 0.1)) for names in PAIRS]
    tonight = night(cameras=without("roof"), pairs=usable("roof"), points=8_000, past=[night("2026-11-19", pairs=shares)])
    assert found(tonight, "fewer-points").follows == ("roof",)


def test_without_an_earlier_night_pairs_are_counted_as_planned() -> None:
    first = night(cameras=without("roof", "mast"), pairs=usable("roof", "mast"))
    assert found(first, "fewer-pairs").follows == ("mast", "roof")


def test_a_number_that_the_site_file_expects_is_missed_because_of_the_camera() -> None:
    expected = Expected(pairs=6, cameras=4)
    tonight = night(cameras=without("roof"), pairs=usable("roof"), expected=expected)
    assert found(tonight, "fewer-pairs").follows == ("roof",)
    assert found(tonight, "fewer-cameras").follows == ("roof",)


def test_no_cloud_follows_from_the_cameras_of_all_pairs() -> None:
    tonight = night(cameras=without("gate", "mast", "roof"), pairs=[], points=0, past=[WHOLE])
    assert found(tonight, "no-cloud").follows == ("gate", "mast", "roof")
    assert tonight.exit_code == 1


def test_no_cloud_of_two_cameras_that_share_nothing_stands_by_itself() -> None:
    rejected = usable("mast", "roof", rejected=[("crane", "gate")])
    tonight = night(cameras=without("mast", "roof"), pairs=rejected, points=0, past=[WHOLE])
    assert found(tonight, "no-cloud").follows == ()


def test_a_camera_that_delivers_the_picture_of_another_has_not_moved() -> None:
    moved = Finding("camera-moved", ("roof",), "the known pose of roof contradicts the images")
    alike = Finding("cameras-alike", ("gate", "roof"), "gate, roof deliver the same picture")
    crane = replace(moved, subject=("crane",))
    assert with_causes([moved, crane, alike], WHOLE, Facts()) == (crane, alike)


def test_nothing_follows_if_all_cameras_are_in_use() -> None:
    tonight = night(pairs=usable("roof"), past=[WHOLE])
    assert found(tonight, "fewer-pairs").follows == ()


def test_nothing_follows_from_a_camera_whose_finding_is_acknowledged_and_thus_not_shown() -> None:
    known = Facts(acknowledged=(Acknowledgement("camera-lost roof", "ops", "2026-11-19"),))
    tonight = night(cameras=without("roof"), pairs=usable("roof"), past=[WHOLE], facts=known)
    assert found(tonight, "fewer-pairs").follows == ()

"""Which findings are explained by the cameras that are left out."""

from __future__ import annotations

from dataclasses import replace

from tests.helpers import made_up_run
from wbflow.records.findings import Finding, Verdict
from wbflow.records.record import CameraRecord, RunRecord
from wbflow.verdict.consequences import consequences

STALE = Finding("camera-stale", ("cam-4",), "the picture is frozen", remedy="restart the camera")


def amount(name: str, value: float, usual: float) -> Finding:
    return Finding(f"fewer-{name}", (), f"{value:.0f} {name}", {name: value}, {name: usual})


def night(*findings: Finding) -> RunRecord:
    """A night of four cameras, without the last one."""
    cameras = [CameraRecord(name, "ok") for name in made_up_run.names(4)]
    cameras[3] = CameraRecord("cam-4", "skipped", "camera cam-4 is stale")
    return made_up_run.record(made_up_run.names(4), cameras=tuple(cameras), verdict=Verdict("degraded", findings))


def test_pairs_and_points_that_a_frozen_camera_costs_are_its_consequence() -> None:
    pairs, points = amount("pairs", 3, 6), amount("points", 60_000, 110_000)
    assert consequences(night(STALE, pairs, points)) == (pairs, points)


def test_a_loss_that_one_camera_cannot_explain_stands_by_itself() -> None:
    pairs, points = amount("pairs", 3, 6), amount("points", 6_000, 110_000)
    assert consequences(night(STALE, pairs, points)) == (pairs,)


def test_nothing_is_a_consequence_if_all_cameras_are_in_use() -> None:
    whole = night(STALE, amount("pairs", 3, 6))
    used = replace(whole, cameras=tuple(CameraRecord(name, "ok") for name in made_up_run.names(4)))
    assert consequences(used) == ()


def test_nothing_is_a_consequence_of_a_camera_that_has_no_finding() -> None:
    assert consequences(night(amount("pairs", 3, 6))) == ()

"""Poses taken from the calibration."""

from __future__ import annotations

import numpy as np

from wbflow_stages.poses import solve_poses
from wbflow_stages.types import Placement, Poses, Rejected, Survey, View

K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])


def test_stated_cameras_are_used_and_the_others_report_what_is_missing() -> None:
    views = {name: View(640, 480, K) for name in ("gate", "roof")} | {"mast": View(640, 480)}
    R, C = np.eye(3), np.array([1.0, 2.0, 3.0])
    poses = solve_poses(views, {"gate": Placement(R, C), "roof": Placement(R, None), "mast": Placement(R, C)}, {})
    assert isinstance(poses, Poses)
    assert list(poses.cameras) == ["gate"]
    assert np.array_equal(poses.cameras["gate"].C, C) and poses.cameras["gate"].width == 640
    assert poses.unsolved == {
        "roof": "no pose given, and it has no pair from which to solve it",
        "mast": "no intrinsics given, and it has no pair from which to solve it",
    }
    assert poses.metric and poses.source == "calibration"


def test_cameras_fed_back_keep_their_coordinate_system_and_non_metric_scale() -> None:
    views = {name: View(640, 480, K) for name in ("gate", "roof")}
    placements = {name: Placement(np.eye(3), np.array([x, 0.0, 0.0]), metric=False) for x, name in enumerate(views)}
    poses = solve_poses(views, placements, {}, Survey(crs="+proj=topocentric"))
    assert isinstance(poses, Poses)
    assert poses.crs == "+proj=topocentric" and not poses.metric and "not metric" in poses.scale


def test_without_any_pose_or_pair_poses_are_rejected() -> None:
    assert isinstance(solve_poses({"gate": View(640, 480, K)}, {}, {}), Rejected)

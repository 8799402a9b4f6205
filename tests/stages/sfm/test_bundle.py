"""Bundle adjustment of cameras and points to their observations."""

from __future__ import annotations

import numpy as np

from wbflow_stages.sfm.bundle import adjust
from wbflow_stages.sfm.tracks import Tracks
from wbflow_stages.types import Camera


def test_bundle_adjustment_without_used_observations_changes_nothing() -> None:
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    cameras = {view: Camera(K, np.eye(3), np.array([float(view), 0, 0]), 640, 480) for view in (0, 1)}
    tracks = Tracks(np.zeros(2, np.int32), np.array([0, 1], np.int32), np.array([[320.0, 240], [270, 240]]), 1)
    X = np.array([[0.0, 0, 10]])
    after, points = adjust(cameras, tracks, X, np.zeros(2, np.bool_), loss_px=1.0, tolerance=1e-6)
    assert after == cameras and np.array_equal(points, X)

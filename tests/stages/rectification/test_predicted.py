"""What two known cameras see in common is predicted from their poses and from the stated extent of the scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.helpers.flat_ground import cameras
from wbflow_stages.core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance, triangulate_depth
from wbflow_stages.rectification.predicted import axes_meet_at, predict
from wbflow_stages.types import Scene

ONE, TWO = list(cameras().values())[:2]


def test_predicted_points_obey_the_cameras_and_lie_in_both_images() -> None:
    found = predict(ONE, TWO)
    assert found is not None
    assert symmetric_epipolar_distance(fundamental_from_cameras(ONE, TWO), found.x1, found.x2).max() < 1e-6
    for x, camera in ((found.x1, ONE), (found.x2, TWO)):
        assert (x > -0.5).all() and (x < [camera.width - 0.5, camera.height - 0.5]).all()


def test_the_viewing_axes_meet_where_both_cameras_look() -> None:
    assert abs(axes_meet_at(ONE, TWO) - np.linalg.norm(ONE.C)) < 1e-9


def test_predicted_points_lie_on_known_ground() -> None:
    found = predict(ONE, TWO, Scene(ground=np.array([0.0, 0.0, 1.0, 0.0])))
    assert found is not None
    depth, _ = triangulate_depth(ONE, TWO, found.x1, found.x2)
    ground = -ONE.C[2] / ((ONE.R.T @ np.linalg.inv(ONE.K) @ np.column_stack([found.x1, np.ones(len(depth))]).T)[2])
    assert np.median(np.abs(depth / ground - 1)) < 0.03


def test_a_scene_box_limits_the_predicted_depth() -> None:
    box = np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 1.0]])
    found = predict(ONE, TWO, Scene(box))
    assert found is not None
    depth, _ = triangulate_depth(ONE, TWO, found.ends1, found.ends2)
    reach = np.linalg.norm(ONE.C) + np.linalg.norm(box[1] - box[0])
    assert (depth < reach).all()


def test_cameras_that_look_in_opposite_directions_share_no_points() -> None:
    away = replace(TWO, R=np.diag([-1.0, 1.0, -1.0]) @ TWO.R)
    assert predict(ONE, away) is None

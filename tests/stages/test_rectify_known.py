"""Cameras that are known give the rows without a single match; dense matching has to confirm them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.helpers.flat_ground import cameras, frame_of, texture
from wbflow_stages.core.cameras import project
from wbflow_stages.rectification.warping import to_rectified
from wbflow_stages.rectify import rectify
from wbflow_stages.types import Rectification, Rejected

ONE, TWO = list(cameras().values())[:2]
FRAMES = frame_of(ONE, texture()), frame_of(TWO, texture())


def test_known_cameras_are_rectified_without_matches() -> None:
    found = rectify(None, ONE, TWO, None, *FRAMES)
    assert isinstance(found, Rectification)
    assert found.verified == "dense"
    X = np.array([[0.3, 0.2, 0.0], [-1.0, 0.8, 0.0], [1.5, -0.6, 0.0]])
    y1, y2 = to_rectified(found, 1, project(ONE, X)[0]), to_rectified(found, 2, project(TWO, X)[0])
    np.testing.assert_allclose(y1[:, 1], y2[:, 1], atol=1e-6)
    disparity = y1[:, 0] - y2[:, 0]
    assert (disparity > found.disparity_min_px).all() and (disparity < found.disparity_max_px).all()


@pytest.mark.parametrize("degrees", [-3.0, 3.0])
def test_a_camera_that_is_tilted_by_three_degrees_is_not_confirmed(degrees: float) -> None:
    turn = cv2.Rodrigues(np.array([np.radians(degrees), 0.0, 0.0]))[0]
    found = rectify(None, ONE, replace(TWO, R=turn @ TWO.R), None, *FRAMES)
    assert isinstance(found, Rejected)
    assert found.code in {"rows-not-confirmed", "too-few-epipolar-lines"}


def test_without_matches_cameras_or_frames_nothing_is_known() -> None:
    found = rectify(None, ONE, None, None, *FRAMES)
    assert isinstance(found, Rejected)
    assert found.code == "nothing-known"

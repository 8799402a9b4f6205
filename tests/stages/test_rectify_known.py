"""Known cameras give the rows without a single match; dense matching has to confirm them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.helpers.flat_ground import cameras, frame_of, texture
from tests.helpers.two_views import geometry_of
from wbflow_stages.core.cameras import project
from wbflow_stages.core.epipolar import fundamental_from_cameras
from wbflow_stages.core.residual_distortion import distorted_pixels, without_distortion
from wbflow_stages.rectification.warping import from_rectified, to_rectified
from wbflow_stages.rectify import rectify
from wbflow_stages.stereo.rectified import rectified_pair
from wbflow_stages.types import Geometry, Rectification, Rejected, Scene

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
def test_a_camera_tilted_by_three_degrees_is_not_confirmed(degrees: float) -> None:
    turn = cv2.Rodrigues(np.array([np.radians(degrees), 0.0, 0.0]))[0]
    found = rectify(None, ONE, replace(TWO, R=turn @ TWO.R), None, *FRAMES)
    assert isinstance(found, Rejected)
    assert found.code in {"rows-not-confirmed", "too-few-epipolar-lines"}


def test_solved_distortion_is_removed_from_matches_and_frames() -> None:
    """Distorted frames give straight rows, both with matches in distorted pixels and with dense matching."""
    left, right = (replace(camera, radial=(-0.2, 0.02)) for camera in (ONE, TWO))
    height, width = FRAMES[0].mask.shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    bent = []
    for frame, lens in zip(FRAMES, (left, right), strict=True):
        u, v = without_distortion(lens, np.column_stack([x.ravel(), y.ravel()])).T.astype(np.float32).reshape(2, height, width)
        image = np.asarray(cv2.remap(frame.image, u, v, cv2.INTER_LINEAR), np.uint8)
        bent.append(replace(frame, image=image))
    found = rectify(None, left, right, None, bent[0], bent[1])
    assert isinstance(found, Rectification) and found.verified == "dense"
    assert found.bend1 is not None and found.bend2 is not None
    undistorted = rectify(None, ONE, TWO, None, *FRAMES)
    assert isinstance(undistorted, Rectification) and undistorted.bend1 is None
    assert found.row_share > 0.8 * undistorted.row_share
    matched = matches_at(0.0, 0.4)
    there = [
        np.column_stack(distorted_pixels(bend, *points.T))
        for bend, points in zip((found.bend1, found.bend2), (matched.x1, matched.x2), strict=True)
    ]
    by_matches = rectify(replace(matched, x1=there[0].astype(np.float64), x2=there[1].astype(np.float64)), left, right)
    assert isinstance(by_matches, Rectification) and by_matches.vertical_px < 0.05


def test_without_matches_and_both_cameras_rectification_is_rejected() -> None:
    found = rectify(None, ONE, None, None, *FRAMES)
    assert isinstance(found, Rejected)
    assert found.code == "nothing-known"


GROUND = Scene(ground=np.array([0.0, 0.0, 1.0, 0.0]))


def matches_at(*heights: float, spread: float = 0.6) -> Geometry:
    """Sixty matches of points at each height above the ground, at most `spread` from its middle in x and in y."""
    rng = np.random.default_rng(2)
    X = np.concatenate([np.column_stack([rng.uniform(-spread, spread, (60, 2)), rng.normal(z, 0.05, 60)]) for z in heights])
    found = geometry_of(project(ONE, X)[0], project(TWO, X)[0], fundamental_from_cameras(ONE, TWO))
    return replace(found, view1=FRAMES[0].view, view2=FRAMES[1].view)


def range_and_disparity(found: Rectification, height: float) -> tuple[float, float, float]:
    """Smallest disparity of the range, disparity of a point in the middle at this height, and largest of the range."""
    X = np.array([[0.0, 0.0, height]])
    disparity = to_rectified(found, 1, project(ONE, X)[0])[0, 0] - to_rectified(found, 2, project(TWO, X)[0])[0, 0]
    return found.disparity_min_px, float(disparity), found.disparity_max_px


def rectified(geometry: Geometry, scene: Scene | None) -> Rectification:
    found = rectify(geometry, ONE, TWO, None, *FRAMES, scene)
    assert isinstance(found, Rectification)
    return found


def test_known_ground_is_included_in_the_range_though_only_roofs_match() -> None:
    roofs = matches_at(3.5)
    low, ground, high = range_and_disparity(rectified(roofs, None), 0.0)
    assert not low < ground < high
    found = rectified(roofs, GROUND)
    for height in (0.0, 3.5):
        low, disparity, high = range_and_disparity(found, height)
        assert low < disparity < high
    assert found.verified == "sparse" and found.ground is not None


def test_known_ground_that_the_matches_reach_changes_nothing() -> None:
    found, without = (rectified(matches_at(-0.1, 1.0, spread=4.0), scene) for scene in (GROUND, None))
    assert found.ground is None
    np.testing.assert_array_equal(found.H1, without.H1)
    assert found.disparity_min_px == without.disparity_min_px and found.disparity_max_px == without.disparity_max_px


def test_look_alikes_beneath_the_ground_do_not_widen_the_range() -> None:
    found = rectified(matches_at(3.5, -6.0), GROUND)
    low, disparity, high = range_and_disparity(found, 3.5)
    assert low < disparity < high
    low, disparity, high = range_and_disparity(found, -6.0)
    assert not low < disparity < high


def test_known_ground_gives_a_prior_and_a_floor_but_no_reference_night() -> None:
    pair = rectified_pair(*FRAMES, rectified(matches_at(3.5), GROUND))
    assert pair.reference_left is None and pair.reference_right is None
    assert pair.prior_left is not None and pair.floor_left is not None and pair.floor_right is not None
    both = np.isfinite(pair.prior_left) & np.isfinite(pair.floor_left)
    assert both.any() and len(np.unique(np.sign(pair.prior_left - pair.floor_left)[both])) == 1


def test_no_ground_is_assumed_above_the_horizon() -> None:
    found = rectified(matches_at(3.5), GROUND)
    assert found.ground is not None
    far = np.array([0.0, 1.0, -0.5 * ONE.height])  # as if the camera looked along the ground
    prior = rectified_pair(*FRAMES, replace(found, ground=replace(found.ground, inverse_depth1=far))).prior_left
    assert prior is not None
    y, x = np.nonzero(np.isfinite(prior))
    pixels = from_rectified(found, 1, np.column_stack([x, y]).astype(np.float64))
    assert len(pixels) and pixels[:, 1].min() >= 0.5 * ONE.height

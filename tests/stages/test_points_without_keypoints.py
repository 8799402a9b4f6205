"""Matches of a matcher without keypoints are used for geometry, poses, rectification and disparity."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from tests.helpers.plug_ins import undistorted_frames
from tests.helpers.synthetic_site import small_yard
from wbflow_stages.core.cameras import relative_pose
from wbflow_stages.core.rotations import angle_between_deg
from wbflow_stages.disparity import match_dense
from wbflow_stages.features import detect
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.poses import solve_poses
from wbflow_stages.rectify import rectify
from wbflow_stages.sfm.tracks import SAME_PX, build_tracks, same_places
from wbflow_stages.types import Disparity, Features, Geometry, Matches, Pair, Poses, Rectification

GRID = "tests.helpers.plug_ins:grid_points"


@pytest.fixture(scope="module")
def geometries() -> dict[Pair, Geometry]:
    """Geometries of all pairs of three cameras."""
    found = {}
    for a, b in combinations(range(1, 4), 2):
        left, right = undistorted_frames()[a], undistorted_frames()[b]
        f, g = detect(left, min_keypoints=1), detect(right, min_keypoints=1)
        assert isinstance(f, Features) and isinstance(g, Features)
        matches = match(f, g, left_frame=left, right_frame=right, matcher=GRID, step_px=5)
        assert isinstance(matches, Matches) and matches.i1 is None and matches.matcher == GRID
        geometry = estimate_geometry(matches, f, g)
        assert isinstance(geometry, Geometry), geometry
        found[str(a), str(b)] = geometry
    return found


def test_frames_that_a_matcher_needs_but_does_not_get_are_named() -> None:
    features = detect(undistorted_frames()[1], min_keypoints=1)
    assert isinstance(features, Features)
    with pytest.raises(ValueError, match="needs left_frame"):
        match(features, features, matcher=GRID)


def test_geometry_from_grid_points_agrees_with_the_true_cameras(geometries: dict[Pair, Geometry]) -> None:
    for (a, b), geometry in geometries.items():
        assert geometry.i1 is None and geometry.i2 is None and geometry.score > 0
        R, _ = relative_pose(*(small_yard().cameras[int(name)].camera for name in (a, b)))
        assert geometry.cam2_R_cam1 is not None and angle_between_deg(R, geometry.cam2_R_cam1) < 0.2


def test_cameras_and_disparity_are_found_from_grid_points(geometries: dict[Pair, Geometry]) -> None:
    views = {str(k): undistorted_frames()[k].view for k in range(1, 4)}
    poses = solve_poses(views, {}, geometries)
    assert isinstance(poses, Poses) and len(poses.cameras) == 3
    left, right = undistorted_frames()[1:3]
    rectification = rectify(geometries["1", "2"], poses.cameras["1"], poses.cameras["2"])
    assert isinstance(rectification, Rectification)
    disparity = match_dense(left, right, rectification, matcher="sgbm")
    assert isinstance(disparity, Disparity) and disparity.density > 0.3


def test_nearby_points_of_one_view_become_one_observation(geometries: dict[Pair, Geometry]) -> None:
    tracks = build_tracks({(int(a), int(b)): geometry for (a, b), geometry in geometries.items()}, 4)
    assert (np.bincount(tracks.track) == 3).sum() > 50
    for view in range(1, 4):
        x = tracks.xy[tracks.view == view]
        gaps = np.linalg.norm(x[:, None] - x[None], axis=2) + 9 * np.eye(len(x))
        assert gaps.min() > SAME_PX


def test_same_places_pairs_mutually_nearest_points() -> None:
    x = np.array([[0.0, 0.0], [10.0, 0.0], [10.9, 0.0], [50.0, 0.0]])
    y = np.array([[52.0, 0.0], [11.0, 0.0], [0.5, 0.5]])
    a, b = same_places(x, y)
    assert list(zip(a.tolist(), b.tolist(), strict=True)) == [(0, 2), (2, 1)]
    assert len(same_places(x[:0], y)[0]) == 0

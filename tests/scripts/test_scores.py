"""Scores behave as defined, on clouds and cameras with known errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scores import (
    compare_clouds,
    correct_matches,
    epipolar_errors,
    pose_errors,
    true_correspondences,
    turn_errors_deg,
    voxel_means,
)

from wbflow_demo.render.cameras import look_at
from wbflow_demo.render.reference import count_views
from wbflow_stages.core.epipolar import fundamental_from_cameras
from wbflow_stages.types import Camera

PLANE = np.stack([*np.meshgrid(np.arange(0, 1, 0.02), np.arange(0, 1, 0.02)), np.zeros((50, 50))], axis=-1).reshape(-1, 3)


def raised(points: np.ndarray, height: float) -> np.ndarray:
    """The points, moved up by `height`."""
    return np.asarray(points + np.array([0, 0, height]))


def looking(centre: tuple[float, float, float], width: int = 160) -> Camera:
    """A camera that looks at the middle of the unit square."""
    K = np.array([[width, 0, (width - 1) / 2], [0, width, (width * 3 // 4 - 1) / 2], [0, 0, 1.0]])
    C = np.array(centre)
    return Camera(K, look_at(C, np.array([0.5, 0.5, 0.0])), C, width, width * 3 // 4)


def plane_depth(camera: Camera) -> np.ndarray:
    """True depth map of the plane z = 0."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(camera.K).T @ camera.R
    return np.asarray(-camera.C[2] / rays[..., 2], np.float32)


def test_a_cloud_equal_to_the_reference_is_perfect() -> None:
    score = compare_clouds(PLANE, PLANE, [0.001])
    assert score.F[0] == pytest.approx(1)
    assert score.accuracy_median == pytest.approx(0, abs=1e-12)


@given(st.floats(0.003, 0.3))
@settings(max_examples=25, deadline=None)
def test_a_shifted_cloud_is_right_only_at_tolerances_above_its_shift(distance: float) -> None:
    score = compare_clouds(raised(PLANE, distance), PLANE, [0.99 * distance, 1.01 * distance], voxel=0)
    assert score.accuracy.tolist() == [0, 1]
    assert score.completeness.tolist() == [0, 1]
    assert score.accuracy_median == pytest.approx(distance)


def test_half_a_cloud_is_accurate_and_half_complete() -> None:
    score = compare_clouds(PLANE[PLANE[:, 0] < 0.5], PLANE, [0.005])
    assert score.accuracy[0] == 1
    assert score.completeness[0] == pytest.approx(0.5, abs=0.03)
    assert score.F[0] == pytest.approx(2 / 3, abs=0.03)


def test_wrong_points_cost_accuracy_unless_they_lie_far_outside() -> None:
    near, far = raised(PLANE, 0.3), raised(PLANE, 5.0)
    assert compare_clouds(np.vstack([PLANE, near]), PLANE, [0.05]).accuracy[0] == pytest.approx(0.5, abs=0.01)
    assert compare_clouds(np.vstack([PLANE, far]), PLANE, [0.05]).accuracy[0] == 1


def test_scores_do_not_depend_on_the_density_of_points() -> None:
    many = np.vstack([PLANE, np.repeat(raised(PLANE[:100], 0.2), 200, axis=0)])
    assert compare_clouds(many, PLANE, [0.05]).accuracy[0] > 0.95


def test_points_without_coordinates_are_ignored_and_an_empty_cloud_scores_zero() -> None:
    with_nan = np.vstack([PLANE, np.full((10, 3), np.nan)])
    assert compare_clouds(with_nan, PLANE, [0.01]).accuracy[0] == 1
    nothing = compare_clouds(np.zeros((0, 3)), PLANE, [0.01, 0.1])
    assert nothing.F.tolist() == [0, 0]
    assert np.isnan(nothing.accuracy_median)
    with pytest.raises(ValueError, match="reference"):
        compare_clouds(PLANE, np.zeros((0, 3)), [0.01])


def test_thinning_keeps_one_mean_for_each_cell() -> None:
    thin = voxel_means(np.array([[0.1, 0.1, 0.1], [0.3, 0.1, 0.1], [1.5, 0, 0], [-0.1, 0, 0]]), 1.0)
    assert sorted(map(tuple, thin.round(6))) == [(-0.1, 0, 0), (0.2, 0.1, 0.1), (1.5, 0, 0)]


def test_pose_errors_equal_the_errors_that_were_introduced() -> None:
    truth = {f"c{k}": looking((k - 1.5, -2 - k % 2, 1 + 0.3 * k)) for k in range(4)}
    turn = Rotation.from_rotvec([0, np.radians(0.7), 0]).as_matrix()
    wrong = {n: Camera(c.K, turn @ c.R, c.C + np.array([0, 0, 0.02]), c.width, c.height) for n, c in truth.items()}
    errors = pose_errors(wrong, truth)
    assert errors.rotation_deg == pytest.approx(0.7)
    assert errors.position == pytest.approx(0.02)
    assert errors.cameras == ("c0", "c1", "c2", "c3")


def test_turn_errors_ignore_errors_of_the_centres() -> None:
    truth = {f"c{k}": looking((k - 1.5, -2 + 1e-3 * k**2, 1)) for k in range(4)}  # almost collinear
    shifted = {n: Camera(c.K, c.R, c.C + np.array([0, 0, 2e-3 * (n == "c1")]), c.width, c.height) for n, c in truth.items()}
    assert pose_errors(shifted, truth, aligned=True).rotation_deg.min() > 1
    assert turn_errors_deg(shifted, truth).max() < 1e-6
    turn = Rotation.from_rotvec([0, np.radians(0.8), 0]).as_matrix()
    one = truth | {"c2": Camera(truth["c2"].K, turn @ truth["c2"].R, truth["c2"].C, truth["c2"].width, truth["c2"].height)}
    assert turn_errors_deg(one, truth).sum() == pytest.approx(0.6 + 3 * 0.2, rel=0.01)


def test_poses_in_another_frame_and_scale_are_perfect_once_aligned() -> None:
    truth = {f"c{k}": looking((k - 1.5, -2 - k % 2, 1 + 0.3 * k)) for k in range(4)}
    R = Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix()
    moved = {n: Camera(c.K, c.R @ R.T, 0.2 * R @ c.C + 3, c.width, c.height) for n, c in truth.items()}
    errors = pose_errors(moved, truth, aligned=True)
    assert errors.alignment is not None and errors.alignment.scale == pytest.approx(5)
    assert errors.rotation_deg.max() < 1e-4
    assert errors.position.max() < 1e-6
    assert pose_errors(moved, truth).position.min() > 1


def test_true_correspondences_satisfy_the_true_epipolar_geometry_and_no_other() -> None:
    left, right = looking((-0.5, -1.5, 1.2)), looking((1.5, -1.2, 1.0))
    x1, x2 = true_correspondences(left, plane_depth(left), right, plane_depth(right), step=4)
    assert len(x1) > 100
    assert epipolar_errors(fundamental_from_cameras(left, right), x1, x2).mean_px < 1e-3  # depth maps are float32
    other = looking((1.5, -1.2, 1.3))
    assert epipolar_errors(fundamental_from_cameras(left, other), x1, x2).median_px > 1
    with pytest.raises(ValueError, match="no true correspondences"):
        epipolar_errors(np.eye(3), x1[:0], x2[:0])


def test_matches_are_checked_against_the_true_depth() -> None:
    left, right = looking((-0.5, -1.5, 1.2)), looking((1.5, -1.2, 1.0))
    depth = plane_depth(left)
    x1, x2 = true_correspondences(left, depth, right, plane_depth(right), step=4)
    assert correct_matches(x1, x2, left, depth, right).all()
    assert not correct_matches(x1, x2 + np.array([0, 5.0]), left, depth, right).any()
    assert not correct_matches(x1, x2, left, np.zeros_like(depth), right).any()


def test_only_points_on_the_visible_surface_count_as_seen() -> None:
    cameras = [looking((0.5, -2.0, 1.0)), looking((0.5, 3.0, 1.0)), looking((3.0, 0.5, 1.0))]
    depths = [plane_depth(c) for c in cameras]
    points = np.array([[0.5, 0.5, 0.0], [0.5, 0.5, -0.2], [0.5, 0.5, 0.2], [0.5, -50.0, 0.0]])
    assert count_views(points, cameras, depths).tolist() == [3, 0, 0, 0]

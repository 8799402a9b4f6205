"""Projection, back-projection, rays and poses of pinhole cameras are exactly consistent."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wbflow_stages.core.cameras import backproject, project, ray_angles, rays, relative_pose, scaled_intrinsics, transfer
from wbflow_stages.types import Camera

SEEDS = st.integers(0, 10_000)


def some_camera(rng: np.random.Generator) -> Camera:
    """A camera near the origin that looks roughly along +z."""
    K = np.array([[rng.uniform(300, 900), 0, 320.0], [0, rng.uniform(300, 900), 180.0], [0, 0, 1]])
    R = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, 3)).as_matrix()
    return Camera(K, R, rng.uniform(-1, 1, 3), 640, 360)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_a_backprojected_pixel_projects_to_where_it_was(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera, x, depth = some_camera(rng), rng.uniform(0, 360, (20, 2)), rng.uniform(1, 50, 20)
    X = backproject(camera, x, depth)
    there, z = project(camera, X)
    assert there == pytest.approx(x) and z == pytest.approx(depth)
    assert camera.C + depth[:, None] * rays(camera, x).T == pytest.approx(X)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_transfer_to_another_camera_agrees_with_projecting_the_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera, other = some_camera(rng), some_camera(rng)
    x, depth = rng.uniform(0, 360, (20, 2)), rng.uniform(5, 50, 20)
    M, b = transfer(camera, other)
    moved = depth[:, None] * (np.column_stack([x, np.ones(20)]) @ M.T) + b
    there, z = project(other, backproject(camera, x, depth))
    assert moved[:, 2] == pytest.approx(z) and moved[:, :2] / moved[:, 2:] == pytest.approx(there)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_the_relative_pose_converts_between_the_axes_of_two_cameras(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, two, X = some_camera(rng), some_camera(rng), rng.normal(size=(5, 3))
    R, t = relative_pose(one, two)
    assert (X - one.C) @ one.R.T @ R.T + t == pytest.approx((X - two.C) @ two.R.T)


def test_pixel_centres_stay_at_integers_when_an_image_is_resized() -> None:
    K = scaled_intrinsics(np.array([[500.0, 0, 319.5], [0, 500, 179.5], [0, 0, 1]]), 0.5, 0.25)
    assert np.allclose(K, np.array([[250, 0, 159.5], [0, 125, 44.5], [0, 0, 1]]))


@given(SEEDS, st.floats(0.001, 3.1))
@settings(max_examples=30, deadline=None)
def test_ray_angles_do_not_depend_on_the_lengths_of_the_rays(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    across = np.cross(axis, [1.0, 0.3, -0.2])
    turned = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).apply(across)
    assert ray_angles(3.0 * across[None], 0.1 * turned[None]) == pytest.approx(angle, abs=1e-6)


def test_the_angle_to_an_unknown_ray_is_unknown() -> None:
    known = np.array([[0.0, 0, 1]])
    assert np.isnan(ray_angles(np.full((1, 3), np.nan), known)).all() and np.isnan(ray_angles(0 * known, known)).all()

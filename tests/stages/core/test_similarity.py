"""A similarity is recovered from points that it has moved, and moves cameras consistently with the points that they see."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scores import similarity_between

from wbflow_stages.core.cameras import project
from wbflow_stages.core.rotations import Similarity, angle_between_deg, with_rotation
from wbflow_stages.types import Camera


def random_similarity(seed: int, scale: float) -> Similarity:
    return Similarity(scale, Rotation.random(random_state=seed).as_matrix(), np.random.default_rng(seed).normal(size=3))


@given(st.integers(0, 10_000), st.floats(0.1, 10))
@settings(max_examples=25, deadline=None)
def test_an_applied_similarity_is_recovered(seed: int, scale: float) -> None:
    points, applied = np.random.default_rng(seed).normal(size=(6, 3)), random_similarity(seed, scale)
    found = similarity_between(points, applied.points(points))
    assert found.scale == pytest.approx(scale)
    assert angle_between_deg(found.R, applied.R) < 1e-5
    assert found.points(points) == pytest.approx(applied.points(points))
    assert similarity_between(points, applied.points(points), with_scale=False).scale == 1.0


def test_collinear_points_do_not_determine_a_similarity() -> None:
    line = np.outer(np.arange(5.0), [1, 2, 3])
    with pytest.raises(ValueError, match="line"):
        similarity_between(line, line)
    with pytest.raises(ValueError, match="three points"):
        similarity_between(line[:2], line[:2])


@pytest.mark.parametrize("with_scale", [True, False])
def test_points_that_coincide_do_not_determine_a_similarity(with_scale: bool) -> None:
    points = np.random.default_rng(2).normal(size=(4, 3))
    for source, target in ((np.ones((4, 3)), points), (points, np.ones((4, 3))), (np.zeros((4, 3)), np.zeros((4, 3)))):
        with pytest.raises(ValueError, match="three points"):
            similarity_between(source, target, with_scale=with_scale)


def test_a_moved_camera_sees_moved_points_at_the_same_pixels() -> None:
    moved = random_similarity(3, 2.5)
    camera = Camera(np.array([[500.0, 0, 320], [0, 500, 180], [0, 0, 1]]), np.eye(3), np.array([0.1, 0.2, -9]), 640, 360)
    X = np.random.default_rng(0).normal(size=(10, 3))
    before, depth = project(camera, X)
    after, deeper = project(moved.camera(camera), moved.points(X))
    assert after == pytest.approx(before) and deeper == pytest.approx(2.5 * depth)


def test_mirrored_points_have_no_scale() -> None:
    points = np.random.default_rng(1).normal(size=(5, 3))
    weight = np.full(5, 0.2)
    assert with_rotation(np.eye(3), points, -points, weight) is None
    held = with_rotation(np.eye(3), points, 2 * points + 1, weight, 2.0)
    assert held is not None and held.t == pytest.approx(np.ones(3))

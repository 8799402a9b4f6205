"""Rotations agree with scipy's, from tiny angles to half a turn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wbflow_stages.core.rotations import (
    angle_between_deg,
    nearest_rotation,
    rotation_matrix,
    rotation_vector,
    skew,
)

VECTORS = st.tuples(
    st.integers(0, 10_000), st.one_of(st.floats(0, np.pi - 1e-6), st.sampled_from([0.0, 1e-9, 1e-4, np.pi - 1e-4]))
)


def vector(seed: int, angle: float) -> np.ndarray:
    """Rotation vector of a random direction and the given angle."""
    axis = np.random.default_rng(seed).normal(size=3)
    return angle * axis / np.linalg.norm(axis)


@given(VECTORS)
@settings(max_examples=60, deadline=None)
def test_rotation_vectors_and_matrices_are_converted_both_ways(drawn: tuple[int, float]) -> None:
    v = vector(*drawn)
    R = rotation_matrix(v)
    assert np.abs(R - Rotation.from_rotvec(v).as_matrix()).max() < 1e-12
    assert np.abs(rotation_vector(R) - v).max() < 1e-7


@given(VECTORS, st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_angle_between_rotations_is_that_of_the_turn_from_one_to_the_other(drawn: tuple[int, float], seed: int) -> None:
    A = Rotation.random(random_state=seed).as_matrix()
    B = A @ rotation_matrix(vector(*drawn))
    assert np.radians(angle_between_deg(A, B)) == pytest.approx(drawn[1], abs=1e-7)
    assert angle_between_deg(B, A) == pytest.approx(np.degrees(drawn[1]), abs=1e-5)


def test_a_half_turn_has_the_correct_axis() -> None:
    R = Rotation.from_rotvec([0, np.pi, 0]).as_matrix()
    assert np.abs(rotation_vector(R)) == pytest.approx([0, np.pi, 0])


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_nearest_rotation_recovers_a_rotation_from_turned_vectors(seed: int) -> None:
    R, rng = Rotation.random(random_state=seed).as_matrix(), np.random.default_rng(seed)
    source = rng.normal(size=(5, 3))
    assert nearest_rotation((source @ R.T).T @ source) == pytest.approx(R)
    mirrored = nearest_rotation(rng.normal(size=(3, 3)))
    assert np.linalg.det(mirrored) == pytest.approx(1)


def test_skew_matrix_gives_the_cross_product() -> None:
    a, b = np.array([1.0, -2, 3]), np.array([0.5, 4, -1])
    assert skew(a) @ b == pytest.approx(np.cross(a, b))

"""Similarities: rotation, scale and shift from one frame into another."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..types import Camera, Float64s
from .rotations import nearest_rotation


@dataclass(frozen=True)
class Similarity:
    """X -> scale R X + t."""

    scale: float = 1.0
    R: Float64s = field(default_factory=lambda: np.eye(3))
    t: Float64s = field(default_factory=lambda: np.zeros(3))

    def points(self, X: Float64s) -> Float64s:
        """(n, 3) points, moved."""
        return np.asarray(self.scale * X @ self.R.T + self.t, dtype=np.float64)

    def camera(self, camera: Camera) -> Camera:
        """A camera, moved."""
        return replace(camera, R=camera.R @ self.R.T, C=self.points(camera.C[None])[0])


def similarity_between(source: Float64s, target: Float64s, *, with_scale: bool = True) -> Similarity:
    """The least-squares similarity from (n, 3) points to their counterparts.

    Raises ValueError for fewer than three points, and for points that coincide or lie on a line.

    References
    ----------
    S. Umeyama, Least-squares estimation of transformation parameters between two point patterns, PAMI 1991.
    """
    count = max(len(source), 1)
    weight = np.full(len(source), 1 / count)
    a, b = source - weight @ source, target - weight @ target
    M = b.T @ a / count
    spread = np.linalg.svd(M, compute_uv=False)
    open_turn = len(source) < 3 or spread[1] <= 1e-9 * spread[0]  # points that coincide have no spread at all
    found = None if open_turn else with_rotation(nearest_rotation(M), source, target, weight, None if with_scale else 1.0)
    if found is None:
        raise ValueError("an alignment needs three points that are not on a line")
    return found


def with_rotation(
    R: Float64s, source: Float64s, target: Float64s, weight: Float64s, scale: float | None = None
) -> Similarity | None:
    """The similarity with a given rotation that fits best; None where its scale would not be positive.

    Parameters
    ----------
    R : (3, 3) float64, from the source's axes to the target's.
    source, target : (n, 3) float64 points.
    weight : (n,) float64, that sum to one.
    scale : where it is known otherwise; else at least two points are needed that differ.
    """
    a_mean, b_mean = weight @ source, weight @ target
    a, b = source - a_mean, target - b_mean
    if scale is None:
        scale = float(np.einsum("n,ni,ni->", weight, b, a @ R.T) / np.einsum("n,ni,ni->", weight, a, a))
        if scale <= 0:
            return None
    return Similarity(scale, R, b_mean - scale * R @ a_mean)

"""Rotations as (3, 3) matrices and as vectors (axis times angle), the angle between two rotations, and similarity transforms."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..types import Camera, Float64s


def skew(t: Float64s) -> Float64s:
    """The (3, 3) matrix [t]x with [t]x v = t x v."""
    return np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])


def rotation_matrix(v: Float64s) -> Float64s:
    """(3, 3) rotation by |v| radians about v (Rodrigues' formula)."""
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:  # no axis: the first two terms of the exponential series
        return np.eye(3) + skew(v)
    k = skew(v / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k, dtype=np.float64)


def rotation_vector(R: Float64s) -> Float64s:
    """(..., 3) axis times angle (radians) of rotations (..., 3, 3)."""
    v = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    # the antisymmetric part is sin(angle) [axis]x, and the trace 1 + 2 cos(angle)
    sine = np.linalg.norm(v, axis=-1, keepdims=True)
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1)[..., None]
    angle = np.arctan2(sine, cosine)
    # near half a turn the axis comes from the symmetric part, cos I + (1 - cos) a a^T
    S = 0.5 * (R + np.swapaxes(R, -1, -2))
    # k: the axis' largest component, whose column is the most accurate; its sign follows from the antisymmetric part
    k = np.argmax(np.diagonal(S, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(S - cosine[..., None] * np.eye(3), k[..., None, None], axis=-1)[..., 0]
    column /= np.linalg.norm(column, axis=-1, keepdims=True)
    sign = np.where((column * v).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        plain = np.where(sine > 1e-9, v * angle / np.maximum(sine, 1e-300), v)
    return np.asarray(np.where(cosine < -0.99, sign * column * angle, plain), dtype=np.float64)


def angle_between_deg(A: Float64s, B: Float64s) -> float:
    """Degrees between two rotations (3, 3); accurate for small angles and near half a turn."""
    turn = A.T @ B
    sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return float(np.degrees(np.arctan2(sine, np.trace(turn) - 1)))


def nearest_rotation(M: Float64s) -> Float64s:
    """(3, 3) rotation R that maximises trace(R^T M); with M = sum of target source^T, R best rotates source onto target."""
    # the orthogonal Procrustes problem; the determinant rules out a reflection (Kabsch 1976)
    U, _, Vt = np.linalg.svd(M)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt, dtype=np.float64)


@dataclass(frozen=True)
class Similarity:
    """The transform X -> scale R X + t."""

    scale: float = 1.0
    R: Float64s = field(default_factory=lambda: np.eye(3))
    t: Float64s = field(default_factory=lambda: np.zeros(3))

    def points(self, X: Float64s) -> Float64s:
        """(n, 3) transformed points."""
        return np.asarray(self.scale * X @ self.R.T + self.t, dtype=np.float64)

    def camera(self, camera: Camera) -> Camera:
        """A camera, transformed."""
        return replace(camera, R=camera.R @ self.R.T, C=self.points(camera.C[None])[0])


def with_rotation(
    R: Float64s, source: Float64s, target: Float64s, weight: Float64s, scale: float | None = None
) -> Similarity | None:
    """The best-fitting similarity (weighted least squares) with a given rotation; None if its scale would not be positive.

    Parameters
    ----------
    R : (3, 3) float64, from the source's axes to the target's.
    source, target : (n, 3) float64 points.
    weight : (n,) float64, weights that sum to one.
    scale : the scale if it is known; None: it is estimated, which needs at least two distinct points.
    """
    a_mean = weight @ source
    b_mean = weight @ target
    a = source - a_mean
    b = target - b_mean
    if scale is None:
        # least squares: scale = sum w b^T R a / sum w a^T a
        scale = float(np.einsum("n,ni,ni->", weight, b, a @ R.T) / np.einsum("n,ni,ni->", weight, a, a))
        if scale <= 0:
            return None
    return Similarity(scale, R, b_mean - scale * R @ a_mean)

"""Two-view geometry that several stages share: F and E, homographies, epipoles, residuals and triangulation."""

from __future__ import annotations

import numpy as np

from ..types import Camera, Float64s
from .cameras import rays, relative_pose
from .rotations import skew


def unit_norm(F: Float64s) -> Float64s:
    """A matrix divided by its Frobenius norm."""
    return np.asarray(F / np.linalg.norm(F), dtype=np.float64)


def homogeneous(x: Float64s) -> Float64s:
    """(n, 2) points as (n, 3) with a last column of ones."""
    return np.column_stack([x, np.ones(len(x))])


def apply_homography(H: Float64s, x: Float64s) -> Float64s:
    """Map (n, 2) points by a (3, 3) homography."""
    X, Y, z = H[:, :2] @ x.T + H[:, 2:]  # one coordinate at a time: numpy is slow along short rows
    return np.column_stack([X / z, Y / z])


def essential_to_fundamental(R: Float64s, t: Float64s, K1: Float64s, K2: Float64s) -> Float64s:
    """F of unit norm from `cam2_R_cam1`, `cam2_t_cam1` and the intrinsics (Hartley & Zisserman, eq. 9.2).

    Parameters
    ----------
    R, t : (3, 3) `cam2_R_cam1` and (3,) `cam2_t_cam1`, of any length.
    K1, K2 : (3, 3) intrinsics in pixels.
    """
    return unit_norm(np.linalg.inv(K2).T @ skew(t) @ R @ np.linalg.inv(K1))


def fundamental_from_cameras(camera1: Camera, camera2: Camera) -> Float64s:
    """F of unit norm for two cameras with different centres."""
    R, t = relative_pose(camera1, camera2)
    return essential_to_fundamental(R, t, camera1.K, camera2.K)


def epipoles(F: Float64s) -> tuple[Float64s, Float64s]:
    """Homogeneous epipoles (3,) of unit norm: F e1 = 0 in image 1, F^T e2 = 0 in image 2."""
    U, _, Vt = np.linalg.svd(F)
    return Vt[2], U[:, 2]


def sampson_distance(F: Float64s, x1: Float64s, x2: Float64s) -> Float64s:
    """Signed first-order distance in pixels of each correspondence to the variety of F (Hartley & Zisserman, eq. 11.9)."""
    a1, b1 = F[:2, :2].T @ x2.T + F[2:, :2].T  # normals of the lines F^T x2 in image 1
    a2, b2, c2 = F[:, :2] @ x1.T + F[:, 2:]  # the lines F x1 in image 2
    algebraic = a2 * x2[:, 0] + b2 * x2[:, 1] + c2
    return np.asarray(algebraic / np.sqrt(a1 * a1 + b1 * b1 + a2 * a2 + b2 * b2 + 1e-30), dtype=np.float64)


def symmetric_epipolar_distance(F: Float64s, x1: Float64s, x2: Float64s) -> Float64s:
    """Mean of the distances (pixels) of x2 to F x1 and of x1 to F^T x2."""
    a1, b1 = F[:2, :2].T @ x2.T + F[2:, :2].T
    a2, b2, c2 = F[:, :2] @ x1.T + F[:, 2:]
    # both distances share x2^T F x1, and differ by the length of the line's normal
    algebraic = np.abs(a2 * x2[:, 0] + b2 * x2[:, 1] + c2)
    inverse_lengths = 1 / np.sqrt(a1 * a1 + b1 * b1) + 1 / np.sqrt(a2 * a2 + b2 * b2)
    return np.asarray(0.5 * algebraic * inverse_lengths, dtype=np.float64)


def triangulate_depth(camera1: Camera, camera2: Camera, x1: Float64s, x2: Float64s) -> tuple[Float64s, Float64s]:
    """Depth (n,) in camera 1 along the ray of x1 whose projection in camera 2 is nearest x2, and |dz/dpixel| in image 2.

    Closed-form least squares on the two linear equations of x2; nan where the point lies behind a camera.

    Parameters
    ----------
    camera1, camera2 : in the same world.
    x1, x2 : (n, 2) pixels of the matches, without distortion.
    """
    # a point at depth z projects into camera 2 at z A + b (homogeneous)
    A = (camera2.K @ camera2.R @ rays(camera1, x1)).T
    b = camera2.K @ camera2.R @ (camera1.C - camera2.C)
    u = x2[:, 0]
    v = x2[:, 1]
    # its pixel is (u, v) where z a1 + b1 = 0 and z a2 + b2 = 0: one unknown, two equations
    a1 = A[:, 0] - u * A[:, 2]
    b1 = b[0] - u * b[2]
    a2 = A[:, 1] - v * A[:, 2]
    b2 = b[1] - v * b[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        z = -(a1 * b1 + a2 * b2) / (a1 * a1 + a2 * a2)
        w = z * A[:, 2] + b[2]  # depth in camera 2
        # derivative of the pixel by z (quotient rule)
        du = (A[:, 0] * w - (z * A[:, 0] + b[0]) * A[:, 2]) / w**2
        dv = (A[:, 1] * w - (z * A[:, 1] + b[1]) * A[:, 2]) / w**2
        dz_dpixel = 1.0 / np.sqrt(du * du + dv * dv)
    visible = (z > 0) & (w > 0)
    return np.where(visible, z, np.nan), np.where(visible, dz_dpixel, np.nan)

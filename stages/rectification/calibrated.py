"""Rectification of two cameras of known K and pose: both turned to a common orientation (Fusiello, Trucco & Verri, MVA 2000)."""

from __future__ import annotations

import numpy as np

from ..twoview.epipolar import apply_homography
from ..types import Camera, Float64s
from .congruent import control_points, fit_edges, net_edges
from .method import Homographies, MatchedPair


def fusiello(camera1: Camera, camera2: Camera) -> tuple[Float64s, Float64s]:
    """H1, H2 (3, 3): x along the baseline, z as near as possible to both optical axes, the mean of both K.

    Raises ValueError when the baseline is parallel to the mean optical axis: no common image plane then.
    """
    x_axis = camera2.C - camera1.C
    x_axis = x_axis / np.linalg.norm(x_axis)
    if x_axis @ (camera1.R[0] + camera2.R[0]) < 0:
        x_axis = -x_axis
    forward = camera1.R[2] + camera2.R[2]
    y_axis = np.cross(forward, x_axis)
    if np.linalg.norm(y_axis) < 1e-6:
        raise ValueError("the baseline is parallel to the optical axes")
    y_axis = y_axis / np.linalg.norm(y_axis)
    R = np.stack([x_axis, y_axis, np.cross(x_axis, y_axis)])
    K = (camera1.K + camera2.K) / 2
    return K @ R @ camera1.R.T @ np.linalg.inv(camera1.K), K @ R @ camera2.R.T @ np.linalg.inv(camera2.K)


def calibrated(pair: MatchedPair, left: Camera, right: Camera) -> Homographies:
    """`fusiello`, then a robust affine of x on image 1 that makes the net of the matches congruent."""
    H1, H2 = fusiello(left, right)
    chosen = control_points(pair.x1, pair.probability, (left.width, left.height))
    y1, y2 = apply_homography(H1, pair.x1[chosen]), apply_homography(H2, pair.x2[chosen])
    a, b = fit_edges(y1, y2[:, 0], net_edges(y2), robust=True)
    c = np.median(y2[:, 0] - y1 @ np.array([a, b]))
    return Homographies(np.array([[a, b, c], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ H1, H2)

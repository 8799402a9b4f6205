"""Hartley's compatible homography: the free row of H1 brings *points* to their partners' x (Hartley, IJCV 1999)."""

from __future__ import annotations

import numpy as np

from ..twoview.epipolar import apply_homography, homogeneous
from ..types import Float64s
from .projective import rows_fixed_by, send_epipole_to_infinity


def hartley(F: Float64s, x1: Float64s, x2: Float64s, size: tuple[int, int]) -> tuple[Float64s, Float64s]:
    """H1, H2 (3, 3) that minimise the sum of squared disparities of the matches x1, x2 (n, 2); `size` of image 2 in pixels."""
    H2 = send_epipole_to_infinity(F, size)
    row2, row3 = rows_fixed_by(F, H2, x1)
    m = homogeneous(x1)
    design = m / (m @ row3)[:, None]
    scale = np.abs(design).max(axis=0)
    row1 = np.linalg.lstsq(design / scale, apply_homography(H2, x2)[:, 0], rcond=None)[0] / scale
    return np.stack([row1, row2, row3]), H2

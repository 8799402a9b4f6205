"""Hartley's compatible homography: the free row of H1 brings *points* to their partners' x (Hartley, IJCV 1999)."""

from __future__ import annotations

import numpy as np

from ..twoview.epipolar import apply_homography, homogeneous
from .method import Homographies, MatchedPair
from .projective import rows_fixed_by, send_epipole_to_infinity


def hartley(pair: MatchedPair) -> Homographies:
    """The homographies that minimise the sum of squared disparities of the matches."""
    H2 = send_epipole_to_infinity(pair.F, pair.size2)
    row2, row3 = rows_fixed_by(pair.F, H2, pair.x1)
    m = homogeneous(pair.x1)
    design = m / (m @ row3)[:, None]
    scale = np.abs(design).max(axis=0)
    row1 = np.linalg.lstsq(design / scale, apply_homography(H2, pair.x2)[:, 0], rcond=None)[0] / scale
    return Homographies(np.stack([row1, row2, row3]), H2)

"""What F alone says about a rectifying pair of homographies (Hao 2011, chapter 4; Hartley, IJCV 1999).

From `F ~ H2^-T [i]x H1` follow the second and third row of H1 once H2 is chosen; the first row of H1, three numbers, is free.
The methods differ in how they choose it: `hartley`, `congruent`.
"""

from __future__ import annotations

import numpy as np

from ..core.order_statistics import median
from ..twoview.epipolar import epipoles
from ..types import Float64s


def send_epipole_to_infinity(F: Float64s, size: tuple[int, int]) -> Float64s:
    """H2 = G R T (3, 3): origin to the centre of image 2, epipole turned onto the x axis, then to infinity along it.

    The turn is at most 90 degrees, so that the image stays upright; in homogeneous form an epipole at infinity is no
    special case.
    """
    width, height = size
    T = np.array([[1.0, 0.0, -(width - 1) / 2], [0.0, 1.0, -(height - 1) / 2], [0.0, 0.0, 1.0]])
    epipole = T @ epipoles(F)[1]
    if epipole[0] < 0:
        epipole = -epipole  # a homogeneous sign, chosen so that the turn is short
    length = np.hypot(epipole[0], epipole[1])
    c, s = (epipole[0] / length, epipole[1] / length) if length > 0 else (1.0, 0.0)
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    G = np.eye(3)
    G[2, 0] = -epipole[2] / max(length, 1e-12)
    return np.asarray(G @ R @ T, dtype=np.float64)


def rows_fixed_by(F: Float64s, H2: Float64s, x1: Float64s) -> tuple[Float64s, Float64s]:
    """Second and third row (3,) of H1, with the common sign that gives most points x1 a positive third coordinate."""
    M = np.linalg.inv(H2).T @ F  # ~ [i]x H1: its rows are 0, -row3, row2
    row2, row3 = M[2], -M[1]
    sign = 1.0 if median(x1 @ row3[:2] + row3[2]) >= 0 else -1.0
    return sign * row2, sign * row3

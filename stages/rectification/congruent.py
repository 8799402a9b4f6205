"""Rectification by structural congruency: the free row of H1 makes the *net* of matches congruent in both images (seed 4.3).

The seed joins the matches by a Delaunay net and minimises the differences of its edges (4-6).  Taken literally, edges across
depth jumps are noise in the regressor and shrink x.  Two steps together cure it: one control point for each cell of a grid (the
seed's own future work), and weights that let edges across depth jumps go.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

from ..epipolar import apply_homography, homogeneous
from ..types import Float32s, Float64s, Int32s
from .canvas import middle
from .projective import rows_fixed_by, send_epipole_to_infinity

COLUMNS = 24
"""Columns of square cells that hold one control point each."""

_ITERATIONS = 10
_SETTLED = 1e-6
"""Share of the largest coefficient by which none changes any more."""


def congruent(F: Float64s, x1: Float64s, x2: Float64s, probability: Float32s, size: tuple[int, int]) -> tuple[Float64s, Float64s]:
    """H1, H2 (3, 3): control points of a grid, robust weights.  x1, x2: (n, 2) matches; `size` of image 2 in pixels."""
    chosen = control_points(x1, probability, size)
    return _fit(F, x1[chosen], x2[chosen], size, robust=True)


def seed(F: Float64s, x1: Float64s, x2: Float64s, size: tuple[int, int]) -> tuple[Float64s, Float64s]:
    """H1, H2 (3, 3) by the letter of the seed's 4.3: every match, plain least squares."""
    return _fit(F, x1, x2, size, robust=False)


def control_points(x1: Float64s, probability: Float32s, size: tuple[int, int]) -> Int32s:
    """Rows of the most probable match of each square cell, `COLUMNS` cells across an image of `size`."""
    cell = np.floor(x1 * (COLUMNS / size[0])).astype(np.int64)
    key = cell[:, 1] * (4 * COLUMNS) + cell[:, 0]
    order = np.lexsort((np.arange(len(x1)), -probability, key))
    first = np.r_[True, np.diff(key[order]) != 0]
    return np.sort(order[first]).astype(np.int32)


def net_edges(x: Float64s) -> Int32s:
    """(m, 2) rows of points joined by the Delaunay net of x (n, 2): two edges of each triangle, as in the seed's (4-6)."""
    triangles = Delaunay(x).simplices
    return np.vstack([triangles[:, [0, 1]], triangles[:, [2, 1]]]).astype(np.int32)


def fit_edges(design: Float64s, target: Float64s, edges: Int32s, robust: bool) -> Float64s:
    """Coefficients (k,) that best carry the differences of `design` (n, k) over `edges` into those of `target` (n,).

    Robust: weights 1 / (1 + (r / 2s)^2) on squared residuals r, s their median absolute deviation, found by iteration.
    """
    D = design[edges[:, 0]] - design[edges[:, 1]]  # few well-scaled columns: normal equations lose nothing
    d = target[edges[:, 0]] - target[edges[:, 1]]
    weights: Float64s = np.ones(len(d))
    coefficients: Float64s = np.zeros(design.shape[1])
    for _ in range(_ITERATIONS if robust else 1):
        before, weighted = coefficients, D.T * weights
        coefficients = np.asarray(np.linalg.lstsq(weighted @ D, weighted @ d, rcond=None)[0], dtype=np.float64)
        if np.abs(coefficients - before).max() <= _SETTLED * np.abs(coefficients).max():
            break
        r = D @ coefficients - d
        s = 1.4826 * middle(np.abs(r)) + 1e-6
        weights = np.asarray(1 / (1 + (r / (2 * s)) ** 2), dtype=np.float64)
    return coefficients


def _fit(F: Float64s, x1: Float64s, x2: Float64s, size: tuple[int, int], robust: bool) -> tuple[Float64s, Float64s]:
    H2 = send_epipole_to_infinity(F, size)
    row2, row3 = rows_fixed_by(F, H2, x1)
    target = apply_homography(H2, x2)
    N = _normaliser(size)
    row3_n = row3 @ np.linalg.inv(N)
    m = homogeneous(x1) @ N.T
    points = m / (m @ row3_n)[:, None]
    # row1 = B ab + c row3: row3 maps every point to 1, so edges say nothing about c, and B spans the rest
    B = np.linalg.svd(row3_n[None])[2][1:].T
    ab = fit_edges(points @ B, target[:, 0], net_edges(target), robust)
    c = np.median(target[:, 0] - points @ B @ ab)
    return np.stack([(B @ ab + c * row3_n) @ N, row2, row3]), H2


def _normaliser(size: tuple[int, int]) -> Float64s:
    """(3, 3): pixels to about -1..1, so that the three coordinates weigh alike in the linear algebra."""
    half = max(size) / 2
    return np.array([[1 / half, 0.0, -(size[0] - 1) / 2 / half], [0.0, 1 / half, -(size[1] - 1) / 2 / half], [0.0, 0.0, 1.0]])

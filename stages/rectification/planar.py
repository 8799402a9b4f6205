"""Rectification by a pair of homographies (Hao 2011, chapter 4; Hartley, IJCV 1999; Fusiello, Trucco & Verri, MVA 2000).

Once H2 is chosen, the second and third row of H1 follow from `F ~ H2^-T [i]x H1`; its first row, three numbers, is free.

- `congruent` makes the *net* of matches congruent in both images.  Hao (2011, section 4.3) joins the matches by a Delaunay net
  and minimises the differences of its edges (4-6).  If this is done to the letter (`hao2011`), edges across depth jumps are noise
  in the regressor and shrink x.  Two steps together prevent it: one control point for each cell of a grid (named there as future
  work), and robust weights, which discard edges across depth jumps.
- `hartley` brings *points* to the x of their partners."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay, QhullError

from ..core.epipolar import apply_homography, epipoles, homogeneous
from ..types import Camera, Float32s, Float64s, Int32s
from .method import Homographies, MatchedPair

COLUMNS = 24
"""Columns of square cells that hold one control point each; more of them give shorter edges, which are noisier."""
_ITERATIONS = 10
"""Most iterations of the robust fit."""
_CONVERGED = 1e-6
"""Iterations end when no coefficient changes by more than this share of the largest."""


def congruent(pair: MatchedPair) -> Homographies:
    """Make the net of matches congruent in both images, with control points of a grid and robust weights."""
    chosen = control_points(pair.x1, pair.probability, pair.size2)
    return _fit(pair.F, pair.x1[chosen], pair.x2[chosen], pair.size2, robust=True)


def hao2011(pair: MatchedPair) -> Homographies:
    """Make the net of matches congruent exactly as in Hao's section 4.3: every match, plain least squares."""
    return _fit(pair.F, pair.x1, pair.x2, pair.size2, robust=False)


def control_points(x1: Float64s, probability: Float32s, size: tuple[int, int]) -> Int32s:
    """Rows of the most probable match of each square cell, `COLUMNS` cells across an image of `size`; the first of equal ones."""
    column, row = np.floor(x1 / (size[0] / COLUMNS)).T
    order = np.lexsort((-probability, row, column))
    cells = np.column_stack([column, row])[order]
    # sorted by cell, and within a cell by probability: the first row of each cell is its most probable
    first = np.append(True, (cells[1:] != cells[:-1]).any(axis=1))
    return np.sort(order[first]).astype(np.int32)


def net_edges(x: Float64s) -> Int32s:
    """(m, 2) rows of points joined by the Delaunay net of x (n, 2): two edges of each triangle, as in Hao's (4-6).

    Raises ValueError when the points span no triangle.
    """
    try:
        triangles = Delaunay(x).simplices
    except QhullError:
        raise ValueError("the matches are too close together to span a net") from None
    return np.vstack([triangles[:, [0, 1]], triangles[:, [2, 1]]]).astype(np.int32)


def _fit_edges(design: Float64s, target: Float64s, edges: Int32s, robust: bool) -> Float64s:
    """Coefficients (2,) that best map the differences of `design` (n, 2) over `edges` (m, 2) to those of `target` (n,).

    robust: weights 1 / (1 + (r / 2s)^2) of residuals r, with s = 1.4826 times their median absolute value, by iteration.
    """
    p = edges[:, 0]
    q = edges[:, 1]
    D1 = design[p, 0] - design[q, 0]
    D2 = design[p, 1] - design[q, 1]
    d = target[p] - target[q]
    weights = np.ones(len(d))
    x = np.float64(0.0)
    y = np.float64(0.0)
    iterations = _ITERATIONS if robust else 1
    with np.errstate(divide="ignore", invalid="ignore"):  # degenerate edges give nan
        for _ in range(iterations):
            # normal equations: with two well-scaled columns, they are exact enough
            a = weights * D1
            b = weights * D2
            aa = _sum_in_order(a * D1)
            ab = _sum_in_order(a * D2)
            bb = _sum_in_order(b * D2)
            ad = _sum_in_order(a * d)
            bd = _sum_in_order(b * d)
            previous_x = x
            previous_y = y
            x = (bb * ad - ab * bd) / (aa * bb - ab * ab)
            y = (aa * bd - ab * ad) / (aa * bb - ab * ab)
            if max(abs(x - previous_x), abs(y - previous_y)) <= _CONVERGED * max(abs(x), abs(y)):
                break
            residuals = abs(D1 * x + D2 * y - d)
            s = 1.4826 * np.median(residuals) + 1e-6
            weights = 1 / (1 + (residuals / (2 * s)) ** 2)
    return np.array([x, y])


def _sum_in_order(terms: Float64s) -> np.float64:
    """Sum of terms (n,) from the first to the last: np.sum adds in an order that may depend on the processor."""
    total: np.float64 = np.cumsum(terms)[-1]
    return total


def _fit(F: Float64s, x1: Float64s, x2: Float64s, size: tuple[int, int], robust: bool) -> Homographies:
    """H2, and the H1 that makes the net of the matches x1, x2 (n, 2) congruent in both images; size: of frame 2."""
    H2 = send_epipole_to_infinity(F, size)
    row2, row3 = rows_fixed_by(F, H2, x1)
    target = apply_homography(H2, x2)
    half = max(size) / 2  # pixels to about -1..1, so that the three coordinates weigh alike in the linear algebra
    N = np.array([[1 / half, 0.0, -(size[0] - 1) / 2 / half], [0.0, 1 / half, -(size[1] - 1) / 2 / half], [0.0, 0.0, 1.0]])
    row3_n = row3 @ np.linalg.inv(N)
    normalised = homogeneous(x1) @ N.T
    points = normalised / (normalised @ row3_n)[:, None]
    # row1 = B ab + c row3: row3 maps every point to 1, so edges do not depend on c, and B spans the rest
    _, _, Vt = np.linalg.svd(row3_n[None])
    B = Vt[1:].T
    ab = _fit_edges(points @ B, target[:, 0], net_edges(target), robust)
    c = np.median(target[:, 0] - points @ (B @ ab))  # a shift along the row
    row1 = (B @ ab + c * row3_n) @ N
    return Homographies(np.stack([row1, row2, row3]), H2)


def send_epipole_to_infinity(F: Float64s, size: tuple[int, int]) -> Float64s:
    """H2 = G R T (3, 3): origin to the centre of image 2, epipole rotated onto the x axis, then moved to infinity along it.

    The rotation is at most 90 degrees, so that the image stays upright; in homogeneous form an epipole at infinity is no
    special case.
    """
    width, height = size
    T = np.array([[1.0, 0.0, -(width - 1) / 2], [0.0, 1.0, -(height - 1) / 2], [0.0, 0.0, 1.0]])
    epipole = T @ epipoles(F)[1]
    if epipole[0] < 0:
        epipole = -epipole  # its homogeneous sign is free: this one makes the rotation small
    length = np.hypot(epipole[0], epipole[1])
    c = 1.0
    s = 0.0
    if length > 0:  # an epipole at the centre has no direction
        c = epipole[0] / length
        s = epipole[1] / length
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    G = np.eye(3)
    G[2, 0] = -epipole[2] / max(length, 1e-12)
    return np.asarray(G @ R @ T, dtype=np.float64)


def rows_fixed_by(F: Float64s, H2: Float64s, x1: Float64s) -> tuple[Float64s, Float64s]:
    """Second and third row (3,) of H1, with the common sign that gives most points x1 a positive third coordinate."""
    M = np.linalg.inv(H2).T @ F  # ~ [i]x H1: its rows are 0, -row3, row2
    row2 = M[2]
    row3 = -M[1]
    sign = 1.0 if np.median(x1 @ row3[:2] + row3[2]) >= 0 else -1.0
    return sign * row2, sign * row3


def hartley(pair: MatchedPair) -> Homographies:
    """The homographies that minimise the sum of squared disparities of the matches."""
    H2 = send_epipole_to_infinity(pair.F, pair.size2)
    row2, row3 = rows_fixed_by(pair.F, H2, pair.x1)
    points = homogeneous(pair.x1)
    design = points / (points @ row3)[:, None]
    scale = np.abs(design).max(axis=0)  # columns of equal size, for the condition of the system
    target = apply_homography(H2, pair.x2)[:, 0]
    solution, *_ = np.linalg.lstsq(design / scale, target, rcond=None)
    row1 = solution / scale
    return Homographies(np.stack([row1, row2, row3]), H2)


def fusiello(camera1: Camera, camera2: Camera) -> tuple[Float64s, Float64s]:
    """H1, H2 (3, 3): x along the baseline, z as near as possible to both optical axes, the mean of both K.

    Raises ValueError if the baseline is parallel to the mean optical axis: there is no common image plane then.
    """
    x_axis = camera2.C - camera1.C
    x_axis = x_axis / np.linalg.norm(x_axis)
    if x_axis @ (camera1.R[0] + camera2.R[0]) < 0:
        x_axis = -x_axis  # the images stay upright
    forward = camera1.R[2] + camera2.R[2]
    y_axis = np.cross(forward, x_axis)
    if np.linalg.norm(y_axis) < 1e-6:
        raise ValueError("the baseline is parallel to the optical axes")
    y_axis = y_axis / np.linalg.norm(y_axis)
    R = np.stack([x_axis, y_axis, np.cross(x_axis, y_axis)])
    K = (camera1.K + camera2.K) / 2
    H1 = K @ R @ camera1.R.T @ np.linalg.inv(camera1.K)
    H2 = K @ R @ camera2.R.T @ np.linalg.inv(camera2.K)
    return H1, H2


def calibrated(pair: MatchedPair, left: Camera, right: Camera) -> Homographies:
    """`fusiello`, then a robust affine of x on image 1 that makes the net of the matches congruent."""
    H1, H2 = fusiello(left, right)
    chosen = control_points(pair.x1, pair.probability, (left.width, left.height))
    y1 = apply_homography(H1, pair.x1[chosen])
    y2 = apply_homography(H2, pair.x2[chosen])
    a, b = _fit_edges(y1, y2[:, 0], net_edges(y2), robust=True)
    c = np.median(y2[:, 0] - y1 @ np.array([a, b]))
    affine_x = np.array([[a, b, c], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return Homographies(affine_x @ H1, H2)

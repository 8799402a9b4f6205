"""Quality of a rectification: signs that it is wrong, and the uncertainty of its rows (degenerate cases)."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np

from ..core.epipolar import apply_homography
from ..core.ordering import percentiles
from ..twoview.refinement import tangent
from ..types import Float64s, Int64s

_MOST_MATCHES = 1000
"""Matches, at most, from which order and homography are estimated: more do not improve them."""
_BANDS, _ACROSS, _DOWN = 12, 4, 3
"""Bands of rows in which order along x is compared; columns and rows of the parts of an image that are left out in turn."""


def order_agreement(y1: Float64s, y2: Float64s) -> float:
    """Spearman's rank correlation of x within bands of rows of rectified matches y1, y2 (n, 2): near 1 if right, any value if F
    is wrong.  All bands hold equally many; up to 11 matches of the last rows are left over."""
    step = max(1, -(-len(y1) // _MOST_MATCHES))
    y1, y2 = y1[::step], y2[::step]
    count = max(1, min(_BANDS, len(y1) // 8))
    n = len(y1) // count
    if n < 2:
        return 1.0
    band = np.argsort(y1[:, 1])[: count * n].reshape(count, n)
    by_x1 = np.take_along_axis(band, np.argsort(y1[band, 0], axis=1), axis=1)
    order = np.argsort(y2[by_x1, 0], axis=1)  # 0, 1, 2 ... where x2 grows with x1
    return 1 - 6 * float(np.sum((order - np.arange(n)) ** 2)) / (count * (n**3 - n))


def parallax_px(x1: Float64s, x2: Float64s) -> float:
    """Distance of matches (n, 2) from one homography, pixels (95 %): near 0 without baseline or relief, inf if none is found."""
    step = max(1, -(-len(x1) // _MOST_MATCHES))
    H, _ = cv2.findHomography(x1[::step], x2[::step], cv2.RANSAC, 2.0, maxIters=2000, confidence=0.999)
    if H is None:
        return float("inf")
    x, y = (apply_homography(np.asarray(H, dtype=np.float64), x1) - x2).T
    return percentiles(np.sqrt(x * x + y * y), 95)[0]


def line_uncertainty(
    F: Float64s,
    x1: Float64s,
    x2: Float64s,
    at1: Float64s,
    at2: Float64s,
    essential: tuple[Float64s, Float64s] | None = None,
    noise: Float64s | None = None,
    freedoms: tuple[Float64s, Float64s] | None = None,
) -> Float64s:
    """Standard deviation (m,) in pixels of epipolar lines of F.

    It combines two parts: the residuals, propagated through the degrees of freedom of F, because few or clustered matches fit
    well and constrain lines elsewhere poorly; and the change of F, to first order, when the matches of one part of the image are
    left out, which reveals wrong matches that agree with each other.

    References: Csurka et al., CVIU 1997; Efron, The jackknife, 1982.

    Parameters
    ----------
    F, x1, x2 : (3, 3) fundamental matrix, and (n, 2) the matches that it was fitted to, pixels.
    at1, at2 : (m, 2) points of image 1 whose lines are evaluated, and the points of image 2 at which they are.
    essential : (K1, K2) if F = K2^-T E K1^-1: five of the seven degrees of freedom are left.
    noise : (n,) standard deviation of each match, pixels; None: estimated from the residuals, the same for all.
    freedoms : directions (9, k) in which F may change, instead of the seven or five, and prior information (k, k) on them.
    """
    half = max(float(np.abs(np.concatenate([x1, x2])).max()) / 2, 1.0)
    N = np.array([[1 / half, 0.0, -1.0], [0.0, 1 / half, -1.0], [0.0, 0.0, 1.0]])
    Ni = np.array([[half, 0.0, half], [0.0, half, half], [0.0, 0.0, 1.0]])
    Fn = Ni.T @ F @ Ni
    length = np.linalg.norm(Fn)
    Fn = Fn / length
    if freedoms is None:
        directions = tangent(Fn, None if essential is None else (N @ essential[0], N @ essential[1]))
        prior = np.zeros((directions.shape[1], directions.shape[1]))
    else:
        directions = (Ni.T @ freedoms[0].T.reshape(-1, 3, 3) @ Ni).reshape(-1, 9).T / length
        directions = directions - np.outer(Fn.ravel(), Fn.ravel() @ directions)
        prior = freedoms[1]
    basis = np.column_stack([Fn.ravel(), directions])  # the derivative along F itself is the residual
    rows = _derivatives(Fn, x1 / half - 1, x2 / half - 1, half) @ basis
    residual, rows = rows[:, 0], np.ascontiguousarray(rows[:, 1:])
    evaluated = _derivatives(Fn, at1 / half - 1, at2 / half - 1, half) @ directions
    if noise is None:
        noise = np.full(len(x1), max(1.4826 * np.median(np.abs(residual)), 0.1))
    residual, rows = residual / noise, rows / noise[:, None]
    scale = 1 / np.sqrt(np.sum(rows * rows, axis=0) + np.diag(prior))  # scales turns and lenses to similar units
    rows, evaluated, prior = rows * scale, evaluated * scale, prior * np.outer(scale, scale)

    values, vectors = np.linalg.eigh(rows.T @ rows + prior)
    spread = vectors / np.sqrt(np.maximum(values, 1e-12 * values.max()))
    changes = _changes_without_each_part(rows, residual, prior, _parts(x1))
    changes = (changes - changes.mean(axis=0)) * np.sqrt((len(changes) - 1) / len(changes))
    components = np.concatenate([evaluated @ spread, evaluated @ changes.T], axis=1)
    return np.asarray(np.linalg.norm(components, axis=1), dtype=np.float64)


def _parts(x: Float64s) -> Int64s:
    """(n,) which of 4 x 3 parts of the image, that hold equally many points, each point (n, 2) belongs to."""
    part = np.empty(len(x), dtype=np.int64)
    for i, column in enumerate(_split(np.argsort(x[:, 0]), _ACROSS)):
        for j, rows in enumerate(_split(column[np.argsort(x[column, 1])], _DOWN)):
            part[rows] = i * _DOWN + j
    return part


def _split(order: Int64s, count: int) -> list[Int64s]:
    n = len(order)
    bounds = [-(-n * k // count) for k in range(count + 1)]
    return [order[first:last] for first, last in pairwise(bounds)]


def _changes_without_each_part(rows: Float64s, residual: Float64s, prior: Float64s, part: Int64s) -> Float64s:
    """(parts, k): the Gauss-Newton step of the robust fit when each part is left out; all in units of the noise."""
    k = rows.shape[1]
    normals, right_sides = np.zeros((part.max() + 1, k, k)), np.zeros((part.max() + 1, k))
    weighted = (1 / (1 + (residual / 2) ** 2))[:, None] * rows
    np.add.at(right_sides, part, weighted * residual[:, None])
    np.add.at(normals, part, weighted[:, :, None] * rows[:, None])
    normal = normals.sum(axis=0) + prior
    reduced = normal + 1e-9 * np.trace(normal) * np.eye(k) - normals
    change = right_sides.sum(axis=0) - right_sides
    return np.asarray(-np.linalg.solve(reduced, change[..., None])[..., 0], dtype=np.float64)


def _derivatives(F: Float64s, x1: Float64s, x2: Float64s, px: float) -> Float64s:
    """(n, 9): how the Sampson distance, in pixels, of normalised points (n, 2) changes with F."""
    (u1, v1), (u2, v2) = x1.T, x2.T
    l1x, l1y = u2 * F[0, 0] + v2 * F[1, 0] + F[2, 0], u2 * F[0, 1] + v2 * F[1, 1] + F[2, 1]
    l2x, l2y = F[0, 0] * u1 + F[0, 1] * v1 + F[0, 2], F[1, 0] * u1 + F[1, 1] * v1 + F[1, 2]
    s = px / np.sqrt(l1x * l1x + l1y * l1y + l2x * l2x + l2y * l2y + 1e-30)
    return np.column_stack([s * u2 * u1, s * u2 * v1, s * u2, s * v2 * u1, s * v2 * v1, s * v2, s * u1, s * v1, s])

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
_BANDS = 12
"""Bands of rows in which order along x is compared."""
_LEAST_IN_BAND = 8
"""Fewer bands are used if they would hold fewer matches than this."""
_ACROSS = 4
"""Columns of the parts of an image that are left out in turn."""
_DOWN = 3
"""Rows of these parts; more parts are smaller, and hide groups of wrong matches that agree with each other."""
_HOMOGRAPHY_PX = 2.0
"""Largest distance, pixels, of a match that agrees with a homography."""
_LEAST_NOISE_PX = 0.1
"""Smallest assumed standard deviation of a match, pixels: residuals of few matches may be smaller by chance."""


def order_agreement(y1: Float64s, y2: Float64s) -> float:
    """Spearman's rank correlation of x within bands of rows of rectified matches y1, y2 (n, 2): near 1 if right, any value if F
    is wrong.  All bands hold equally many; up to 11 matches of the last rows are left over."""
    step = max(1, -(-len(y1) // _MOST_MATCHES))
    y1 = y1[::step]
    y2 = y2[::step]
    count = max(1, min(_BANDS, len(y1) // _LEAST_IN_BAND))
    n = len(y1) // count
    if n < 2:
        return 1.0
    band = np.argsort(y1[:, 1])[: count * n].reshape(count, n)  # one row of matches for each band
    by_x1 = np.take_along_axis(band, np.argsort(y1[band, 0], axis=1), axis=1)
    order = np.argsort(y2[by_x1, 0], axis=1)  # 0, 1, 2 ... where x2 grows with x1
    # Spearman's formula for ranks without ties, over all bands together
    squared_differences = float(np.sum((order - np.arange(n)) ** 2))
    return 1 - 6 * squared_differences / (count * (n**3 - n))


def parallax_px(x1: Float64s, x2: Float64s) -> float:
    """Distance of matches (n, 2) from one homography, pixels (95 %): near 0 without baseline or relief, inf if none is found."""
    step = max(1, -(-len(x1) // _MOST_MATCHES))
    H, _ = cv2.findHomography(x1[::step], x2[::step], cv2.RANSAC, _HOMOGRAPHY_PX, maxIters=2000, confidence=0.999)
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
    # 1. pixels to about -1..1, so that the nine coefficients of F weigh alike
    half = max(float(np.abs(np.concatenate([x1, x2])).max()) / 2, 1.0)
    N = np.array([[1 / half, 0.0, -1.0], [0.0, 1 / half, -1.0], [0.0, 0.0, 1.0]])
    Ni = np.array([[half, 0.0, half], [0.0, half, half], [0.0, 0.0, 1.0]])
    Fn = Ni.T @ F @ Ni
    length = np.linalg.norm(Fn)
    Fn = Fn / length

    # 2. directions (9, k) in which F may change, and what is known of them beforehand
    if freedoms is None:
        normalised_essential = None
        if essential is not None:
            normalised_essential = (N @ essential[0], N @ essential[1])
        directions = tangent(Fn, normalised_essential)
        prior = np.zeros((directions.shape[1], directions.shape[1]))
    else:
        directions_px, prior = freedoms
        directions = (Ni.T @ directions_px.T.reshape(-1, 3, 3) @ Ni).reshape(-1, 9).T / length
        # a change along F itself is none: its length is free
        directions = directions - np.outer(Fn.ravel(), Fn.ravel() @ directions)

    # 3. residuals, their derivatives, and those of the lines that are evaluated, in units of the noise
    basis = np.column_stack([Fn.ravel(), directions])  # the derivative along F itself is the residual
    rows = _derivatives(Fn, x1 / half - 1, x2 / half - 1, half) @ basis
    residual = rows[:, 0]
    rows = np.ascontiguousarray(rows[:, 1:])
    evaluated = _derivatives(Fn, at1 / half - 1, at2 / half - 1, half) @ directions
    if noise is None:
        noise = np.full(len(x1), max(1.4826 * np.median(np.abs(residual)), _LEAST_NOISE_PX))
    residual = residual / noise
    rows = rows / noise[:, None]
    scale = 1 / np.sqrt(np.sum(rows * rows, axis=0) + np.diag(prior))  # scales turns and lenses to similar units
    rows = rows * scale
    evaluated = evaluated * scale
    prior = prior * np.outer(scale, scale)

    # 4. the noise, propagated by a square root of the covariance; weak directions are limited, not dropped
    values, vectors = np.linalg.eigh(rows.T @ rows + prior)
    spread = vectors / np.sqrt(np.maximum(values, 1e-12 * values.max()))
    # 5. the jackknife: changes without each part, scaled to a standard deviation
    changes = _changes_without_each_part(rows, residual, prior, _parts(x1))
    changes = (changes - changes.mean(axis=0)) * np.sqrt((len(changes) - 1) / len(changes))
    # 6. both together are the length of a vector for each line
    components = np.concatenate([evaluated @ spread, evaluated @ changes.T], axis=1)
    return np.asarray(np.linalg.norm(components, axis=1), dtype=np.float64)


def _parts(x: Float64s) -> Int64s:
    """(n,) which of 4 x 3 parts of the image, that hold equally many points, each point (n, 2) belongs to."""
    part = np.empty(len(x), dtype=np.int64)
    from_left = np.argsort(x[:, 0])
    for i, column in enumerate(_split(from_left, _ACROSS)):
        from_top = column[np.argsort(x[column, 1])]
        for j, members in enumerate(_split(from_top, _DOWN)):
            part[members] = i * _DOWN + j
    return part


def _split(order: Int64s, count: int) -> list[Int64s]:
    """The items (n,) in `count` runs of about equal length."""
    n = len(order)
    bounds = [-(-n * k // count) for k in range(count + 1)]
    return [order[first:last] for first, last in pairwise(bounds)]


def _changes_without_each_part(rows: Float64s, residual: Float64s, prior: Float64s, part: Int64s) -> Float64s:
    """(parts, k) the Gauss-Newton step of the robust fit when each part is left out; all in units of the noise.

    Parameters
    ----------
    rows, residual : (n, k) derivatives of the residuals, and (n,) the residuals.
    prior : (k, k) prior information.
    part : (n,) which part each belongs to.
    """
    k = rows.shape[1]
    parts = part.max() + 1
    # normal equations of each part by itself; Cauchy weights
    normals = np.zeros((parts, k, k))
    right_sides = np.zeros((parts, k))
    weights = 1 / (1 + (residual / 2) ** 2)
    weighted = weights[:, None] * rows
    np.add.at(right_sides, part, weighted * residual[:, None])
    np.add.at(normals, part, weighted[:, :, None] * rows[:, None])
    # of all but one part: the sum minus its own, damped slightly, since few matches may be left
    normal = normals.sum(axis=0) + prior
    reduced = normal + 1e-9 * np.trace(normal) * np.eye(k) - normals
    change = right_sides.sum(axis=0) - right_sides
    return np.asarray(-np.linalg.solve(reduced, change[..., None])[..., 0], dtype=np.float64)


def _derivatives(F: Float64s, x1: Float64s, x2: Float64s, px: float) -> Float64s:
    """(n, 9): how the Sampson distance, in pixels, of normalised points (n, 2) changes with F; px: pixels of a normalised unit.

    The distance is x2^T F x1 over the length of the first two coordinates of both lines, which is taken as constant."""
    u1, v1 = x1.T
    u2, v2 = x2.T
    # the lines F^T x2 in image 1 and F x1 in image 2
    l1x = u2 * F[0, 0] + v2 * F[1, 0] + F[2, 0]
    l1y = u2 * F[0, 1] + v2 * F[1, 1] + F[2, 1]
    l2x = F[0, 0] * u1 + F[0, 1] * v1 + F[0, 2]
    l2y = F[1, 0] * u1 + F[1, 1] * v1 + F[1, 2]
    s = px / np.sqrt(l1x * l1x + l1y * l1y + l2x * l2x + l2y * l2y + 1e-30)
    return np.column_stack([s * u2 * u1, s * u2 * v1, s * u2, s * v2 * u1, s * v2 * v1, s * v2, s * u1, s * v1, s])

"""What a rectification is worth: signs that it is wrong, and how far its rows can be trusted (algorithms of degenerate cases)."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from ..epipolar import epipoles, homogeneous, sampson_distance, skew
from ..types import Float64s

Int64s = npt.NDArray[np.int64]


def order_agreement(y1: Float64s, y2: Float64s, bands: int = 12) -> float:
    """Rank correlation of x within bands of rows of rectified matches y1, y2 (n, 2): near 1 if right, any value if F is wrong."""
    order = np.argsort(y1[:, 1], kind="stable")
    parts = np.array_split(order, max(1, min(bands, len(order) // 8)))
    agreement = [len(part) * _rank_correlation(y1[part, 0], y2[part, 0]) for part in parts if len(part) > 1]
    return sum(agreement) / sum(len(part) for part in parts if len(part) > 1) if agreement else 1.0


def _rank_correlation(a: Float64s, b: Float64s) -> float:
    """Spearman's, for values (n,) without ties: 1 - 6 sum d^2 / (n^3 - n)."""
    n = len(a)
    ranks = np.empty((2, n))
    for row, values in zip(ranks, (a, b), strict=True):
        row[np.argsort(values, kind="stable")] = np.arange(n)
    return 1 - 6 * float(np.sum((ranks[0] - ranks[1]) ** 2)) / (n**3 - n)


def parallax_px(x1: Float64s, x2: Float64s) -> float:
    """How far matches (n, 2) lie from one homography, in pixels (95 %): nothing where there is no baseline, or no relief."""
    H, _ = cv2.findHomography(x1, x2, cv2.RANSAC, 2.0, maxIters=2000, confidence=0.999)
    if H is None:
        return float("inf")
    q = homogeneous(x1) @ H.T
    return float(np.percentile(np.hypot(*(q[:, :2] / q[:, 2:] - x2).T), 95))


def line_uncertainty(
    F: Float64s, x1: Float64s, x2: Float64s, at1: Float64s, at2: Float64s, essential: tuple[Float64s, Float64s] | None = None
) -> Float64s:
    """Standard deviation (m,) in pixels of the epipolar line of at1 (m, 2) beside at2 (m, 2), for F fitted to x1, x2 (n, 2).

    Two parts.  The residuals, propagated through the seven degrees of freedom of F, or the five that are left when
    F = K2^-T E K1^-1 and `essential` = (K1, K2): few or clustered matches fit well and say little elsewhere, which no residual
    tells.  And how F changes, to first order, when the matches of one part of the image are left out: wrong matches that agree
    with each other show there.  References: Csurka et al., CVIU 1997; Efron, The jackknife, 1982.
    """
    half = max(float(np.abs(np.concatenate([x1, x2])).max()) / 2, 1.0)
    N = np.array([[1 / half, 0.0, -1.0], [0.0, 1 / half, -1.0], [0.0, 0.0, 1.0]])
    Ni = np.linalg.inv(N)
    Fn = Ni.T @ F @ Ni
    Fn = Fn / np.linalg.norm(Fn)
    tangent = _tangent(Fn, None if essential is None else (N @ essential[0], N @ essential[1]))
    rows = _derivatives(Fn, homogeneous(x1) @ N.T, homogeneous(x2) @ N.T, half) @ tangent
    elsewhere = _derivatives(Fn, homogeneous(at1) @ N.T, homogeneous(at2) @ N.T, half) @ tangent
    residual = sampson_distance(F, x1, x2)
    noise = max(1.4826 * float(np.median(np.abs(residual))), 0.1)

    values, vectors = np.linalg.eigh(rows.T @ rows)
    spread = vectors * (noise / np.sqrt(np.maximum(values, 1e-12 * values.max())))
    moves = _moves_without_each_part(rows, residual, noise, _parts(x1))
    moves = (moves - moves.mean(axis=0)) * np.sqrt((len(moves) - 1) / len(moves))
    both = np.concatenate([elsewhere @ spread, elsewhere @ moves.T], axis=1)
    return np.asarray(np.linalg.norm(both, axis=1), dtype=np.float64)


def _parts(x: Float64s, across: int = 4, down: int = 3) -> Int64s:
    """(n,) which of 4 x 3 parts of the image, that hold equally many points, each point (n, 2) belongs to."""
    n = len(x)
    column = np.empty(n, dtype=np.int64)
    column[np.argsort(x[:, 0], kind="stable")] = np.arange(n) * across // n
    part = np.empty(n, dtype=np.int64)
    order = np.lexsort((x[:, 1], column))
    first = np.searchsorted(column[order], np.arange(across + 1))
    within = np.arange(n) - first[column[order]]
    part[order] = column[order] * down + within * down // np.diff(first)[column[order]]
    return part


def _moves_without_each_part(rows: Float64s, residual: Float64s, noise: float, part: Int64s) -> Float64s:
    """(parts, k): the Gauss-Newton step of the robust fit when each part is left out."""
    k = rows.shape[1]
    weighted = rows / (1 + (residual / (2 * noise)) ** 2)[:, None]
    normal, right = weighted.T @ rows, weighted.T @ residual
    ridge = 1e-9 * np.trace(normal) * np.eye(k)
    groups = [part == p for p in range(part.max() + 1)]
    without = normal + ridge - np.stack([weighted[g].T @ rows[g] for g in groups])
    change = right - np.stack([weighted[g].T @ residual[g] for g in groups])
    return np.asarray(-np.linalg.solve(without, change[..., None])[..., 0], dtype=np.float64)


def _tangent(F: Float64s, intrinsics: tuple[Float64s, Float64s] | None) -> Float64s:
    """Orthonormal directions (9, k) in which F may change: it keeps its norm and its rank, or stays an essential matrix."""
    if intrinsics is None:
        e1, e2 = epipoles(F)  # no change along F itself, nor along e2 e1^T
        return np.asarray(np.linalg.svd(np.stack([F.ravel(), np.outer(e2, e1).ravel()]))[2][2:].T, dtype=np.float64)
    K1, K2 = intrinsics
    E = K2.T @ F @ K1
    moves = [M for axis in np.eye(3) for M in (skew(axis) @ E, E @ skew(axis))]  # turn either camera about an axis
    changes = np.stack([(np.linalg.inv(K2).T @ M @ np.linalg.inv(K1)).ravel() for M in moves])
    changes = changes - np.outer(changes @ F.ravel(), F.ravel())
    return np.asarray(np.linalg.svd(changes)[2][:5].T, dtype=np.float64)


def _derivatives(F: Float64s, m1: Float64s, m2: Float64s, px: float) -> Float64s:
    """(n, 9): how the Sampson distance, in pixels, of normalised points (n, 3) changes with F."""
    l1, l2 = m2 @ F, m1 @ F.T
    gradient = np.sqrt(l1[:, 0] ** 2 + l1[:, 1] ** 2 + l2[:, 0] ** 2 + l2[:, 1] ** 2 + 1e-30)
    return np.asarray((m2[:, :, None] * m1[:, None, :]).reshape(len(m1), 9) * (px / gradient)[:, None], dtype=np.float64)

"""A local affine map at every keypoint, from the confident matches around it.

Each query point fits `x2 = y + A (x1 - query)` to its nearest matches by iteratively reweighted least squares (Geman-McClure),
with a ridge that draws A toward the mean of what the matched keypoints' own frames say.  A match that lies on the query itself is
left out, so that the map is always the opinion of the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.jit import helper, kernel
from ..core.nearest_points import nearest_points
from ..core.sorting import sorting_network
from ..types import Float64s, Int32s, Int64s

_BATCH = 128
_WIDTH_RANK = 8
"""The distance of this neighbour (0 is the nearest) is the width of the weights."""


@dataclass(frozen=True)
class AffineField:
    """A local affine model of the matches at each of m queries."""

    prediction: Float64s
    """(m, 2), pixels in image 2."""
    affine: Float64s
    """(m, 2, 2)."""
    sigma_px: Float64s
    """(m,), weighted median residual of the neighbours, at least 1."""
    support: Float64s
    """(m,), summed weight of the neighbours that agree."""


def fit_affine_field(
    x1: Float64s, x2: Float64s, affine: Float64s, weight: Float64s, queries: Float64s, neighbours: int = 20, ridge: float = 2.0
) -> AffineField:
    """Fit the field to matches, at queries.

    Parameters
    ----------
    x1, x2
        (n, 2) pixels of the matches in either image; n >= 2.
    affine
        (n, 2, 2) from frame 1 to frame 2 of each match.
    weight
        (n,) of each match, 0 to 1.
    queries
        (m, 2) pixels of image 1.
    neighbours
        Matches that a query asks.
    ridge
        Pull toward the mean of the frame affines; no unit.
    """
    distance, index = nearest_points(x1, queries, min(neighbours, len(x1) - 1) + 1)
    m = len(queries)
    field = AffineField(np.empty((m, 2)), np.empty((m, 2, 2)), np.empty(m), np.empty(m))
    _fit(
        queries, distance, index, x1, x2, affine, weight, ridge, sorting_network(distance.shape[1]),
        field.prediction, field.affine, field.sigma_px, field.support,
    )  # fmt: skip
    return field


@kernel
def _fit(
    queries: Float64s,
    distance: Float64s,
    index: Int32s,
    x1: Float64s,
    x2: Float64s,
    affine: Float64s,
    weight: Float64s,
    ridge: float,
    network: Int64s,
    prediction: Float64s,
    out: Float64s,
    sigma: Float64s,
    support: Float64s,
) -> None:
    """A batch of queries at a time: arrays hold a row for each neighbour and a column for each query, and every loop over columns
    is one that the compiler does for several at once."""
    k = distance.shape[1]
    w0, w, e = np.zeros((k, _BATCH)), np.zeros((k, _BATCH)), np.zeros((k, _BATCH))
    u, v, s, t = np.zeros((k, _BATCH)), np.zeros((k, _BATCH)), np.zeros((k, _BATCH)), np.zeros((k, _BATCH))
    values, weights = np.zeros((k, _BATCH)), np.zeros((k, _BATCH))
    scale, pull, spread, agree = np.ones(_BATCH), np.ones(_BATCH), np.ones(_BATCH), np.zeros(_BATCH)
    middle, drawn, found, sums = np.zeros((2, _BATCH)), np.zeros((4, _BATCH)), np.zeros((6, _BATCH)), np.zeros((12, _BATCH))
    for first in range(0, len(queries), _BATCH):
        count = min(_BATCH, len(queries) - first)
        for c in range(count):
            _gather(
                queries[first + c], distance[first + c], index[first + c], x1, x2, affine, weight, ridge, c,
                w0, u, v, s, t, scale, pull, middle, drawn,
            )  # fmt: skip
        for a in range(k):  # not  w[:] = w0: how to raise for shapes that differ takes longer to compile than all of this
            for c in range(_BATCH):
                w[a, c] = w0[a, c]
        for _ in range(4):
            sums[:] = 0.0
            for a in range(k):
                _add_squares(w[a], u[a], v[a], sums[0], sums[1], sums[2], sums[3], sums[4], sums[5])
                _add_products(w[a], u[a], v[a], s[a], sums[6], sums[7], sums[8])
                _add_products(w[a], u[a], v[a], t[a], sums[9], sums[10], sums[11])
            _solve(sums, pull, drawn, found)
            for a in range(k):
                _residuals(u[a], v[a], s[a], t[a], found, e[a])
                for c in range(_BATCH):
                    values[a, c], weights[a, c] = e[a, c], w0[a, c]
            _sort(values, weights, network)
            _median(values, weights, spread)
            for a in range(k):
                _reweigh(w0[a], e[a], spread, w[a])
        agree[:] = 0.0
        for a in range(k):
            _add_agreeing(w0[a], e[a], spread, agree)
        for c in range(count):
            q = first + c
            prediction[q, 0], prediction[q, 1] = middle[0, c] + found[2, c], middle[1, c] + found[5, c]
            out[q, 0, 0], out[q, 0, 1] = found[0, c] / scale[c], found[1, c] / scale[c]
            out[q, 1, 0], out[q, 1, 1] = found[3, c] / scale[c], found[4, c] / scale[c]
            sigma[q], support[q] = spread[c], agree[c]


@helper
def _gather(
    query: Float64s,
    distance: Float64s,
    index: Int32s,
    x1: Float64s,
    x2: Float64s,
    affine: Float64s,
    weight: Float64s,
    ridge: float,
    c: int,
    w0: Float64s,
    u: Float64s,
    v: Float64s,
    s: Float64s,
    t: Float64s,
    scale: Float64s,
    pull: Float64s,
    middle: Float64s,
    drawn: Float64s,
) -> None:
    """Write the neighbours of one query into column c: weights by distance, u, v around the query in units of `scale`, s, t
    around their mean in image 2, `middle`; drawn: the mean of the frame affines, toward which `pull` draws."""
    k = len(distance)
    width = distance[min(k - 1, _WIDTH_RANK)] + 1.0
    scale[c] = width + 5.0
    total, ms, mt = 1e-9, 0.0, 0.0
    m00, m01, m10, m11 = 0.0, 0.0, 0.0, 0.0
    for a in range(k):
        j = index[a]
        n = weight[j] / (1 + (distance[a] / width) ** 2) if distance[a] > 1e-6 else 0.0
        w0[a, c] = n
        u[a, c], v[a, c] = (x1[j, 0] - query[0]) / scale[c], (x1[j, 1] - query[1]) / scale[c]
        total += n
        ms += n * x2[j, 0]
        mt += n * x2[j, 1]
        m00 += n * affine[j, 0, 0]
        m01 += n * affine[j, 0, 1]
        m10 += n * affine[j, 1, 0]
        m11 += n * affine[j, 1, 1]
    ms, mt = ms / total, mt / total
    for a in range(k):
        s[a, c], t[a, c] = x2[index[a], 0] - ms, x2[index[a], 1] - mt
    middle[0, c], middle[1, c] = ms, mt
    pull[c] = 0.02 * ridge * total
    drawn[0, c], drawn[1, c] = m00 / total * scale[c], m01 / total * scale[c]
    drawn[2, c], drawn[3, c] = m10 / total * scale[c], m11 / total * scale[c]


@helper
def _add_squares(
    w: Float64s, u: Float64s, v: Float64s,
    uu: Float64s, uv: Float64s, vv: Float64s, u1: Float64s, v1: Float64s, one: Float64s,
) -> None:  # fmt: skip
    for c in range(len(w)):
        wu, wv = w[c] * u[c], w[c] * v[c]
        uu[c] += wu * u[c]
        uv[c] += wu * v[c]
        vv[c] += wv * v[c]
        u1[c] += wu
        v1[c] += wv
        one[c] += w[c]


@helper
def _add_products(w: Float64s, u: Float64s, v: Float64s, s: Float64s, us: Float64s, vs: Float64s, one_s: Float64s) -> None:
    for c in range(len(w)):
        ws = w[c] * s[c]
        us[c] += u[c] * ws
        vs[c] += v[c] * ws
        one_s[c] += ws


@helper
def _solve(sums: Float64s, pull: Float64s, drawn: Float64s, found: Float64s) -> None:
    """The normal equations by cofactors; found: two rows (a, b, offset), s = a u + b v + offset, and the same for t."""
    for c in range(len(pull)):
        suu, suv, svv = sums[0, c] + pull[c] + 1e-6, sums[1, c], sums[2, c] + pull[c] + 1e-6
        su, sv, sw = sums[3, c], sums[4, c], sums[5, c] + 1e-6
        c00, c01, c02 = svv * sw - sv * sv, sv * su - suv * sw, suv * sv - svv * su
        c11, c12, c22 = suu * sw - su * su, suv * su - suu * sv, suu * svv - suv * suv
        det = suu * c00 + suv * c01 + su * c02
        for row in range(2):
            bu, bv = sums[6 + 3 * row, c] + pull[c] * drawn[2 * row, c], sums[7 + 3 * row, c] + pull[c] * drawn[2 * row + 1, c]
            b = sums[8 + 3 * row, c]
            found[3 * row, c] = (c00 * bu + c01 * bv + c02 * b) / det
            found[3 * row + 1, c] = (c01 * bu + c11 * bv + c12 * b) / det
            found[3 * row + 2, c] = (c02 * bu + c12 * bv + c22 * b) / det


@helper
def _residuals(u: Float64s, v: Float64s, s: Float64s, t: Float64s, found: Float64s, e: Float64s) -> None:
    for c in range(len(u)):
        es = found[0, c] * u[c] + found[1, c] * v[c] + found[2, c] - s[c]
        et = found[3, c] * u[c] + found[4, c] * v[c] + found[5, c] - t[c]
        e[c] = np.sqrt(es * es + et * et)


@helper
def _sort(values: Float64s, weights: Float64s, network: Int64s) -> None:
    """Sort each column; the weights go with the values."""
    for n in range(len(network)):
        i, j = np.uint64(network[n, 0]), np.uint64(network[n, 1])
        for c in range(values.shape[1]):
            a, b, p, q = values[i, c], values[j, c], weights[i, c], weights[j, c]
            swap = a > b
            values[i, c], values[j, c] = b if swap else a, a if swap else b
            weights[i, c], weights[j, c] = q if swap else p, p if swap else q


@helper
def _median(values: Float64s, weights: Float64s, spread: Float64s) -> None:
    """Of each sorted column the smallest value with half the weight at or below it, at least 1."""
    k, n = values.shape
    half, below = np.zeros(n), np.zeros(n)
    for a in range(k):
        for c in range(n):
            half[c] += 0.5 * weights[a, c]
    for c in range(n):
        spread[c] = values[k - 1, c]
    for a in range(k):
        for c in range(n):
            before = below[c] < half[c]
            below[c] += weights[a, c]
            spread[c] = values[a, c] if before and below[c] >= half[c] else spread[c]
    for c in range(n):
        spread[c] = max(spread[c], 1.0)


@helper
def _reweigh(w0: Float64s, e: Float64s, spread: Float64s, w: Float64s) -> None:
    for c in range(len(w0)):
        w[c] = w0[c] / (1 + (e[c] / (2 * spread[c])) ** 2) ** 2


@helper
def _add_agreeing(w0: Float64s, e: Float64s, spread: Float64s, agree: Float64s) -> None:
    for c in range(len(w0)):
        agree[c] += w0[c] if e[c] < 3 * max(spread[c], 2.0) else 0.0

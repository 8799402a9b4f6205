"""A local affine map at every keypoint, from the confident matches around it.

Each query point fits `x2 = y + A (x1 - query)` to its nearest matches by iteratively reweighted least squares (Geman-McClure),
with a ridge that draws A toward the mean of the affine maps between the matched keypoints' own frames.  A match at the query
itself is left out, so that the map always comes from the other matches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.jit import helper, kernel
from ..core.nearest_points import nearest_points
from ..types import Float32s, Float64s, Int32s

_BATCH = 128
"""Queries that are fitted at a time: the columns of the kernels' arrays, which then stay in the processor's cache."""
_PASSES = 4
"""Weighted fits, each with the weights of the one before; no unit."""
_WIDTH_RANK = 8
"""Rank of the neighbour (0 is the nearest) whose distance is the width of the distance weights."""
_LARGEST_SPREAD_PX = 65536.0
"""Upper limit of the median residual, pixels; the lower limit is 1."""
_HALVINGS = 11
"""Bisections of the logarithm of the median residual between its limits: exact to half a per cent."""


@dataclass(frozen=True)
class AffineField:
    """A local affine model of the matches at each of m queries."""

    prediction: Float64s
    """(m, 2), pixels in image 2."""
    affine: Float64s
    """(m, 2, 2)."""
    sigma_px: Float64s
    """(m,), weighted median residual of the neighbouring matches, at least 1."""
    support: Float64s
    """(m,), summed weight of the neighbouring matches that agree."""


def fit_affine_field(
    x1: Float64s, x2: Float64s, affine: Float64s, weight: Float64s, queries: Float64s, neighbours: int = 20, ridge: float = 2.0
) -> AffineField:
    """Fit the field to matches, at query points.

    Parameters
    ----------
    x1, x2 : (n, 2) pixels of the matches in either image; n >= 2.
    affine : (n, 2, 2) from frame 1 to frame 2 of each match.
    weight : (n,) of each match, 0 to 1.
    queries : (m, 2) pixels of image 1.
    neighbours : nearest matches that each query uses.
    ridge : pull toward the mean of the frame affines; no unit.
    """
    # one more than wanted: a match at the query itself gets no weight
    distance, index = nearest_points(x1, queries, min(neighbours, len(x1) - 1) + 1)
    m, k = distance.shape
    rank = min(k - 1, _WIDTH_RANK)
    width = np.partition(distance, rank, axis=1)[:, rank] + 1.0
    field = AffineField(np.empty((m, 2)), np.empty((m, 2, 2)), np.empty(m), np.empty(m))
    _fit(
        queries, distance, width, index, x1, x2, affine, weight, ridge,
        field.prediction, field.affine, field.sigma_px, field.support,
    )  # fmt: skip
    return field


@kernel
def _fit(
    queries: Float64s,
    distance: Float64s,
    width: Float64s,
    index: Int32s,
    x1: Float64s,
    x2: Float64s,
    affine: Float64s,
    weight: Float64s,
    ridge: float,
    prediction: Float64s,
    out: Float64s,
    sigma: Float64s,
    support: Float64s,
) -> None:
    """Fit a batch of queries at a time: arrays hold a row for each neighbour and a column for each query, so that the compiler
    can vectorise every loop over columns."""
    k = distance.shape[1]

    # (k, _BATCH) each: a row for each neighbour
    by_neighbour = np.zeros((7, k, _BATCH), np.float32)
    w0 = by_neighbour[0]  # weights by probability and distance
    w = by_neighbour[1]  # the same times the robust weights of the last pass
    e = by_neighbour[2]  # residuals, pixels
    u = by_neighbour[3]  # position in image 1 from the query, in units of `scale`
    v = by_neighbour[4]
    s = by_neighbour[5]  # position in image 2 from `middle`, pixels
    t = by_neighbour[6]

    # (_BATCH,) each, or one row for each of several numbers
    by_query = np.zeros((27, _BATCH), np.float32)
    scale = by_query[0]
    pull = by_query[1]
    spread = by_query[2]  # weighted median residual, pixels
    agreeing = by_query[3]  # summed weight of the neighbours that agree
    scratch = by_query[4]
    target = by_query[5:9]
    solution = by_query[9:15]
    sums = by_query[15:27]
    middle = np.ones((2, _BATCH))

    for first in range(0, len(queries), _BATCH):
        # the last batch may be smaller: its other columns still hold the batch before, and are not written out
        count = min(_BATCH, len(queries) - first)
        for c in range(count):
            _gather(
                first + c, queries, distance, width, index, x1, x2, affine, weight, ridge, c,
                w0, u, v, s, t, scale, pull, middle, target,
            )  # fmt: skip
        _fit_batch(w0, u, v, s, t, pull, target, w, e, sums, scratch, solution, spread, agreeing)
        for c in range(count):
            q = first + c
            prediction[q, 0] = middle[0, c] + solution[2, c]
            prediction[q, 1] = middle[1, c] + solution[5, c]
            # u and v are in units of `scale`
            out[q, 0, 0] = solution[0, c] / scale[c]
            out[q, 0, 1] = solution[1, c] / scale[c]
            out[q, 1, 0] = solution[3, c] / scale[c]
            out[q, 1, 1] = solution[4, c] / scale[c]
            sigma[q] = spread[c]
            support[q] = agreeing[c]


@helper
def _gather(
    q: int,
    queries: Float64s,
    distance: Float64s,
    widths: Float64s,
    index: Int32s,
    x1: Float64s,
    x2: Float64s,
    affine: Float64s,
    weight: Float64s,
    ridge: float,
    c: int,
    w0: Float32s,
    u: Float32s,
    v: Float32s,
    s: Float32s,
    t: Float32s,
    scale: Float32s,
    pull: Float32s,
    middle: Float64s,
    target: Float32s,
) -> None:
    """Write the neighbours of one query into column c.  w0: weights by distance; u, v: positions from the query, in units of
    `scale`; s, t: positions in image 2 from their mean `middle`; target: mean frame affine, toward which `pull` draws."""
    k = distance.shape[1]
    width = widths[q]
    unit = width + 5.0
    scale[c] = unit
    total = 1e-9  # so that queries without weight get no nan
    ms = 0.0
    mt = 0.0
    m00 = 0.0
    m01 = 0.0
    m10 = 0.0
    m11 = 0.0
    for a in range(k):
        j = index[q, a]
        # a Cauchy weight of the distance; none for the match at the query itself
        w = weight[j] / (1 + (distance[q, a] / width) ** 2) if distance[q, a] > 1e-6 else 0.0
        w0[a, c] = w
        u[a, c] = (x1[j, 0] - queries[q, 0]) / unit
        v[a, c] = (x1[j, 1] - queries[q, 1]) / unit
        total += w
        ms += w * x2[j, 0]
        mt += w * x2[j, 1]
        m00 += w * affine[j, 0, 0]
        m01 += w * affine[j, 0, 1]
        m10 += w * affine[j, 1, 0]
        m11 += w * affine[j, 1, 1]
    ms /= total
    mt /= total
    # float32 is coarse far from 0: positions in image 2 are taken from their mean
    for a in range(k):
        s[a, c] = x2[index[q, a], 0] - ms
        t[a, c] = x2[index[q, a], 1] - mt
    middle[0, c] = ms
    middle[1, c] = mt
    pull[c] = 0.02 * ridge * total
    target[0, c] = m00 / total * unit
    target[1, c] = m01 / total * unit
    target[2, c] = m10 / total * unit
    target[3, c] = m11 / total * unit


@helper
def _fit_batch(
    w0: Float32s, u: Float32s, v: Float32s, s: Float32s, t: Float32s, pull: Float32s, target: Float32s,
    w: Float32s, e: Float32s, sums: Float32s, scratch: Float32s,
    solution: Float32s, spread: Float32s, agreeing: Float32s,
) -> None:  # fmt: skip
    """Iteratively reweighted least squares of all columns: write solution, spread and agreeing; names as in `_fit`."""
    k = len(w0)
    _copy(w0, w)
    for _ in range(_PASSES):
        # normal equations: 6 sums for the symmetric matrix, 3 for each right side
        for a in range(12):
            _set_zero(sums[a])
        for a in range(k):
            _add_squares(w[a], u[a], v[a], sums[0], sums[1], sums[2], sums[3], sums[4], sums[5])
            _add_products(w[a], u[a], v[a], s[a], sums[6], sums[7], sums[8])
            _add_products(w[a], u[a], v[a], t[a], sums[9], sums[10], sums[11])
        _solve(sums, pull, target, solution)
        # new weights from the residuals, relative to their median; `agreeing` is scratch until the passes have ended
        for a in range(k):
            _residuals(u[a], v[a], s[a], t[a], solution, e[a])
        _median(e, w0, spread, agreeing, scratch)
        for a in range(k):
            _reweigh(w0[a], e[a], spread, w[a])
    _set_zero(agreeing)
    for a in range(k):
        _add_agreeing(w0[a], e[a], spread, agreeing)


@helper
def _copy(source: Float32s, target: Float32s) -> None:
    """Copy without `target[:] = source`, whose error for different shapes takes longer to compile than this whole function."""
    for a in range(source.shape[0]):
        for c in range(source.shape[1]):
            target[a, c] = source[a, c]


@helper
def _set_zero(row: Float32s) -> None:
    for c in range(len(row)):
        row[c] = 0


@helper
def _add_squares(
    w: Float32s, u: Float32s, v: Float32s,
    uu: Float32s, uv: Float32s, vv: Float32s, u1: Float32s, v1: Float32s, one: Float32s,
) -> None:  # fmt: skip
    """Add one neighbour's share of the normal matrix, the weighted sum of (u, v, 1)^T (u, v, 1)."""
    for c in range(len(w)):
        wu = w[c] * u[c]
        wv = w[c] * v[c]
        uu[c] += wu * u[c]
        uv[c] += wu * v[c]
        vv[c] += wv * v[c]
        u1[c] += wu
        v1[c] += wv
        one[c] += w[c]


@helper
def _add_products(w: Float32s, u: Float32s, v: Float32s, s: Float32s, us: Float32s, vs: Float32s, one_s: Float32s) -> None:
    """Add one neighbour's share of a right side, the weighted sum of (u, v, 1)^T s."""
    for c in range(len(w)):
        ws = w[c] * s[c]
        us[c] += u[c] * ws
        vs[c] += v[c] * ws
        one_s[c] += ws


@helper
def _solve(sums: Float32s, pull: Float32s, target: Float32s, solution: Float32s) -> None:
    """The normal equations by cofactors; solution: two rows (a, b, offset), s = a u + b v + offset, and the same for t."""
    for c in range(len(pull)):
        # the matrix [[suu, suv, su], [suv, svv, sv], [su, sv, sw]]; 1e-6 keeps it invertible where nothing has weight.
        # In double precision, since cofactors are differences of products.
        ridge = float(pull[c])
        suu = sums[0, c] + ridge + 1e-6
        suv = float(sums[1, c])
        svv = sums[2, c] + ridge + 1e-6
        su = float(sums[3, c])
        sv = float(sums[4, c])
        sw = sums[5, c] + 1e-6
        c00 = svv * sw - sv * sv
        c01 = sv * su - suv * sw
        c02 = suv * sv - svv * su
        c11 = suu * sw - su * su
        c12 = suv * su - suu * sv
        c22 = suu * svv - suv * suv
        det = suu * c00 + suv * c01 + su * c02
        for row in range(2):
            # the ridge adds the target to the right side, so that a and b are drawn toward it, not toward 0
            bu = sums[6 + 3 * row, c] + ridge * target[2 * row, c]
            bv = sums[7 + 3 * row, c] + ridge * target[2 * row + 1, c]
            b = sums[8 + 3 * row, c]
            solution[3 * row, c] = (c00 * bu + c01 * bv + c02 * b) / det
            solution[3 * row + 1, c] = (c01 * bu + c11 * bv + c12 * b) / det
            solution[3 * row + 2, c] = (c02 * bu + c12 * bv + c22 * b) / det


@helper
def _residuals(u: Float32s, v: Float32s, s: Float32s, t: Float32s, solution: Float32s, e: Float32s) -> None:
    """Write one neighbour's distances from the fitted maps, pixels of image 2."""
    for c in range(len(u)):
        es = solution[0, c] * u[c] + solution[1, c] * v[c] + solution[2, c] - s[c]
        et = solution[3, c] * u[c] + solution[4, c] * v[c] + solution[5, c] - t[c]
        e[c] = np.sqrt(es * es + et * et)


@helper
def _median(values: Float32s, weights: Float32s, high: Float32s, low: Float32s, balance: Float32s) -> None:
    """Write to `high` the weighted median of each column of values (approximately), at least 1; low, balance: scratch.

    Bisection takes the same steps in every column, so that it is vectorised; sorting would not be.
    """
    k, n = values.shape
    for c in range(n):
        low[c] = 1
        high[c] = np.float32(_LARGEST_SPREAD_PX)
    for _ in range(_HALVINGS):
        # balance: weight of the values below the middle minus that of the others
        for c in range(n):
            balance[c] = 0
        for a in range(k):
            for c in range(n):
                # value <= sqrt(low high), without the root
                is_below = values[a, c] * values[a, c] <= low[c] * high[c]
                balance[c] += weights[a, c] if is_below else -weights[a, c]
        for c in range(n):
            middle = np.sqrt(low[c] * high[c])
            # both are written always: a branch would keep the loop from being vectorised
            mostly_below = balance[c] >= np.float32(0)
            high[c], low[c] = middle if mostly_below else high[c], low[c] if mostly_below else middle


@helper
def _reweigh(w0: Float32s, e: Float32s, spread: Float32s, w: Float32s) -> None:
    """Write one neighbour's weights: w0 times Geman-McClure's 1 / (1 + (e / 2 spread)^2)^2."""
    for c in range(len(w0)):
        r = e[c] / (spread[c] + spread[c])
        r = np.float32(1) + r * r
        w[c] = w0[c] / (r * r)


@helper
def _add_agreeing(w0: Float32s, e: Float32s, spread: Float32s, agreeing: Float32s) -> None:
    """Add one neighbour's weight where its residual is below three spreads, or 6 px where the spread is small."""
    for c in range(len(w0)):
        agreeing[c] += w0[c] if e[c] < np.float32(3) * max(spread[c], np.float32(2)) else np.float32(0)

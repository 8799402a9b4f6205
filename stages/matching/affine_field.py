"""A local affine map at every keypoint, from the confident matches around it.

Each query point fits `x2 = y + A (x1 - query)` to its nearest matches by iteratively reweighted least squares (Geman-McClure),
with a ridge that draws A toward the mean of what the matched keypoints' own frames say.  A match that lies on the query itself is
left out, so that the map is always the opinion of the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..kernels import kernel
from ..types import Float64s, Int32s, Int64s
from .nearest_points import nearest_points

_WIDTH_RANK = 8
"""The distance of this neighbour (0 is the nearest) is the width of the weights."""


@dataclass(frozen=True)
class AffineField:
    """For each of m queries: prediction (m, 2), pixels in image 2; affine (m, 2, 2); sigma_px (m,), weighted median residual of
    the neighbours, at least 1; support (m,), summed weight of the neighbours that agree."""

    prediction: Float64s
    affine: Float64s
    sigma_px: Float64s
    support: Float64s


def fit_affine_field(
    x1: Float64s, x2: Float64s, affine: Float64s, weight: Float64s, queries: Float64s, neighbours: int = 32, ridge: float = 2.0
) -> AffineField:
    """Fit the field to matches x1, x2 (n, 2) with frame affines (n, 2, 2) and weights (n,) in 0..1, at queries (m, 2); n >= 2.

    neighbours: matches that a query asks; ridge: pull toward the mean of the frame affines, no unit.
    """
    distance, index = nearest_points(x1, queries, min(neighbours, len(x1) - 1) + 1)
    m = len(queries)
    field = AffineField(np.empty((m, 2)), np.empty((m, 2, 2)), np.empty(m), np.empty(m))
    _fit(
        queries, distance, index, x1, x2, affine, weight, ridge,
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
    prediction: Float64s,
    out: Float64s,
    sigma: Float64s,
    support: Float64s,
) -> None:
    k = distance.shape[1]
    w0, w, e, u, v, s, t = np.empty(k), np.empty(k), np.empty(k), np.empty(k), np.empty(k), np.empty(k), np.empty(k)
    order = np.arange(k)
    for q in range(len(queries)):
        width = distance[q, min(k - 1, _WIDTH_RANK)] + 1.0
        scale = width + 5.0
        total = 1e-9
        ms, mt = 0.0, 0.0
        m00, m01, m10, m11 = 0.0, 0.0, 0.0, 0.0
        for a in range(k):
            j = index[q, a]
            d = distance[q, a]
            w0[a] = weight[j] / (1 + (d / width) ** 2) if d > 1e-6 else 0.0
            u[a], v[a] = (x1[j, 0] - queries[q, 0]) / scale, (x1[j, 1] - queries[q, 1]) / scale
            s[a], t[a] = x2[j, 0], x2[j, 1]
            total += w0[a]
            ms += w0[a] * s[a]
            mt += w0[a] * t[a]
            m00 += w0[a] * affine[j, 0, 0]
            m01 += w0[a] * affine[j, 0, 1]
            m10 += w0[a] * affine[j, 1, 0]
            m11 += w0[a] * affine[j, 1, 1]
        ms, mt = ms / total, mt / total
        pull = 0.02 * ridge * total
        p00, p01, p10, p11 = m00 / total * scale, m01 / total * scale, m10 / total * scale, m11 / total * scale
        w[:] = w0
        a00, a01, a10, a11, cs, ct, spread = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
        for _ in range(4):
            suu, suv, svv, su, sv, sw = pull + 1e-6, 0.0, pull + 1e-6, 0.0, 0.0, 1e-6
            bus, bvs, bs, but, bvt, bt = pull * p00, pull * p01, 0.0, pull * p10, pull * p11, 0.0
            for a in range(k):
                wu, wv = w[a] * u[a], w[a] * v[a]
                suu += wu * u[a]
                suv += wu * v[a]
                svv += wv * v[a]
                su += wu
                sv += wv
                sw += w[a]
                ds, dt = s[a] - ms, t[a] - mt
                bus += wu * ds
                bvs += wv * ds
                bs += w[a] * ds
                but += wu * dt
                bvt += wv * dt
                bt += w[a] * dt
            c00, c01, c02 = svv * sw - sv * sv, sv * su - suv * sw, suv * sv - svv * su
            c11, c12, c22 = suu * sw - su * su, suv * su - suu * sv, suu * svv - suv * suv
            det = suu * c00 + suv * c01 + su * c02
            a00 = (c00 * bus + c01 * bvs + c02 * bs) / det
            a01 = (c01 * bus + c11 * bvs + c12 * bs) / det
            cs = (c02 * bus + c12 * bvs + c22 * bs) / det
            a10 = (c00 * but + c01 * bvt + c02 * bt) / det
            a11 = (c01 * but + c11 * bvt + c12 * bt) / det
            ct = (c02 * but + c12 * bvt + c22 * bt) / det
            for a in range(k):
                es, et = a00 * u[a] + a01 * v[a] + cs + ms - s[a], a10 * u[a] + a11 * v[a] + ct + mt - t[a]
                e[a] = np.sqrt(es * es + et * et)
            spread = max(_weighted_median(e, w0, order), 1.0)
            for a in range(k):
                w[a] = w0[a] / (1 + (e[a] / (2 * spread)) ** 2) ** 2
        agree = 0.0
        for a in range(k):
            if e[a] < 3 * max(spread, 2.0):
                agree += w0[a]
        prediction[q, 0], prediction[q, 1] = ms + cs, mt + ct
        out[q, 0, 0], out[q, 0, 1], out[q, 1, 0], out[q, 1, 1] = a00 / scale, a01 / scale, a10 / scale, a11 / scale
        sigma[q], support[q] = spread, agree


@kernel
def _weighted_median(values: Float64s, weights: Float64s, order: Int64s) -> float:
    """The smallest value with half the weight at or below it; `order` is room to sort in."""
    k = len(values)
    total = 0.0
    for a in range(k):
        total += weights[a]
        mine, at = order[a], a
        while at > 0 and values[order[at - 1]] > values[mine]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = mine
    below = 0.0
    for a in range(k):
        below += weights[order[a]]
        if below >= 0.5 * total:
            return float(values[order[a]])
    return float(values[order[k - 1]])

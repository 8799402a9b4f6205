"""Plane sweeps of one view against all views around it: the kernels of `refine`.

A pixel's surface is a plane in inverse depth, q + A dx + B dy for its neighbours at (dx, dy): a plane in space is exactly
linear in inverse depth.  The pixel is seen by source s at the homogeneous position M_s p + b_s q, linear in q, so that a small
patch maps affinely with derivatives at hand.  A plane's cost is the lowest 1 - ZNCC over the sources: one view that sees the
surface unhidden and alike is proof; the mean over several would punish surfaces that others don't see.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..kernels import kernel
from ..types import Bools, Float32s, Float64s, Int32s, Uint8s

Int64s = npt.NDArray[np.int64]

UNSEEN = 2.0
"""The cost where no source sees a plane; costs of planes that are seen lie between 0 and 1."""

_FLAT = 0.05  # grey levels squared: patches with less contrast show nothing


@kernel
def _reference(
    image: Float32s, x: int, y: int, taps: Int32s, softness: float, values: Float32s, weights: Float32s
) -> tuple[float, float, float]:
    """Fill a patch's grey values (less the centre's) and weights, which fall as 1 / (1 + (dI / softness)^2); return the weights'
    sum, the weighted mean and variance."""
    h, w = image.shape
    centre = image[y, x]
    total, mean, square = 0.0, 0.0, 0.0
    for k in range(len(taps)):
        i, j = x + taps[k, 0], y + taps[k, 1]
        if 0 <= i < w and 0 <= j < h:
            d = image[j, i] - centre
            r = d / softness
            weight = 1.0 / (1.0 + r * r)
            values[k] = d
            weights[k] = weight
            total += weight
            mean += weight * d
            square += weight * d * d
        else:
            values[k] = 0.0
            weights[k] = 0.0
    mean /= total
    return total, mean, square / total - mean * mean


@kernel
def _dissimilarity(
    source: Float32s,
    M: Float64s,
    b: Float64s,
    x: int,
    y: int,
    q: float,
    A: float,
    B: float,
    reach: int,
    taps: Int32s,
    values: Float32s,
    weights: Float32s,
    total: float,
    mean: float,
    variance: float,
) -> float:
    """1 - ZNCC of a plane's patch in one source, 0 to 1; UNSEEN where the patch leaves the image or lies behind the camera."""
    W = M[2, 0] * x + M[2, 1] * y + M[2, 2] + b[2] * q
    if not W > 1e-9:
        return UNSEEN
    u = (M[0, 0] * x + M[0, 1] * y + M[0, 2] + b[0] * q) / W
    v = (M[1, 0] * x + M[1, 1] * y + M[1, 2] + b[1] * q) / W
    wx, wy = M[2, 0] + b[2] * A, M[2, 1] + b[2] * B
    ux, uy = (M[0, 0] + b[0] * A - u * wx) / W, (M[0, 1] + b[0] * B - u * wy) / W
    vx, vy = (M[1, 0] + b[1] * A - v * wx) / W, (M[1, 1] + b[1] * B - v * wy) / W
    du, dv = reach * (abs(ux) + abs(uy)), reach * (abs(vx) + abs(vy))
    h, w = source.shape
    if not (u >= du and v >= dv and u + du < w - 1.001 and v + dv < h - 1.001):
        return UNSEEN
    sum_r, sum_rr, sum_lr = 0.0, 0.0, 0.0
    for k in range(len(taps)):
        s = u + ux * taps[k, 0] + uy * taps[k, 1]
        t = v + vx * taps[k, 0] + vy * taps[k, 1]
        i, j = int(s), int(t)
        f, g = s - i, t - j
        top = source[j, i] + f * (source[j, i + 1] - source[j, i])
        low = source[j + 1, i] + f * (source[j + 1, i + 1] - source[j + 1, i])
        r = top + g * (low - top)
        wr = weights[k] * r
        sum_r += wr
        sum_rr += wr * r
        sum_lr += wr * values[k]
    mean_r = sum_r / total
    variance_r = sum_rr / total - mean_r * mean_r
    if variance < _FLAT or variance_r < _FLAT:
        return 0.95
    zncc = (sum_lr / total - mean * mean_r) / np.sqrt(variance * variance_r)
    return float(min(1.0, max(0.0, 1.0 - zncc)))


@kernel
def _pixels_per_inverse_depth(sources: Float32s, M: Float64s, b: Float64s, x: int, y: int, q: float) -> float:
    """How far a pixel moves per unit of q in the source where it moves most; 0 where none sees it."""
    h, w = sources.shape[1:]
    most = 0.0
    for s in range(len(sources)):
        W = M[s, 2, 0] * x + M[s, 2, 1] * y + M[s, 2, 2] + b[s, 2] * q
        if W > 1e-9:
            u = (M[s, 0, 0] * x + M[s, 0, 1] * y + M[s, 0, 2] + b[s, 0] * q) / W
            v = (M[s, 1, 0] * x + M[s, 1, 1] * y + M[s, 1, 2] + b[s, 1] * q) / W
            if 0 <= u <= w - 1 and 0 <= v <= h - 1:
                most = max(most, np.hypot(b[s, 0] - u * b[s, 2], b[s, 1] - v * b[s, 2]) / W)
    return most


@kernel
def sweep_planes(
    image: Float32s,
    usable: Bools,
    sources: Float32s,
    M: Float64s,
    b: Float64s,
    taps: Int32s,
    softness: float,
    sweeps: int,
    far: int,
    q_low: float,
    q_high: float,
    seed: int,
    q: Float64s,
    A: Float64s,
    B: Float64s,
    cost: Float32s,
    best: Uint8s,
) -> None:
    """Improve planes in place: propagation from neighbours, holes (nan) included, and shrinking random changes.

    image (h, w), sources (s, h', w') grey; M (s, 3, 3), b (s, 3): see the module; q, A, B (h, w): the planes; cost (h, w), best
    (h, w) the source that gives it; far: distance of the second ring of neighbours, pixels.  A candidate is tried on the source
    that is best here, the one best where it comes from, and one more in turn: of six sources half are enough.
    """
    h, w = image.shape
    count, reach = len(sources), 0
    for k in range(len(taps)):
        reach = max(reach, abs(taps[k, 0]), abs(taps[k, 1]))
    values, weights = np.empty(len(taps), np.float32), np.empty(len(taps), np.float32)
    state = np.uint64(seed * 2654435761 + 88172645463325252)
    for y in range(h):
        for x in range(w):
            cost[y, x] = UNSEEN
            if usable[y, x] and not np.isnan(q[y, x]):
                total, mean, variance = _reference(image, x, y, taps, softness, values, weights)
                for s in range(count):
                    c = _dissimilarity(
                        sources[s], M[s], b[s], x, y, q[y, x], A[y, x], B[y, x], reach, taps, values, weights, total, mean,
                        variance,
                    )  # fmt: skip
                    if c < cost[y, x]:
                        cost[y, x] = c
                        best[y, x] = s
    for sweep in range(sweeps):
        step = 1 if sweep % 2 == 0 else -1
        for y0 in range(h):
            y = y0 if step == 1 else h - 1 - y0
            for x0 in range(w):
                x = x0 if step == 1 else w - 1 - x0
                if not usable[y, x]:
                    continue
                total, mean, variance = _reference(image, x, y, taps, softness, values, weights)
                if variance < _FLAT:
                    continue
                scale = 0.0
                for trial in range(7):
                    origin = best[y, x]
                    if trial < 4:
                        ring = step if trial < 2 else far * step
                        dx, dy = (-ring, 0) if trial % 2 == 0 else (0, -ring)
                        i, j = x + dx, y + dy
                        if not (0 <= i < w and 0 <= j < h) or np.isnan(q[j, i]) or cost[j, i] > 0.9:
                            continue
                        a_new, b_new = A[j, i], B[j, i]
                        q_new = q[j, i] - a_new * dx - b_new * dy
                        origin = best[j, i]
                    else:
                        if np.isnan(q[y, x]):
                            break
                        if trial == 4:
                            scale = _pixels_per_inverse_depth(sources, M, b, x, y, q[y, x])
                            if scale == 0.0:
                                break
                        size = 0.5 / (scale * (1 << sweep))  # half a pixel first; the depth change halves from trial to trial
                        tilt = 0.1 / (scale * (1 << sweep)) if trial > 4 else 0.0
                        draws = np.zeros(3)
                        for n in range(3):
                            state ^= state << np.uint64(13)
                            state ^= state >> np.uint64(7)
                            state ^= state << np.uint64(17)
                            draws[n] = np.float64(state >> np.uint64(11)) / 4503599627370496.0 - 1.0
                        q_new = q[y, x] + draws[0] * size / (1 << (trial - 4))
                        a_new, b_new = A[y, x] + draws[1] * tilt, B[y, x] + draws[2] * tilt
                    if not q_low < q_new < q_high:
                        continue
                    other = (x + y + sweep + trial) % count
                    for turn in range(3):
                        s = best[y, x] if turn == 0 else origin if turn == 1 else other
                        if (turn == 1 and s == best[y, x]) or (turn == 2 and (s == best[y, x] or s == origin)):
                            continue
                        c = _dissimilarity(
                            sources[s], M[s], b[s], x, y, q_new, a_new, b_new, reach, taps, values, weights, total, mean, variance
                        )
                        if c < cost[y, x]:
                            cost[y, x] = c
                            best[y, x] = s
                            q[y, x], A[y, x], B[y, x] = q_new, a_new, b_new


@kernel
def judge_planes(
    image: Float32s,
    sources: Float32s,
    M: Float64s,
    b: Float64s,
    taps: Int32s,
    softness: float,
    limit: float,
    q: Float64s,
    A: Float64s,
    B: Float64s,
    support: npt.NDArray[np.uint32],
    parallax: Float32s,
    first: Float32s,
    second: Float32s,
) -> None:
    """What all sources say of the final planes, (h, w) each: the lowest two costs; bits of the sources below `limit`; and the sum
    of |dpixel/dq|^2 over these, the information on q per squared pixel of noise."""
    h, w = image.shape
    reach = 0
    for k in range(len(taps)):
        reach = max(reach, abs(taps[k, 0]), abs(taps[k, 1]))
    values, weights = np.empty(len(taps), np.float32), np.empty(len(taps), np.float32)
    for y in range(h):
        for x in range(w):
            first[y, x] = second[y, x] = UNSEEN
            if np.isnan(q[y, x]):
                continue
            total, mean, variance = _reference(image, x, y, taps, softness, values, weights)
            for s in range(len(sources)):
                c = _dissimilarity(
                    sources[s], M[s], b[s], x, y, q[y, x], A[y, x], B[y, x], reach, taps, values, weights, total, mean, variance
                )
                if c < first[y, x]:
                    second[y, x] = first[y, x]
                    first[y, x] = c
                elif c < second[y, x]:
                    second[y, x] = c
                if c < limit:
                    W = M[s, 2, 0] * x + M[s, 2, 1] * y + M[s, 2, 2] + b[s, 2] * q[y, x]
                    u = (M[s, 0, 0] * x + M[s, 0, 1] * y + M[s, 0, 2] + b[s, 0] * q[y, x]) / W
                    v = (M[s, 1, 0] * x + M[s, 1, 1] * y + M[s, 1, 2] + b[s, 1] * q[y, x]) / W
                    support[y, x] |= np.uint32(1) << np.uint32(s)
                    parallax[y, x] += ((b[s, 0] - u * b[s, 2]) ** 2 + (b[s, 1] - v * b[s, 2]) ** 2) / (W * W)

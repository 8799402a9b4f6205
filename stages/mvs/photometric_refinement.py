"""Depth to fractions of a pixel: each plane is moved to the best fit of all sources together.

`mvs.kernels` finds planes by the one source that shows them best, on every second pixel of a patch: right to within a pixel, but
the cheapest only by chance within it.  From there a Gauss-Newton step uses the gradients of all correlations at once,
on every pixel of a patch whose centre has the largest weight.  With a the patch here and b its projection in a source, both with
zero mean and unit length, 1 - ab is half of |a - b|^2: a least-squares problem in the inverse depth q, in which one source adds

    gradient = -a db/dq,    curvature = |db/dq|^2,    db/dq = (r - mean - b (b r)) / |patch|,    r = dI/dq.

The better a source fits, the larger its weight: the variance of its differences is twice its cost.

References: Lucas, Kanade, An iterative image registration technique, IJCAI 1981; Furukawa, Ponce, Accurate, Dense, and Robust
Multiview Stereopsis, PAMI 2010 (a patch's depth improved on all views' correlations).
"""

from __future__ import annotations

import numpy as np

from ..core.jit import Scalar, helper, kernel
from ..types import Float32s, Int32s, Uint64s

_SOFTNESS = 12.0
"""Difference from the centre, in grey levels, at which a patch's pixel has half weight."""
_FLAT = 0.05
"""Smallest variance of a patch that counts, grey levels squared."""
_FLOOR = 0.02
"""Added to the cost of a source in its weight: no source is better than the noise of grey levels."""
_PRIOR_CURVATURE = 0.1
"""Prior that holds the plane in place, as a curvature: squared share of a patch's contrast per squared pixel of movement."""
_NEAREST = 1e-6
_BLOCK = 128
"""Pixels of a row that are processed together."""

# Scratch is a flat array of rows of _BLOCK at offsets known to the compiler.
_Q, _A, _B, _U, _V, _UX, _UY, _VX, _VY, _DU, _DV, _SEEN, _PLACE, _FX, _FY, _CENTRE, _ROWS = (i * _BLOCK for i in range(17))
_R, _RR, _DR, _E, _EE, _RE, _DE, _SUMS = (i * _BLOCK for i in range(8))
_W, _D, _DD, _WEIGHTS = (i * _BLOCK for i in range(4))
_GRADIENT, _CURVATURE, _MOVED, _TOTALS = (i * _BLOCK for i in range(4))


@helper
def _window(
    image: Float32s, usable: Float32s, taps: Int32s, tap_weights: Float32s, reach: int, y: int, x0: int, n: int, window: Float32s
) -> None:
    """The patches of `n` pixels from (x0, y) on: sums of weights, of weighted differences from the centre, and of their weighted
    squares; then each tap's weights, and its differences."""
    soft, count = np.float32(1.0 / _SOFTNESS), len(taps)
    window[:_WEIGHTS] = np.float32(0.0)
    centre = image[y + reach, x0 + reach :]
    for t in range(count):
        j, i = y + reach + taps[t, 1], x0 + reach + taps[t, 0]
        grey, use, share = image[j, i:], usable[j, i:], tap_weights[t]
        weights, values = window[_WEIGHTS + t * _BLOCK :], window[_WEIGHTS + (count + t) * _BLOCK :]
        for x in range(n):
            d = grey[x] - centre[x]
            w = share * use[x] / (np.float32(1.0) + d * soft * d * soft)
            weights[x] = w
            values[x] = d
            window[_W + x] += w
            window[_D + x] += w * d
            window[_DD + x] += w * d * d


@helper
def _project(height: int, width: int, M: Float32s, b: Float32s, k: int, reach: Scalar, y: int, x0: int, s: Float32s) -> None:
    """Project the planes into source k: position, its derivatives in x, y and q, and whether the source sees the whole patch."""
    row, zero, last_column, last_row = np.float32(y), np.float32(0.0), np.float32(width - 1.001), np.float32(height - 1.001)
    m00, m10, m20 = M[k, 0, 0], M[k, 1, 0], M[k, 2, 0]
    m01, m11, m21 = M[k, 0, 1], M[k, 1, 1], M[k, 2, 1]
    c0, c1, c2 = m01 * row + M[k, 0, 2], m11 * row + M[k, 1, 2], m21 * row + M[k, 2, 2]
    b0, b1, b2 = b[k, 0], b[k, 1], b[k, 2]
    for x in range(_BLOCK):
        column = np.float32(np.int32(x0) + np.int32(x))
        q, A, B = s[_Q + x], s[_A + x], s[_B + x]
        W = m20 * column + c2 + b2 * q
        inverse = np.float32(1.0) / max(W, np.float32(_NEAREST))
        u, v = (m00 * column + c0 + b0 * q) * inverse, (m10 * column + c1 + b1 * q) * inverse
        wx, wy = m20 + b2 * A, m21 + b2 * B
        ux, uy = (m00 + b0 * A - u * wx) * inverse, (m01 + b0 * B - u * wy) * inverse
        vx, vy = (m10 + b1 * A - v * wx) * inverse, (m11 + b1 * B - v * wy) * inverse
        s[_U + x], s[_V + x] = u, v
        s[_UX + x], s[_UY + x], s[_VX + x], s[_VY + x] = ux, uy, vx, vy
        s[_DU + x], s[_DV + x] = (b0 - u * b2) * inverse, (b1 - v * b2) * inverse
        du, dv = reach * (abs(ux) + abs(uy)), reach * (abs(vx) + abs(vy))
        inside = (u >= du) & (v >= dv) & (u + du < last_column) & (v + dv < last_row) & (np.float32(_NEAREST) < W) & (q > zero)
        s[_SEEN + x] = np.float32(1.0) if inside else zero


@helper
def _compare(
    pairs: Uint64s, height: int, width: int, k: int, taps: Int32s, window: Float32s, s: Float32s, fetched: Uint64s, sums: Float32s
) -> None:
    """Weighted sums over the patches' projections in source k: r, the grey level there less the centre's, its square, its product
    with the patch here; and e, the grey level's derivative in q, its square and its products with r and with the patch here."""
    ints, uints, greys = s.view(np.int32), s.view(np.uint32), fetched.view(np.float32)
    count, stride, start = len(taps), np.int32(width), np.int32(k * height * width)
    zero, last_column, last_row = np.float32(0.0), np.float32(width - 2), np.float32(height - 2)
    sums[:] = zero
    for t in range(count):
        dx, dy = np.float32(taps[t, 0]), np.float32(taps[t, 1])
        for x in range(_BLOCK):
            at_x = s[_U + x] + dx * s[_UX + x] + dy * s[_UY + x]
            at_y = s[_V + x] + dx * s[_VX + x] + dy * s[_VY + x]
            at_x, at_y = at_x if at_x > zero else zero, at_y if at_y > zero else zero  # nan, too: nothing outside is ever read
            at_x, at_y = min(at_x, last_column), min(at_y, last_row)
            i, j = np.int32(at_x), np.int32(at_y)
            s[_FX + x], s[_FY + x] = at_x - np.float32(i), at_y - np.float32(j)
            ints[_PLACE + x] = start + j * stride + i
        for x in range(_BLOCK):
            fetched[x] = pairs[uints[_PLACE + x]]
        for x in range(_BLOCK):
            fetched[_BLOCK + x] = pairs[uints[_PLACE + x] + np.uint32(stride)]
        weights, values = window[_WEIGHTS + t * _BLOCK :], window[_WEIGHTS + (count + t) * _BLOCK :]
        for x in range(_BLOCK):
            fx, fy = s[_FX + x], s[_FY + x]
            top, bottom = greys[2 * x], greys[2 * _BLOCK + 2 * x]
            across_top, across_bottom = greys[2 * x + 1] - top, greys[2 * _BLOCK + 2 * x + 1] - bottom
            top += fx * across_top
            down = bottom + fx * across_bottom - top
            s[_FX + x] = top + fy * down
            s[_FY + x] = (across_top + fy * (across_bottom - across_top)) * s[_DU + x] + down * s[_DV + x]
        if t == 0:  # sums use differences from the centre, so that rounding does not hide weak contrast
            for x in range(_BLOCK):
                s[_CENTRE + x] = s[_FX + x]
        for x in range(_BLOCK):
            r, e, w, d = s[_FX + x] - s[_CENTRE + x], s[_FY + x], weights[x], values[x]
            wr, we = w * r, w * e
            sums[_R + x] += wr
            sums[_RR + x] += wr * r
            sums[_DR + x] += wr * d
            sums[_E + x] += we
            sums[_EE + x] += we * e
            sums[_RE + x] += wr * e
            sums[_DE + x] += we * d


@helper
def _add_source(window: Float32s, s: Float32s, sums: Float32s, totals: Float32s) -> None:
    """Add the contributions of a source, by its weight: gradient, curvature and (pixels per unit of q)^2."""
    zero, one, flat = np.float32(0.0), np.float32(1.0), np.float32(_FLAT)
    for x in range(_BLOCK):
        share = one / max(window[_W + x], np.float32(1e-6))
        d, r, e = share * window[_D + x], share * sums[_R + x], share * sums[_E + x]
        variance, source_variance = share * window[_DD + x] - d * d, share * sums[_RR + x] - r * r
        inverse = one / max(source_variance, flat)
        scale = np.sqrt(inverse / max(variance, flat))
        correlation = (share * sums[_DR + x] - d * r) * scale
        projection = (share * sums[_RE + x] - r * e) * inverse
        gradient = (share * sums[_DE + x] - d * e) * scale - correlation * projection
        curvature = (share * sums[_EE + x] - e * e) * inverse - projection * projection
        cost = max(one - correlation, zero)
        is_usable = (s[_SEEN + x] > zero) & (variance > flat) & (source_variance > flat)
        weight = one / (cost + np.float32(_FLOOR)) if is_usable else zero
        totals[_GRADIENT + x] += weight * gradient
        totals[_CURVATURE + x] += weight * curvature
        totals[_MOVED + x] += weight * (s[_DU + x] * s[_DU + x] + s[_DV + x] * s[_DV + x])


@kernel
def refine_photometrically(
    image: Float32s, usable: Float32s, pairs: Uint64s, height: int, width: int, M: Float32s, b: Float32s, taps: Int32s,
    reach: int, tap_weights: Float32s, planes: Float32s,
) -> None:  # fmt: skip
    """Move planes in place.  `tap_weights` (n,): weights of a patch's pixels by their distance from its centre; all else as in
    `mvs.kernels.View`."""
    h, w = planes.shape[1:]
    zero, radius = np.float32(0.0), np.float32(np.abs(taps).max())
    window = np.zeros(_WEIGHTS + 2 * len(taps) * _BLOCK, dtype=np.float32)
    s, sums, totals = np.zeros(_ROWS, dtype=np.float32), np.zeros(_SUMS, dtype=np.float32), np.zeros(_TOTALS, dtype=np.float32)
    fetched = np.zeros(2 * _BLOCK, dtype=np.uint64)
    for y in range(h):
        for x0 in range(0, w, _BLOCK):
            n = min(_BLOCK, w - x0)
            q, plane_a, plane_b = planes[0, y, x0:], planes[1, y, x0:], planes[2, y, x0:]
            s[:] = zero
            plane_count = 0
            for x in range(n):
                has_plane = q[x] > zero
                plane_count += has_plane
                s[_Q + x], s[_A + x], s[_B + x] = (q[x], plane_a[x], plane_b[x]) if has_plane else (zero, zero, zero)
            if plane_count == 0:
                continue
            _window(image, usable, taps, tap_weights, reach, y, x0, n, window)
            totals[:] = zero
            for k in range(len(M)):
                _project(height, width, M, b, k, radius, y, x0, s)
                _compare(pairs, height, width, k, taps, window, s, fetched, sums)
                _add_source(window, s, sums, totals)
            for x in range(n):  # one Gauss-Newton step, damped by the prior
                curvature = totals[_CURVATURE + x] + np.float32(_PRIOR_CURVATURE) * totals[_MOVED + x]
                moved = s[_Q + x] + totals[_GRADIENT + x] / max(curvature, np.float32(1e-12))
                q[x] = moved if q[x] > zero else q[x]

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
"""Difference from the centre, in grey levels, at which a patch's pixel has half weight: larger, and patches blur over edges."""

_FLAT = 0.05
"""Smallest variance of a patch that counts, grey levels squared: below it there is nothing to fit but rounding."""

_FLOOR = 0.02
"""Added to the cost of a source in its weight: no source is better than the noise of grey levels."""

_PRIOR_CURVATURE = 0.1
"""Prior that holds the plane in place, as a curvature: squared share of a patch's contrast per squared pixel of movement.  Larger
values keep planes of little contrast closer to where they are."""

_NEAREST = 1e-6
"""Smallest depth in a source, in units of the homogeneous coordinate; a point that is nearer, or behind, is not seen."""

_BLOCK = 128
"""Pixels of a row that are processed together."""

# The kernels write into flat scratch arrays, in rows of _BLOCK at offsets that the compiler knows: it then sees that rows do not
# overlap, and vectorises.  There is one array of scratch for each purpose below; the last constant of each is its length.

# Scratch `s`: the planes, and their projection in one source.
_Q = 0 * _BLOCK
"""The plane's inverse depth."""
_A = 1 * _BLOCK
"""Its slope along x, inverse depth per pixel."""
_B = 2 * _BLOCK
"""Its slope along y."""
_U = 3 * _BLOCK
"""Column in the source."""
_V = 4 * _BLOCK
"""Row in the source."""
_UX = 5 * _BLOCK
"""Derivatives of the position in x and y, the view's pixels: du/dx, du/dy, dv/dx, dv/dy."""
_UY = 6 * _BLOCK
_VX = 7 * _BLOCK
_VY = 8 * _BLOCK
_DU = 9 * _BLOCK
"""Derivatives of the position in q: du/dq, dv/dq."""
_DV = 10 * _BLOCK
_SEEN = 11 * _BLOCK
"""1 where the source sees the whole patch, else 0."""
_PLACE = 12 * _BLOCK
"""Index of the source's pixel, an int32 in the bits of a float32."""
_FX = 13 * _BLOCK
"""Fractional position within that pixel; later the grey level there (_FX), and its derivative in q (_FY)."""
_FY = 14 * _BLOCK
_CENTRE = 15 * _BLOCK
"""Grey level of the source at the patch's centre."""
_ROWS = 16 * _BLOCK

# Scratch `sums`: weighted sums over a patch; r: grey level in the source, d: in the view, e: derivative of r in q.
_R = 0 * _BLOCK
_RR = 1 * _BLOCK
_DR = 2 * _BLOCK
_E = 3 * _BLOCK
_EE = 4 * _BLOCK
_RE = 5 * _BLOCK
_DE = 6 * _BLOCK
_SUMS = 7 * _BLOCK

# Scratch `window`: sums of weights, of w d and of w d d over a patch; then, from _WEIGHTS on, a row of weights for each tap, and
# a row of differences d for each tap.
_W = 0 * _BLOCK
_D = 1 * _BLOCK
_DD = 2 * _BLOCK
_WEIGHTS = 3 * _BLOCK

# Scratch `totals`: sums over the sources.
_GRADIENT = 0 * _BLOCK
_CURVATURE = 1 * _BLOCK
_MOVED = 2 * _BLOCK
"""Squared pixels of movement in the sources per unit of q."""
_TOTALS = 3 * _BLOCK


@kernel
def refine_photometrically(
    image: Float32s,
    usable: Float32s,
    pairs: Uint64s,
    height: int,
    width: int,
    M: Float32s,
    b: Float32s,
    taps: Int32s,
    reach: int,
    tap_weights: Float32s,
    planes: Float32s,
) -> None:
    """Move planes in place, by one damped Gauss-Newton step in their inverse depth.

    Parameters
    ----------
    image, usable, pairs, height, width, M, b, taps, reach : the view and its sources, as in `mvs.kernels.View`.
    tap_weights : (n,) weights of a patch's pixels by their distance from its centre.
    planes : (3, h, w) q, A, B; q is changed, and nan stays nan.
    """
    h, w = planes.shape[1:]
    zero = np.float32(0.0)
    radius = np.float32(np.abs(taps).max())
    window = np.zeros(_WEIGHTS + 2 * len(taps) * _BLOCK, dtype=np.float32)
    s = np.zeros(_ROWS, dtype=np.float32)
    sums = np.zeros(_SUMS, dtype=np.float32)
    totals = np.zeros(_TOTALS, dtype=np.float32)
    fetched = np.zeros(2 * _BLOCK, dtype=np.uint64)
    for y in range(h):
        for x0 in range(0, w, _BLOCK):
            n = min(_BLOCK, w - x0)

            # 1. Copy the block's planes to scratch; pixels without one get zeros, which no source sees.
            q = planes[0, y, x0:]
            plane_a = planes[1, y, x0:]
            plane_b = planes[2, y, x0:]
            s[:] = zero
            plane_count = 0
            for x in range(n):
                if q[x] > zero:  # never true where q is nan
                    plane_count += 1
                    s[_Q + x] = q[x]
                    s[_A + x] = plane_a[x]
                    s[_B + x] = plane_b[x]
            if plane_count == 0:
                continue

            # 2. Add up the normal equations over the sources.
            _window(image, usable, taps, tap_weights, reach, y, x0, n, window)
            totals[:] = zero
            for k in range(len(M)):
                _project(height, width, M, b, k, radius, y, x0, s)
                _compare(pairs, height, width, k, taps, window, s, fetched, sums)
                _add_source(window, s, sums, totals)

            # 3. One Gauss-Newton step, damped by the prior; a plane that would leave the space before the camera stays.
            for x in range(n):
                curvature = totals[_CURVATURE + x] + np.float32(_PRIOR_CURVATURE) * totals[_MOVED + x]
                moved = s[_Q + x] + totals[_GRADIENT + x] / max(curvature, np.float32(1e-12))
                q[x] = moved if q[x] > zero else q[x]


@helper
def _window(
    image: Float32s, usable: Float32s, taps: Int32s, tap_weights: Float32s, reach: int, y: int, x0: int, n: int, window: Float32s
) -> None:
    """The patches of `n` pixels from (x0, y) on: sums of weights, of weighted differences from the centre, and of their weighted
    squares; then each tap's weights, and its differences."""
    soft = np.float32(1.0 / _SOFTNESS)
    count = len(taps)
    window[:_WEIGHTS] = np.float32(0.0)
    centre = image[y + reach, x0 + reach :]
    for t in range(count):
        j = y + reach + taps[t, 1]
        i = x0 + reach + taps[t, 0]
        grey = image[j, i:]
        use = usable[j, i:]
        share = tap_weights[t]
        weights = window[_WEIGHTS + t * _BLOCK :]
        values = window[_WEIGHTS + (count + t) * _BLOCK :]
        for x in range(n):
            # bilateral weight: what differs from the centre is likely another surface
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
    row = np.float32(y)
    zero = np.float32(0.0)
    last_column = np.float32(width - 1.001)
    last_row = np.float32(height - 1.001)
    # M (x, y, 1) + b q, with what is constant along a row in c0, c1, c2
    m00, m10, m20 = M[k, 0, 0], M[k, 1, 0], M[k, 2, 0]
    m01, m11, m21 = M[k, 0, 1], M[k, 1, 1], M[k, 2, 1]
    b0, b1, b2 = b[k, 0], b[k, 1], b[k, 2]
    c0 = m01 * row + M[k, 0, 2]
    c1 = m11 * row + M[k, 1, 2]
    c2 = m21 * row + M[k, 2, 2]
    for x in range(_BLOCK):
        column = np.float32(np.int32(x0) + np.int32(x))
        q = s[_Q + x]
        A = s[_A + x]
        B = s[_B + x]
        W = m20 * column + c2 + b2 * q
        inverse = np.float32(1.0) / max(W, np.float32(_NEAREST))
        u = (m00 * column + c0 + b0 * q) * inverse
        v = (m10 * column + c1 + b1 * q) * inverse
        # quotient rule; q itself changes by A and B per pixel
        wx = m20 + b2 * A
        wy = m21 + b2 * B
        ux = (m00 + b0 * A - u * wx) * inverse
        uy = (m01 + b0 * B - u * wy) * inverse
        vx = (m10 + b1 * A - v * wx) * inverse
        vy = (m11 + b1 * B - v * wy) * inverse
        s[_U + x] = u
        s[_V + x] = v
        s[_UX + x] = ux
        s[_UY + x] = uy
        s[_VX + x] = vx
        s[_VY + x] = vy
        s[_DU + x] = (b0 - u * b2) * inverse
        s[_DV + x] = (b1 - v * b2) * inverse
        # half the width and height of the patch's bounding box in the source
        du = reach * (abs(ux) + abs(uy))
        dv = reach * (abs(vx) + abs(vy))
        inside = (u >= du) & (v >= dv) & (u + du < last_column) & (v + dv < last_row) & (np.float32(_NEAREST) < W) & (q > zero)
        s[_SEEN + x] = np.float32(1.0) if inside else zero


@helper
def _compare(
    pairs: Uint64s, height: int, width: int, k: int, taps: Int32s, window: Float32s, s: Float32s, fetched: Uint64s, sums: Float32s
) -> None:
    """Weighted sums over the patches' projections in source k: r, the grey level there less the centre's, its square, its product
    with the patch here; and e, the grey level's derivative in q, its square and its products with r and with the patch here."""
    ints = s.view(np.int32)
    uints = s.view(np.uint32)
    greys = fetched.view(np.float32)
    count = len(taps)
    stride = np.int32(width)
    start = np.int32(k * height * width)
    zero = np.float32(0.0)
    last_column = np.float32(width - 2)
    last_row = np.float32(height - 2)
    sums[:] = zero
    for t in range(count):
        # where the tap falls in the source: the patch maps affinely
        dx = np.float32(taps[t, 0])
        dy = np.float32(taps[t, 1])
        for x in range(_BLOCK):
            at_x = s[_U + x] + dx * s[_UX + x] + dy * s[_UY + x]
            at_y = s[_V + x] + dx * s[_VX + x] + dy * s[_VY + x]
            # nan becomes zero, too: nothing outside is ever read
            at_x = at_x if at_x > zero else zero
            at_y = at_y if at_y > zero else zero
            at_x = min(at_x, last_column)
            at_y = min(at_y, last_row)
            i = np.int32(at_x)
            j = np.int32(at_y)
            s[_FX + x] = at_x - np.float32(i)
            s[_FY + x] = at_y - np.float32(j)
            ints[_PLACE + x] = start + j * stride + i
        # each fetch gives two neighbours; in loops of their own, because gathers do not vectorise
        for x in range(_BLOCK):
            fetched[x] = pairs[uints[_PLACE + x]]
        for x in range(_BLOCK):
            fetched[_BLOCK + x] = pairs[uints[_PLACE + x] + np.uint32(stride)]
        # bilinear interpolation, and the derivative of the interpolated grey level in q
        for x in range(_BLOCK):
            fx = s[_FX + x]
            fy = s[_FY + x]
            top = greys[2 * x]
            bottom = greys[2 * _BLOCK + 2 * x]
            across_top = greys[2 * x + 1] - top
            across_bottom = greys[2 * _BLOCK + 2 * x + 1] - bottom
            top += fx * across_top
            down = bottom + fx * across_bottom - top
            s[_FX + x] = top + fy * down
            s[_FY + x] = (across_top + fy * (across_bottom - across_top)) * s[_DU + x] + down * s[_DV + x]
        if t == 0:  # sums use differences from the centre, so that rounding does not hide weak contrast
            for x in range(_BLOCK):
                s[_CENTRE + x] = s[_FX + x]
        weights = window[_WEIGHTS + t * _BLOCK :]
        values = window[_WEIGHTS + (count + t) * _BLOCK :]
        for x in range(_BLOCK):
            r = s[_FX + x] - s[_CENTRE + x]
            e = s[_FY + x]
            w = weights[x]
            d = values[x]
            wr = w * r
            we = w * e
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
    zero = np.float32(0.0)
    one = np.float32(1.0)
    flat = np.float32(_FLAT)
    for x in range(_BLOCK):
        # weighted means, variances and products of the patches; gradient and curvature are the module's formulas
        share = one / max(window[_W + x], np.float32(1e-6))
        d = share * window[_D + x]
        r = share * sums[_R + x]
        e = share * sums[_E + x]
        variance = share * window[_DD + x] - d * d
        source_variance = share * sums[_RR + x] - r * r
        inverse = one / max(source_variance, flat)
        scale = np.sqrt(inverse / max(variance, flat))
        correlation = (share * sums[_DR + x] - d * r) * scale
        projection = (share * sums[_RE + x] - r * e) * inverse
        gradient = (share * sums[_DE + x] - d * e) * scale - correlation * projection
        curvature = (share * sums[_EE + x] - e * e) * inverse - projection * projection
        # the variance of a source's differences is twice its cost, so its weight is the inverse
        cost = max(one - correlation, zero)
        is_usable = (s[_SEEN + x] > zero) & (variance > flat) & (source_variance > flat)
        weight = one / (cost + np.float32(_FLOOR)) if is_usable else zero
        totals[_GRADIENT + x] += weight * gradient
        totals[_CURVATURE + x] += weight * curvature
        totals[_MOVED + x] += weight * (s[_DU + x] * s[_DU + x] + s[_DV + x] * s[_DV + x])

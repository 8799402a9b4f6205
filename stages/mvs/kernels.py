"""The compiled loops of `mvs.propagation`: planes of one view are projected into its sources, scored, propagated and changed.

A pixel's surface is a plane in inverse depth, q + A dx + B dy for its neighbours at (dx, dy): a plane in space is exactly
linear in inverse depth.  Source s sees the pixel at the homogeneous position M_s p + b_s q, linear in q, so that a small patch
maps affinely, with derivatives in closed form.  A plane's cost is the lowest 1 - ZNCC over the sources: one source that sees the
surface unoccluded and similar is enough; a mean over several would penalise surfaces that are hidden from some.

Blocks of a row are processed at once, so that the compiler can vectorise over columns: a pixel reads finished rows, and its own
row in the state before each step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..core.jit import Scalar, helper, kernel
from ..types import Float32s, Int32s, Int64s, Uint32s, Uint64s

UNSEEN = 2.0
"""Cost of a plane that no source sees; costs of planes that are seen are between 0 and 1."""

_FLAT = 0.05
"""Variance below which a patch is flat, grey levels squared: its correlation would be that of rounding."""

_FLAT_COST = 0.95
"""Cost of a flat patch: a little less than that of no correlation, so that a plane that is seen beats none."""

_SOFTNESS = 12.0
"""Difference from the centre, in grey levels, at which a patch's pixel has half weight: larger, and patches blur over edges."""

NOISE = 65537
"""Length of the table of random numbers; a prime, so that steps of a block reach every entry."""

_NEAREST = 1e-6
"""Smallest depth in a source, in units of the homogeneous coordinate; a point that is nearer, or behind, is not seen."""

_FIRST_SHIFT_PX = 0.5
"""Largest random shift of the first pass, in pixels of a source; it halves with each change and each pass."""

_FIRST_TURN = 0.1
"""Largest random tilt of the first pass, in pixels of a source per pixel; it halves with each pass."""

BLOCK = 128
"""Pixels of a row that are processed together."""

# The kernels write into flat scratch arrays, in rows of BLOCK at offsets that the compiler knows: it then sees that rows do not
# overlap, and vectorises.  There is one array of scratch for each purpose below; the last constant of each is its length.

# Scratch `s`: the projection of the planes in one source each, and the sums of the comparison there.
_U = 0 * BLOCK
"""Column in the source."""
_V = 1 * BLOCK
"""Row in the source."""
_UX = 2 * BLOCK
"""Derivatives of the position in x and y, the view's pixels: du/dx, du/dy, dv/dx, dv/dy."""
_UY = 3 * BLOCK
_VX = 4 * BLOCK
_VY = 5 * BLOCK
_DEPTH = 6 * BLOCK
"""Homogeneous coordinate, positive before the source."""
_START = 7 * BLOCK
"""Index of the source's first pixel, an int32 in the bits of a float32; so is the next."""
_PLACE = 8 * BLOCK
"""Index of the source's pixel at a tap."""
_FX = 9 * BLOCK
"""Fractional position within that pixel; later the grey level there (_FX)."""
_FY = 10 * BLOCK
_CENTRE = 11 * BLOCK
"""Grey level of the source at the patch's centre."""
_MEAN = 12 * BLOCK
"""Weighted sums over the patch in the source: grey level, its square, its product with the patch in the view."""
_SQUARE = 13 * BLOCK
_PRODUCT = 14 * BLOCK
_SCALE = 15 * BLOCK
"""Pixels of movement per unit of q in the source where that is largest."""
_SCRATCH = 16 * BLOCK

# Scratch `trial`: planes to be tried; q = 0: none.
_Q = 0 * BLOCK
_A = 1 * BLOCK
_B = 2 * BLOCK
_TRIAL = 3 * BLOCK

# Scratch `window`: of a patch in the view its standard deviation, sum of weights, mean difference from the centre; then, from
# _TAPS on, a row of weights for each tap, and a row of weighted differences for each tap.
_SPREAD = 0 * BLOCK
_TOTAL = 1 * BLOCK
_OFFSET = 2 * BLOCK
_TAPS = 3 * BLOCK


class View(NamedTuple):
    """A view and its sources.  The innermost helpers take the arrays one by one, since tuples cost time in each call."""

    image: Float32s
    """(h + 2 reach, w + 2 reach) grey levels, with a margin."""
    usable: Float32s
    """Of the same shape, 1 where a pixel may be used."""
    pairs: Uint64s
    """Neighbouring grey levels of the sources, two in each number."""
    height: int
    width: int
    """Of a source."""
    M: Float32s
    b: Float32s
    """(sources, 3, 3) and (sources, 3), as above."""
    taps: Int32s
    """(n, 2) offsets x, y of a patch's pixels, none beyond `reach`."""
    reach: int


class Support(NamedTuple):
    """Evidence of all sources for a view's planes, (h, w) each."""

    first: Float32s
    """Lowest cost over the sources."""
    second: Float32s
    """Second lowest cost over the sources."""
    sources: Uint32s
    """Bit k is set where the cost in source k is below the limit."""
    parallax: Float32s
    """Sum of |dpixel/dq|^2 over these sources: the information on q for a noise of one pixel."""


@kernel
def propagate(
    view: View, noise: Float32s, number: int, rings: Int64s, changes: int, low: Scalar, high: Scalar, planes: Float32s,
    cost: Float32s, best: Int32s,
) -> None:  # fmt: skip
    """One pass over the image, in place: every pixel tries the planes of its neighbours, and random changes of its own.

    Parameters
    ----------
    view, number : the view and its sources; number of the pass, even ones go down, odd ones up.
    noise, changes : (NOISE + BLOCK,) random numbers from -1 to 1; number of random changes.
    rings : (n, 2) neighbours that planes come from: columns and rows back along the direction of the pass.
    low, high : limits of q.
    planes, cost, best : (3, h, w) q, A, B, nan for none; (h, w) their cost, and the source with that cost; changed in place.
    """
    h, w = cost.shape
    taps, reach = view.taps, view.reach
    window = np.zeros(_TAPS + 2 * len(taps) * BLOCK, dtype=np.float32)
    scratch = np.zeros(_SCRATCH, dtype=np.float32)
    fetched = np.zeros(2 * BLOCK, dtype=np.uint64)
    trial = np.zeros(_TRIAL, dtype=np.float32)
    trial_cost = np.zeros(BLOCK, dtype=np.float32)
    # the source of each pixel that a plane is tried in
    there = np.zeros(BLOCK, dtype=np.int32)
    here = np.zeros(BLOCK, dtype=np.int32)
    in_turn = np.zeros(BLOCK, dtype=np.int32)
    blocks = (w + BLOCK - 1) // BLOCK
    step = -1 if number % 2 == 0 else 1
    start = 0
    for i in range(h):
        y = i if step < 0 else h - 1 - i
        for j in range(blocks):
            x0 = (j if step < 0 else blocks - 1 - j) * BLOCK
            n = min(BLOCK, w - x0)
            if not view.usable[y + reach, x0 + reach : x0 + reach + n].any():
                continue
            _windows(view.image, view.usable, taps, reach, y, x0, n, window)
            # 1. In the first pass, score the planes that are there, in every source.
            if number == 0:
                _own_planes(planes, y, x0, n, trial)
                for k in range(len(view.M)):
                    in_turn[:] = k
                    _try(view, y, x0, n, trial, in_turn, window, scratch, fetched, trial_cost, planes, cost, best)
            # 2. Try the planes of neighbours that this pass has been at, in the source that is best here, the one that is best
            #    where the plane comes from, and one more in turn: half of six sources are enough.
            for attempt in range(len(rings)):
                dx = step * rings[attempt, 0]
                dy = step * rings[attempt, 1]
                if not 0 <= y + dy < h:
                    continue
                _planes_at(planes, best, y, x0, n, dx, dy, low, high, trial, there)
                _sources_here(best, y, x0, n, here)
                in_turn[:] = (y + number + attempt) % len(view.M)
                for source in (there, here, in_turn):
                    _try(view, y, x0, n, trial, source, window, scratch, fetched, trial_cost, planes, cost, best)
            # 3. Try random changes of the own plane: the first only shifts it, the later ones tilt it, too.
            _own_planes(planes, y, x0, n, trial)
            _pixels_per_inverse_depth(view.height, view.width, view.M, view.b, y, x0, trial, scratch)
            shift = np.float32(_FIRST_SHIFT_PX / (1 << number))
            turn = np.float32(0.0)
            for attempt in range(changes):
                _own_planes(planes, y, x0, n, trial)
                _perturb(noise, start, shift, turn, low, high, scratch, trial)
                start = (start + 3 * BLOCK) % NOISE
                _sources_here(best, y, x0, n, here)
                in_turn[:] = (y + number + attempt) % len(view.M)
                for source in (here, in_turn):
                    _try(view, y, x0, n, trial, source, window, scratch, fetched, trial_cost, planes, cost, best)
                shift *= np.float32(0.5)
                turn = np.float32(_FIRST_TURN / (1 << number))


@kernel
def evaluate(view: View, planes: Float32s, limit: Scalar, support: Support) -> None:
    """Write the evidence of all sources for planes (3, h, w); one sees a plane that costs less than `limit` in it."""
    image, usable, pairs, height, width, M, b, taps, reach = view
    first, second, sources, parallax = support
    h, w = first.shape
    window = np.zeros(_TAPS + 2 * len(taps) * BLOCK, dtype=np.float32)
    scratch = np.zeros(_SCRATCH, dtype=np.float32)
    fetched = np.zeros(2 * BLOCK, dtype=np.uint64)
    trial = np.zeros(_TRIAL, dtype=np.float32)
    cost = np.zeros(BLOCK, dtype=np.float32)
    source = np.zeros(BLOCK, dtype=np.int32)
    for y in range(h):
        for x0 in range(0, w, BLOCK):
            n = min(BLOCK, w - x0)
            _windows(image, usable, taps, reach, y, x0, n, window)
            _own_planes(planes, y, x0, n, trial)
            for k in range(len(M)):
                source[:] = k
                _costs(pairs, height, width, M, b, taps, reach, y, x0, trial, source, window, scratch, fetched, cost)
                b0, b1, b2 = b[k, 0], b[k, 1], b[k, 2]
                for x in range(n):
                    c = cost[x]
                    # the second lowest first: it needs the old lowest
                    second[y, x0 + x] = min(second[y, x0 + x], max(c, first[y, x0 + x]))
                    first[y, x0 + x] = min(first[y, x0 + x], c)
                    if c < limit:
                        W = scratch[_DEPTH + x]
                        moved_x = (b0 - scratch[_U + x] * b2) / W
                        moved_y = (b1 - scratch[_V + x] * b2) / W
                        sources[y, x0 + x] |= np.uint32(1) << np.uint32(k)
                        parallax[y, x0 + x] += moved_x * moved_x + moved_y * moved_y


@helper
def _try(
    view: View, y: int, x0: int, n: int, trial: Float32s, source: Int32s, window: Float32s, s: Float32s, fetched: Uint64s,
    trial_cost: Float32s, planes: Float32s, cost: Float32s, best: Int32s,
) -> None:  # fmt: skip
    """Score the planes of `trial` in one source each, and keep those that cost less than the pixels' own."""
    _, usable, pairs, height, width, M, b, taps, reach = view
    _costs(pairs, height, width, M, b, taps, reach, y, x0, trial, source, window, s, fetched, trial_cost)
    _keep_cheaper(planes, cost, best, usable, reach, y, x0, n, trial, source, trial_cost)


@helper
def _windows(image: Float32s, usable: Float32s, taps: Int32s, reach: int, y: int, x0: int, n: int, window: Float32s) -> None:
    """The patches of `n` pixels from (x0, y) on: standard deviation; then for each tap its weights, which sum to 1 over the taps;
    then for each tap weight times (grey - mean).  Weights fall as 1 / (1 + (dI / softness)^2); unusable pixels have 0."""
    soft = np.float32(1.0 / _SOFTNESS)
    count = len(taps)
    window[:_TAPS] = np.float32(0.0)
    centre = image[y + reach, x0 + reach :]

    # 1. Weights, and differences from the centre, which keep single precision exact.
    for t in range(count):
        j = y + reach + taps[t, 1]
        i = x0 + reach + taps[t, 0]
        grey = image[j, i:]
        use = usable[j, i:]
        weights = window[_TAPS + t * BLOCK :]
        values = window[_TAPS + (count + t) * BLOCK :]
        for x in range(n):
            d = grey[x] - centre[x]
            e = d * soft
            w = use[x] / (np.float32(1.0) + e * e)
            weights[x] = w
            values[x] = d
        for x in range(n):
            window[_TOTAL + x] += weights[x]
            window[_OFFSET + x] += weights[x] * values[x]

    # 2. Mean, and the factor that makes the weights sum to 1.
    for x in range(n):
        scale = np.float32(1.0) / max(window[_TOTAL + x], np.float32(1e-6))
        window[_TOTAL + x] = scale
        window[_OFFSET + x] *= scale

    # 3. Subtract the mean; standard deviation.
    for t in range(count):
        weights = window[_TAPS + t * BLOCK :]
        values = window[_TAPS + (count + t) * BLOCK :]
        for x in range(n):
            w = weights[x] * window[_TOTAL + x]
            d = values[x] - window[_OFFSET + x]
            weights[x] = w
            values[x] = w * d
            window[_SPREAD + x] += w * d * d
    for x in range(n):
        window[_SPREAD + x] = np.sqrt(window[_SPREAD + x])


@helper
def _project(
    height: int, width: int, M: Float32s, b: Float32s, y: int, x0: int, trial: Float32s, source: Int32s, s: Float32s
) -> None:
    """Project the planes of `trial` at (x0, y), ... into one source each, with the derivatives of the position in x and y."""
    starts = s.view(np.int32)
    row = np.float32(y)
    for k in range(len(M)):
        # most blocks need only a few of the sources
        present = 0
        for x in range(BLOCK):
            present += source[x] == k
        if present == 0:
            continue
        # M (x, y, 1) + b q, with what is constant along a row in c0, c1, c2
        m00, m10, m20 = M[k, 0, 0], M[k, 1, 0], M[k, 2, 0]
        m01, m11, m21 = M[k, 0, 1], M[k, 1, 1], M[k, 2, 1]
        b0, b1, b2 = b[k, 0], b[k, 1], b[k, 2]
        c0 = m01 * row + M[k, 0, 2]
        c1 = m11 * row + M[k, 1, 2]
        c2 = m21 * row + M[k, 2, 2]
        start = np.int32(k * height * width)
        for x in range(BLOCK):
            column = np.float32(np.int32(x0) + np.int32(x))
            q = trial[_Q + x]
            A = trial[_A + x]
            B = trial[_B + x]
            W = m20 * column + c2 + b2 * q
            inverse = np.float32(1.0) / max(W, np.float32(_NEAREST))
            u = (m00 * column + c0 + b0 * q) * inverse
            v = (m10 * column + c1 + b1 * q) * inverse
            # quotient rule; q itself changes by A and B per pixel
            wx = m20 + b2 * A
            wy = m21 + b2 * B
            # every value is computed, and kept only where k is the pixel's source: a branch would prevent vectorisation
            in_source = source[x] == k
            s[_U + x] = u if in_source else s[_U + x]
            s[_V + x] = v if in_source else s[_V + x]
            s[_UX + x] = (m00 + b0 * A - u * wx) * inverse if in_source else s[_UX + x]
            s[_UY + x] = (m01 + b0 * B - u * wy) * inverse if in_source else s[_UY + x]
            s[_VX + x] = (m10 + b1 * A - v * wx) * inverse if in_source else s[_VX + x]
            s[_VY + x] = (m11 + b1 * B - v * wy) * inverse if in_source else s[_VY + x]
            s[_DEPTH + x] = W if in_source else s[_DEPTH + x]
            starts[_START + x] = start if in_source else starts[_START + x]


@helper
def _costs(
    pairs: Uint64s, height: int, width: int, M: Float32s, b: Float32s, taps: Int32s, reach: int, y: int, x0: int,
    trial: Float32s, source: Int32s, window: Float32s, s: Float32s, fetched: Uint64s, cost: Float32s,
) -> None:  # fmt: skip
    """1 - ZNCC, 0 to 1, between the patches around (x0, y), (x0 + 1, y), ... and their projections into one source each by the
    planes of `trial`; UNSEEN where there is no plane, or the patch leaves the image or lies behind the camera."""
    _project(height, width, M, b, y, x0, trial, source, s)
    ints = s.view(np.int32)
    uints = s.view(np.uint32)
    greys = fetched.view(np.float32)
    count = len(taps)
    stride = np.int32(width)
    zero = np.float32(0.0)
    last_column = np.float32(width - 2)
    last_row = np.float32(height - 2)
    s[_MEAN:_SCALE] = zero
    for t in range(count):
        # where the tap falls in the source: the patch maps affinely
        dx = np.float32(taps[t, 0])
        dy = np.float32(taps[t, 1])
        for x in range(BLOCK):
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
            ints[_PLACE + x] = ints[_START + x] + j * stride + i
        # each fetch gives two neighbours; in loops of their own, because gathers do not vectorise
        for x in range(BLOCK):
            fetched[x] = pairs[uints[_PLACE + x]]
        for x in range(BLOCK):
            fetched[BLOCK + x] = pairs[uints[_PLACE + x] + np.uint32(stride)]
        # bilinear interpolation
        for x in range(BLOCK):
            top = greys[2 * x]
            bottom = greys[2 * BLOCK + 2 * x]
            top += s[_FX + x] * (greys[2 * x + 1] - top)
            bottom += s[_FX + x] * (greys[2 * BLOCK + 2 * x + 1] - bottom)
            s[_FX + x] = top + s[_FY + x] * (bottom - top)
        if t == 0:  # sums use differences from the centre, so that rounding does not hide weak contrast
            for x in range(BLOCK):
                s[_CENTRE + x] = s[_FX + x]
        weights = window[_TAPS + t * BLOCK :]
        pattern = window[_TAPS + (count + t) * BLOCK :]
        for x in range(BLOCK):
            r = s[_FX + x] - s[_CENTRE + x]
            weighted = weights[x] * r
            s[_MEAN + x] += weighted
            s[_SQUARE + x] += weighted * r
            s[_PRODUCT + x] += pattern[x] * r
    _costs_of_sums(height, width, reach, trial, window, s, cost)


@helper
def _costs_of_sums(height: int, width: int, reach: int, trial: Float32s, window: Float32s, s: Float32s, cost: Float32s) -> None:
    """1 - ZNCC from the sums over patches that `_costs` has written."""
    zero = np.float32(0.0)
    last_column = np.float32(width - 2)
    last_row = np.float32(height - 2)
    flat = np.float32(_FLAT)
    flat_spread = np.float32(_FLAT**0.5)
    radius = np.float32(reach)
    for x in range(BLOCK):
        spread = window[_SPREAD + x]
        variance = s[_SQUARE + x] - s[_MEAN + x] * s[_MEAN + x]
        c = np.float32(1.0) - s[_PRODUCT + x] / (max(spread, flat_spread) * np.sqrt(max(variance, flat)))
        c = min(max(c, zero), np.float32(1.0))
        if variance < flat or spread < flat_spread:
            c = np.float32(_FLAT_COST)
        # the patch's bounding box must lie in the source
        u = s[_U + x]
        v = s[_V + x]
        du = radius * (abs(s[_UX + x]) + abs(s[_UY + x]))
        dv = radius * (abs(s[_VX + x]) + abs(s[_VY + x]))
        inside = u >= du and v >= dv and u + du < last_column + np.float32(0.999) and v + dv < last_row + np.float32(0.999)
        if not (inside and s[_DEPTH + x] > np.float32(_NEAREST) and trial[_Q + x] > zero):
            c = np.float32(UNSEEN)
        cost[x] = c


@helper
def _pixels_per_inverse_depth(
    height: int, width: int, M: Float32s, b: Float32s, y: int, x0: int, trial: Float32s, s: Float32s
) -> None:
    """Pixels that the points at (x0, y), ... move per unit of q in the source where they move most; 0 where none sees them."""
    row = np.float32(y)
    zero = np.float32(0.0)
    nearest = np.float32(_NEAREST)
    last_column = np.float32(width - 1)
    last_row = np.float32(height - 1)
    s[_SCALE:_SCRATCH] = zero
    for k in range(len(M)):
        m00, m10, m20 = M[k, 0, 0], M[k, 1, 0], M[k, 2, 0]
        c0 = M[k, 0, 1] * row + M[k, 0, 2]
        c1 = M[k, 1, 1] * row + M[k, 1, 2]
        c2 = M[k, 2, 1] * row + M[k, 2, 2]
        b0, b1, b2 = b[k, 0], b[k, 1], b[k, 2]
        for x in range(BLOCK):
            column = np.float32(np.int32(x0) + np.int32(x))
            W = m20 * column + c2 + b2 * trial[_Q + x]
            inverse = np.float32(1.0) / max(W, nearest)
            u = (m00 * column + c0 + b0 * trial[_Q + x]) * inverse
            v = (m10 * column + c1 + b1 * trial[_Q + x]) * inverse
            # (du/dq, dv/dq)
            moved_x = (b0 - u * b2) * inverse
            moved_y = (b1 - v * b2) * inverse
            moved = np.sqrt(moved_x * moved_x + moved_y * moved_y)
            inside = (u >= zero) & (v >= zero) & (u <= last_column) & (v <= last_row) & (nearest < W)
            s[_SCALE + x] = max(s[_SCALE + x], moved) if inside else s[_SCALE + x]


@helper
def _planes_at(
    planes: Float32s, best: Int32s, y: int, x0: int, n: int, dx: int, dy: int, low: Scalar, high: Scalar, trial: Float32s,
    source: Int32s,
) -> None:  # fmt: skip
    """The planes at (x0 + dx, y + dy), ... extrapolated to (x0, y), ..., and the sources that see them best; q = 0: none."""
    row = y + dy
    width = planes.shape[2]
    # the part of the block whose neighbours are in the image
    first = max(0, -x0 - dx)
    last = min(n, width - x0 - dx)
    trial[:] = np.float32(0.0)
    source[:] = np.int32(0)
    if first >= last:
        return
    start = x0 + dx + first
    q = planes[0, row, start:]
    a = planes[1, row, start:]
    b = planes[2, row, start:]
    best_source = best[row, start:]
    trial_here = trial[first:]
    source_here = source[first:]
    for x in range(last - first):
        extrapolated_q = q[x] - a[x] * np.float32(dx) - b[x] * np.float32(dy)
        if (extrapolated_q > low) & (extrapolated_q < high):  # never true where q is nan
            trial_here[_Q + x] = extrapolated_q
            trial_here[_A + x] = a[x]
            trial_here[_B + x] = b[x]
        source_here[x] = best_source[x]


@helper
def _own_planes(planes: Float32s, y: int, x0: int, n: int, trial: Float32s) -> None:
    """The planes at (x0, y), ..., regardless of their cost; q = 0: none."""
    trial[:] = np.float32(0.0)
    for x in range(n):
        q = planes[0, y, x0 + x]
        if q > np.float32(0.0):  # never true where q is nan
            trial[_Q + x] = q
            trial[_A + x] = planes[1, y, x0 + x]
            trial[_B + x] = planes[2, y, x0 + x]


@helper
def _perturb(
    noise: Float32s, start: int, shift: Scalar, turn: Scalar, low: Scalar, high: Scalar, s: Float32s, trial: Float32s
) -> None:
    """Shift and tilt the planes of `trial` at random: by up to `shift` pixels, and `turn` pixels per pixel, in the source where
    they move most.  noise: random numbers from -1 to 1, used from `start` on."""
    first = noise[start:]
    second = noise[(start + BLOCK) % NOISE :]
    third = noise[(start + 2 * BLOCK) % NOISE :]
    for x in range(BLOCK):
        scale = s[_SCALE + x]
        per_pixel = np.float32(1.0) / max(scale, np.float32(1e-12))
        q = trial[_Q + x] + first[x] * shift * per_pixel
        usable = (scale > np.float32(0.0)) & (trial[_Q + x] > np.float32(0.0)) & (q > low) & (q < high)
        trial[_Q + x] = q if usable else np.float32(0.0)
        trial[_A + x] += second[x] * turn * per_pixel
        trial[_B + x] += third[x] * turn * per_pixel


@helper
def _keep_cheaper(
    planes: Float32s, cost: Float32s, best: Int32s, usable: Float32s, reach: int, y: int, x0: int, n: int, trial: Float32s,
    source: Int32s, trial_cost: Float32s,
) -> None:  # fmt: skip
    """Replace the planes at (x0, y), ..., their costs and their sources where those of `trial` cost less, on usable pixels."""
    use = usable[y + reach, x0 + reach :]
    own_cost = cost[y, x0:]
    best_source = best[y, x0:]
    q = planes[0, y, x0:]
    a = planes[1, y, x0:]
    b = planes[2, y, x0:]
    for x in range(n):
        if trial_cost[x] < own_cost[x] and use[x] > np.float32(0.0):
            own_cost[x] = trial_cost[x]
            best_source[x] = source[x]
            q[x] = trial[_Q + x]
            a[x] = trial[_A + x]
            b[x] = trial[_B + x]


@helper
def _sources_here(best: Int32s, y: int, x0: int, n: int, source: Int32s) -> None:
    """The sources that see the planes at (x0, y), ... best."""
    for x in range(n):
        source[x] = best[y, x0 + x]

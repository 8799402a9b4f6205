"""One round of PatchMatch propagation: each pixel tries its neighbours' planes and random changes, and keeps the cheapest.

Up to `_BLOCK` pixels of a row are evaluated at once, so that the compiler can use SIMD instructions.  A pixel therefore reads
finished rows, and its own row in the state before each step.  Steps of 1, 2 and 8 columns carry a plane along the row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.jit import Scalar, helper, kernel
from ..types import Bools, Float32s, Int64s, Uint64s

_LIKENESS = 8.0
"""Grey-level difference from the centre at which a pixel of the window gets half the weight."""
_RADIUS, _STRIDE = 3, 2
_ACROSS = 2 * _RADIUS // _STRIDE + 1
_TAPS = _ACROSS**2
_LEAST_VARIANCE = 0.05
_FLAT_COST = 0.9
_STEEPEST, _SHEAREST = -6.0, 6.0
_INVALID_DISPARITY = 1.0e6
"""Disparity of a plane that must not be tried: it leads out of the image, where the cost is 1."""

# Scratch is one flat array, in rows of _BLOCK at constant offsets: so the compiler can prove that the rows do not overlap.
_BLOCK = 128
_MIDDLE, _STEP, _MEAN, _SQUARE, _PRODUCT, _VALUES = (i * _BLOCK for i in range(6))
_PLACES = _VALUES + _ACROSS * _BLOCK
_SCRATCH = _PLACES + _ACROSS * _BLOCK
_D, _A, _B = (i * _BLOCK for i in range(3))
_WEIGHTS, _PATTERN = 0, _TAPS * _BLOCK
_SPREAD, _SCALE, _CENTRE = ((2 * _TAPS + i) * _BLOCK for i in range(3))
_WINDOW = (2 * _TAPS + 3) * _BLOCK


@dataclass(frozen=True)
class Trials:
    """Which planes a pixel tries in a round."""

    neighbours: Int64s
    """(n, 2) offsets (columns, rows) of the neighbours to try, in this order, counted against the direction of the sweep."""
    changes: int
    """Number of random changes of the pixel's own plane, each smaller than the one before."""
    shift_px: float
    """Largest random change of the disparity in the first round, pixels."""
    turn: float
    """Largest random change of each slope in the first round."""


TRIALS = Trials(np.array([(0, 1), (3, 2), (-3, 3), (1, 0), (2, 0), (8, 0)]), 4, 1.5, 0.3)
"""Trials for a start that is only roughly right."""


class Propagation:
    """Propagation over one view, with both images laid out for the kernels: the left one with a border, the right one as pairs of
    adjacent pixels, so that a single load fetches both values of an interpolation."""

    def __init__(self, left: Float32s, right: Float32s, valid_left: Bools, low: float, high: float) -> None:
        self.left = np.pad(left, _RADIUS, mode="edge")
        self.valid = np.pad(valid_left.astype(np.float32), _RADIUS, mode="edge")
        beside = np.concatenate([right[:, 1:], right[:, -1:]], axis=1)
        self.pairs = np.stack([right, beside], axis=2).view(np.uint64)[:, :, 0]
        self.range = Scalar(low), Scalar(high)

    def round(self, number: int, planes: Float32s, cost: Float32s, proposals: Float32s, trials: Trials = TRIALS) -> None:
        """Improve planes in place.

        Parameters
        ----------
        number : of the round, from 0: even rounds sweep down, odd ones up; random changes shrink with each round.
        planes, cost : (3, h, w) disparity and its slopes, and (h, w) their costs, 1 before the first round.
        proposals : (3, h, w) planes that are tried first, nan where there are none.
        trials : which further planes a pixel tries.
        """
        _propagate(
            self.left, self.pairs, self.valid, planes, cost, proposals, number, *self.range,
            Scalar(trials.shift_px * 0.6**number), Scalar(trials.turn * 0.7**number), trials.neighbours, trials.changes,
        )  # fmt: skip

    def costs(self, planes: Float32s) -> Float32s:
        """(h, w) cost of `planes` (3, h, w); 1 where they are nan or lead out of the range."""
        cost = np.ones(planes.shape[1:], dtype=np.float32)
        _evaluate(self.left, self.pairs, self.valid, planes, cost, *self.range)
        return cost


@helper
def _windows(left: Float32s, valid: Float32s, y: int, x0: int, n: int, window: Float32s) -> None:
    """Fill `window` for `n` pixels from (x0, y) on: weights, which sum to 1; weights times (grey minus the window's mean), which
    sum to 0; the standard deviation of the window.  `left` and `valid` have a border of _RADIUS."""
    soft = np.float32(1.0 / _LIKENESS)
    window[_SPREAD:_WINDOW] = np.float32(0.0)
    mean = _SPREAD  # overwritten by the standard deviation later
    for q in range(_ACROSS):
        for k in range(_ACROSS):
            tap = (q * _ACROSS + k) * _BLOCK
            grey, use = left[y + q * _STRIDE, x0 + k * _STRIDE :], valid[y + q * _STRIDE, x0 + k * _STRIDE :]
            centre = left[y + _RADIUS, x0 + _RADIUS :]
            for x in range(n):
                v = grey[x]
                e = (v - centre[x]) * soft
                w = use[x] / (np.float32(1.0) + e * e)
                window[_WEIGHTS + tap + x] = w
                window[_PATTERN + tap + x] = v
                window[_SCALE + x] += w
                window[mean + x] += w * v
    for x in range(n):
        scale = np.float32(1.0) / max(window[_SCALE + x], np.float32(1e-6))
        window[_SCALE + x] = scale
        window[_CENTRE + x] = window[mean + x] * scale
        window[_SPREAD + x] = np.float32(0.0)
    for tap in range(0, _TAPS * _BLOCK, _BLOCK):
        for x in range(n):
            w = window[_WEIGHTS + tap + x] * window[_SCALE + x]
            e = window[_PATTERN + tap + x] - window[_CENTRE + x]
            window[_WEIGHTS + tap + x] = w
            window[_PATTERN + tap + x] = w * e
            window[_SPREAD + x] += w * e * e
    for x in range(n):
        window[_SPREAD + x] = np.sqrt(window[_SPREAD + x])


@helper
def _costs(
    pairs: Uint64s, y: int, x0: int, trial: Float32s, window: Float32s, s: Float32s, taken: Uint64s, cost: Float32s
) -> None:
    """1 - ZNCC between the windows around (x0, y), (x0 + 1, y), ... and the right image under the planes of `trial`."""
    height, width = pairs.shape
    limit = np.float32(width - 2)
    whole, place, both = s.view(np.int32), s.view(np.uint32), taken.view(np.float32)
    for x in range(_BLOCK):
        s[_MIDDLE + x] = np.float32(np.int32(x0) + np.int32(x)) - trial[_D + x]
        s[_STEP + x] = np.float32(1.0) - trial[_A + x]
    s[_MEAN:_VALUES] = np.float32(0.0)
    for q in range(_ACROSS):
        dy = q * _STRIDE - _RADIUS
        row = pairs[min(max(y + dy, 0), height - 1)]
        for x in range(_BLOCK):
            middle, step = s[_MIDDLE + x] - trial[_B + x] * np.float32(dy), s[_STEP + x]
            for k in range(_ACROSS):
                at = middle + np.float32(k * _STRIDE - _RADIUS) * step
                at = at if at > np.float32(0.0) else np.float32(0.0)  # nan becomes 0, too: nothing outside the row is ever read
                s[_VALUES + k * _BLOCK + x] = at if at < limit else limit
        for x in range(_ACROSS * _BLOCK):
            at = s[_VALUES + x]
            i = np.int32(at)
            s[_VALUES + x] = at - np.float32(i)
            whole[_PLACES + x] = i
        for x in range(_ACROSS * _BLOCK):
            taken[x] = row[place[_PLACES + x]]
        for x in range(_ACROSS * _BLOCK):
            v = both[2 * x]
            s[_VALUES + x] = v + s[_VALUES + x] * (both[2 * x + 1] - v)
        tap = q * _ACROSS * _BLOCK
        for x in range(_BLOCK):
            mean, square, product = s[_MEAN + x], s[_SQUARE + x], s[_PRODUCT + x]
            for k in range(_ACROSS):
                v = s[_VALUES + k * _BLOCK + x]
                weighted = window[_WEIGHTS + tap + k * _BLOCK + x] * v
                mean += weighted
                square += weighted * v
                product += window[_PATTERN + tap + k * _BLOCK + x] * v
            s[_MEAN + x], s[_SQUARE + x], s[_PRODUCT + x] = mean, square, product
    flat = np.float32(_LEAST_VARIANCE)
    flat_spread = np.float32(_LEAST_VARIANCE**0.5)
    for x in range(_BLOCK):
        spread = window[_SPREAD + x]
        variance = s[_SQUARE + x] - s[_MEAN + x] * s[_MEAN + x]
        c = np.float32(1.0) - s[_PRODUCT + x] / (max(spread, flat_spread) * np.sqrt(max(variance, flat)))
        c = min(max(c, np.float32(0.0)), np.float32(1.0))
        if variance < flat or spread < flat_spread:
            c = np.float32(_FLAT_COST)
        reach = np.float32(_RADIUS) * (abs(s[_STEP + x]) + abs(trial[_B + x]))
        if s[_MIDDLE + x] - reach < np.float32(0.0) or s[_MIDDLE + x] + reach >= np.float32(width - 1):
            c = np.float32(1.0)
        cost[x] = c


@helper
def _neighbours(
    source: Float32s, valid: Float32s, y: int, x0: int, n: int, dx: int, dy: int, low: Scalar, high: Scalar, trial: Float32s
) -> None:
    """Extrapolate the planes of `source` at (x0 + dx, y + dy), ... to (x0, y), ...; unusable ones become `_INVALID_DISPARITY`."""
    row, width = y + dy, source.shape[2]
    first, last = max(0, -x0 - dx), min(n, width - x0 - dx)
    trial[_D : _D + n] = np.float32(_INVALID_DISPARITY)
    if first >= last:
        return
    d, a, b = source[0, row, x0 + dx + first :], source[1, row, x0 + dx + first :], source[2, row, x0 + dx + first :]
    use = valid[row + _RADIUS, _RADIUS + x0 + dx + first :]
    here = trial[first:]
    for x in range(last - first):
        na, nb = a[x], b[x]
        nd = d[x] - na * np.float32(dx) - nb * np.float32(dy)
        usable = (low <= nd) & (nd <= high) & (use[x] > np.float32(0.0))
        here[_D + x] = nd if usable else np.float32(_INVALID_DISPARITY)
        here[_A + x] = na if usable else np.float32(0.0)
        here[_B + x] = nb if usable else np.float32(0.0)


@helper
def _random(x: np.uint32, seed: np.uint32) -> np.float32:
    """Pseudo-random number from -1 to 1, a hash of x and seed."""
    h = np.uint32(np.uint32(x * np.uint32(0x9E3779B1)) ^ np.uint32(seed * np.uint32(0xC2B2AE3D)))
    h = np.uint32(np.uint32(h ^ np.uint32(h >> np.uint32(16))) * np.uint32(0x7FEB352D))
    h = np.uint32(np.uint32(h ^ np.uint32(h >> np.uint32(15))) * np.uint32(0x846CA68B))
    h = np.uint32(h ^ np.uint32(h >> np.uint32(16)))
    return np.float32(np.int32(h)) * np.float32(1.0 / (1 << 31))


@kernel
def _changed(
    planes: Float32s, y: int, x0: int, n: int, seed: int, shift: Scalar, turn: Scalar, low: Scalar, high: Scalar, trial: Float32s
) -> None:
    """The planes at (x0, y), ... with random changes of disparity and slopes."""
    d, a, b = planes[0, y, x0:], planes[1, y, x0:], planes[2, y, x0:]
    seed1, seed2, seed3 = np.uint32(3 * seed), np.uint32(3 * seed + 1), np.uint32(3 * seed + 2)
    for x in range(n):
        column = np.uint32(x0 + x)
        nd = d[x] + _random(column, seed1) * shift
        na = a[x] + _random(column, seed2) * turn
        nb = b[x] + _random(column, seed3) * turn
        usable = low <= nd <= high and np.float32(_STEEPEST) <= na <= np.float32(0.9) and abs(nb) <= np.float32(_SHEAREST)
        trial[_D + x] = nd if usable else np.float32(_INVALID_DISPARITY)
        trial[_A + x], trial[_B + x] = na, nb


@helper
def _keep_cheaper(
    planes: Float32s, cost: Float32s, valid: Float32s, y: int, x0: int, n: int, trial: Float32s, trial_cost: Float32s
) -> None:
    use, c = valid[y + _RADIUS, x0 + _RADIUS :], cost[y, x0:]
    for x in range(n):
        better = trial_cost[x] < c[x] and use[x] > np.float32(0.0)
        if better:
            c[x] = trial_cost[x]
            planes[0, y, x0 + x] = trial[_D + x]
            planes[1, y, x0 + x] = trial[_A + x]
            planes[2, y, x0 + x] = trial[_B + x]


@kernel
def _propagate(
    left: Float32s, pairs: Uint64s, valid: Float32s, planes: Float32s, cost: Float32s, proposals: Float32s,
    number: int, low: Scalar, high: Scalar, amplitude: Scalar, tilt: Scalar, neighbours: Int64s, changes: int,
) -> None:  # fmt: skip
    height, width = cost.shape
    window = np.zeros(_WINDOW, dtype=np.float32)
    scratch = np.zeros(_SCRATCH, dtype=np.float32)
    taken = np.zeros(_ACROSS * _BLOCK, dtype=np.uint64)
    trial, trial_cost = np.zeros(3 * _BLOCK, dtype=np.float32), np.zeros(_BLOCK, dtype=np.float32)
    blocks = (width + _BLOCK - 1) // _BLOCK
    back = -1 if number % 2 == 0 else 1
    for i in range(height):
        y = i if back < 0 else height - 1 - i
        for j in range(blocks):
            x0 = (j if back < 0 else blocks - 1 - j) * _BLOCK
            n = min(_BLOCK, width - x0)
            if not valid[y + _RADIUS, x0 + _RADIUS : x0 + _RADIUS + n].any():
                continue
            _windows(left, valid, y, x0, n, window)
            _neighbours(proposals, valid, y, x0, n, 0, 0, low, high, trial)
            _costs(pairs, y, x0, trial, window, scratch, taken, trial_cost)
            _keep_cheaper(planes, cost, valid, y, x0, n, trial, trial_cost)
            for q in range(len(neighbours)):
                dx, dy = back * neighbours[q, 0], back * neighbours[q, 1]
                if not 0 <= y + dy < height:
                    continue
                _neighbours(planes, valid, y, x0, n, dx, dy, low, high, trial)
                _costs(pairs, y, x0, trial, window, scratch, taken, trial_cost)
                _keep_cheaper(planes, cost, valid, y, x0, n, trial, trial_cost)
            shift, turn = amplitude, tilt
            for q in range(changes):
                _changed(planes, y, x0, n, (number * changes + q) * height + y, shift, turn, low, high, trial)
                _costs(pairs, y, x0, trial, window, scratch, taken, trial_cost)
                _keep_cheaper(planes, cost, valid, y, x0, n, trial, trial_cost)
                shift *= np.float32(0.35)
                turn *= np.float32(0.45)


@kernel
def _evaluate(
    left: Float32s, pairs: Uint64s, valid: Float32s, planes: Float32s, cost: Float32s, low: Scalar, high: Scalar
) -> None:
    height, width = cost.shape
    window = np.zeros(_WINDOW, dtype=np.float32)
    scratch = np.zeros(_SCRATCH, dtype=np.float32)
    taken = np.zeros(_ACROSS * _BLOCK, dtype=np.uint64)
    trial, trial_cost = np.zeros(3 * _BLOCK, dtype=np.float32), np.zeros(_BLOCK, dtype=np.float32)
    for y in range(height):
        for x0 in range(0, width, _BLOCK):
            n = min(_BLOCK, width - x0)
            if not valid[y + _RADIUS, x0 + _RADIUS : x0 + _RADIUS + n].any():
                continue
            _windows(left, valid, y, x0, n, window)
            _neighbours(planes, valid, y, x0, n, 0, 0, low, high, trial)
            _costs(pairs, y, x0, trial, window, scratch, taken, trial_cost)
            for x in range(n):
                cost[y, x0 + x] = trial_cost[x]

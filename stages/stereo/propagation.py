"""One round of PatchMatch propagation: each pixel tries its neighbours' planes and random changes, and keeps the cheapest.

Up to `_BLOCK` pixels of a row are evaluated at once, so that the compiler can use SIMD instructions.  A pixel therefore reads
finished rows, and its own row in the state before each step.  Steps of 1, 2 and 8 columns carry a plane along the row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.jit import Scalar, helper, kernel
from ..types import Bools, Float32s, Int64s, Uint64s

_SIMILARITY_SCALE = 8.0
"""Grey-level difference from the centre at which a pixel of the window gets half the weight; larger values blur across edges."""
_RADIUS = 3
"""Radius of the matching window, pixels."""
_STRIDE = 2
"""Distance between the pixels of the window that are compared (its taps)."""
_TAPS_ACROSS = 2 * _RADIUS // _STRIDE + 1
"""Taps in a row of the window."""
_TAPS = _TAPS_ACROSS**2
"""Taps of a window."""
_LEAST_VARIANCE = 0.05
"""Windows with a smaller variance, in squared grey levels, show no texture; larger values lose white walls."""
_FLAT_COST = 0.9
"""Cost between windows of which one shows no texture: worse than any match, better than none."""
_MIN_SLOPE_X = -6.0
"""Smallest slope of disparity along x that a random change may reach."""
_MAX_SLOPE_X = 0.9
"""Largest slope along x: at 1, the whole window falls on one column of the right image."""
_MAX_SLOPE_Y = 6.0
"""Largest absolute slope along y that a random change may reach."""
_SHIFT_SHRINKS = 0.6
"""Random changes of the disparity are smaller by this factor in each further round."""
_TURN_SHRINKS = 0.7
"""Random changes of the slopes are smaller by this factor in each further round."""
_NEXT_SHIFT = 0.35
"""Each further random change of a disparity within a round is smaller by this factor."""
_NEXT_TURN = 0.45
"""Each further random change of the slopes within a round is smaller by this factor."""
_INVALID_DISPARITY = 1.0e6
"""Disparity of a plane that must not be tried: it leads out of the image, where the cost is 1."""

# Scratch is one flat array, in rows of _BLOCK at constant offsets: so the compiler can prove that the rows do not overlap.
_BLOCK = 128
"""Pixels of a row that are processed at once."""

# Rows of `scratch`, in which `_costs` works.
_MIDDLE = 0 * _BLOCK  # column in the right image of each pixel's partner
_STEP = 1 * _BLOCK  # columns by which it moves for each column of the left image
_MEAN = 2 * _BLOCK  # weighted mean of the right window
_SQUARE = 3 * _BLOCK  # weighted mean of its squares
_PRODUCT = 4 * _BLOCK  # sum of its products with the pattern of the left window
_VALUES = 5 * _BLOCK  # of one row of taps: columns, then their fractions, then grey levels
_COLUMNS = _VALUES + _TAPS_ACROSS * _BLOCK  # of one row of taps: whole columns, int32
_SCRATCH = _COLUMNS + _TAPS_ACROSS * _BLOCK

# Rows of `trial`: the plane that each pixel tries.
_D = 0 * _BLOCK  # disparity
_A = 1 * _BLOCK  # slope along x
_B = 2 * _BLOCK  # slope along y
_TRIAL = 3 * _BLOCK

# Rows of `window`: the left windows, prepared once for all trials.
_WEIGHTS = 0 * _BLOCK  # of each tap
_PATTERN = _TAPS * _BLOCK  # of each tap: weight times grey without the mean
_SPREAD = 2 * _TAPS * _BLOCK  # standard deviation
_SCALE = _SPREAD + _BLOCK  # one over the sum of the raw weights
_CENTRE = _SCALE + _BLOCK  # mean
_WINDOW = _CENTRE + _BLOCK


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
    adjacent pixels, so that a single load fetches both values of an interpolation.

    Parameters
    ----------
    left, right : (h, w) grey levels of both rectified images.
    valid_left : (h, w) pixels of the left image that may be matched.
    low, high : smallest and largest disparity that a plane may have, pixels.
    """

    def __init__(self, left: Float32s, right: Float32s, valid_left: Bools, low: float, high: float) -> None:
        self.left = np.pad(left, _RADIUS, mode="edge")
        self.valid = np.pad(valid_left.astype(np.float32), _RADIUS, mode="edge")
        # (h, w) uint64: each holds two float32, a pixel and its neighbour to the right
        next_pixels = np.concatenate([right[:, 1:], right[:, -1:]], axis=1)
        self.pairs = np.stack([right, next_pixels], axis=2).view(np.uint64)[:, :, 0]
        self.range = (Scalar(low), Scalar(high))

    def round(self, number: int, planes: Float32s, cost: Float32s, proposals: Float32s, trials: Trials = TRIALS) -> None:
        """Improve planes in place.

        Parameters
        ----------
        number : of the round, from 0: even rounds sweep down, odd ones up; random changes shrink with each round.
        planes, cost : (3, h, w) disparity and its slopes, and (h, w) their costs, 1 before the first round.
        proposals : (3, h, w) planes that are tried first, nan where there are none.
        trials : which further planes a pixel tries.
        """
        largest_shift = Scalar(trials.shift_px * _SHIFT_SHRINKS**number)
        largest_turn = Scalar(trials.turn * _TURN_SHRINKS**number)
        _propagate(
            self.left, self.pairs, self.valid, planes, cost, proposals, number, *self.range,
            largest_shift, largest_turn, trials.neighbours, trials.changes,
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
    inverse_scale = np.float32(1.0 / _SIMILARITY_SCALE)
    window[_SPREAD:_WINDOW] = np.float32(0.0)
    centre = left[y + _RADIUS, x0 + _RADIUS :]
    # 1. raw weights, by validity and by similarity to the centre; grey levels; sums of both
    mean = _SPREAD  # overwritten by the standard deviation later
    for j in range(_TAPS_ACROSS):
        for k in range(_TAPS_ACROSS):
            tap = (j * _TAPS_ACROSS + k) * _BLOCK
            grey = left[y + j * _STRIDE, x0 + k * _STRIDE :]
            validity = valid[y + j * _STRIDE, x0 + k * _STRIDE :]
            for x in range(n):
                v = grey[x]
                e = (v - centre[x]) * inverse_scale
                w = validity[x] / (np.float32(1.0) + e * e)
                window[_WEIGHTS + tap + x] = w
                window[_PATTERN + tap + x] = v
                window[_SCALE + x] += w
                window[mean + x] += w * v
    # 2. the mean
    for x in range(n):
        scale = np.float32(1.0) / max(window[_SCALE + x], np.float32(1e-6))  # the sum is 0 where nothing is valid
        window[_SCALE + x] = scale
        window[_CENTRE + x] = window[mean + x] * scale
        window[_SPREAD + x] = np.float32(0.0)
    # 3. weights that sum to 1, the pattern, and the variance
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
    pairs: Uint64s, y: int, x0: int, trial: Float32s, window: Float32s, scratch: Float32s, loaded: Uint64s, cost: Float32s
) -> None:
    """1 - ZNCC between the windows around (x0, y), (x0 + 1, y), ... and the right image under the planes of `trial`.

    A plane (d, a, b) sends the tap (dx, dy) of pixel x to the column x - d + (1 - a) dx - b dy.  As the left pattern sums to 0,
    the correlation is the sum of its products with the right window, over both standard deviations.
    """
    height, width = pairs.shape
    limit = np.float32(width - 2)
    as_int = scratch.view(np.int32)
    as_uint = scratch.view(np.uint32)
    loaded_values = loaded.view(np.float32)
    for x in range(_BLOCK):
        scratch[_MIDDLE + x] = np.float32(np.int32(x0) + np.int32(x)) - trial[_D + x]
        scratch[_STEP + x] = np.float32(1.0) - trial[_A + x]
    scratch[_MEAN:_VALUES] = np.float32(0.0)
    for j in range(_TAPS_ACROSS):
        dy = j * _STRIDE - _RADIUS
        row = pairs[min(max(y + dy, 0), height - 1)]
        # Each step is a loop of its own, so that all but the third, which loads from computed places, become SIMD instructions.
        # 1. columns of a row of taps, kept in the image
        for x in range(_BLOCK):
            middle = scratch[_MIDDLE + x] - trial[_B + x] * np.float32(dy)
            step = scratch[_STEP + x]
            for k in range(_TAPS_ACROSS):
                position = middle + np.float32(k * _STRIDE - _RADIUS) * step
                position = position if position > np.float32(0.0) else np.float32(0.0)  # nan becomes 0, too
                scratch[_VALUES + k * _BLOCK + x] = position if position < limit else limit
        # 2. their whole parts and fractions
        for x in range(_TAPS_ACROSS * _BLOCK):
            position = scratch[_VALUES + x]
            whole_part = np.int32(position)
            scratch[_VALUES + x] = position - np.float32(whole_part)
            as_int[_COLUMNS + x] = whole_part
        # 3. two adjacent pixels in one load; an unsigned index needs no test for negative ones
        for x in range(_TAPS_ACROSS * _BLOCK):
            loaded[x] = row[as_uint[_COLUMNS + x]]
        # 4. linear interpolation
        for x in range(_TAPS_ACROSS * _BLOCK):
            v = loaded_values[2 * x]
            scratch[_VALUES + x] = v + scratch[_VALUES + x] * (loaded_values[2 * x + 1] - v)
        # 5. sums over the window
        tap = j * _TAPS_ACROSS * _BLOCK
        for x in range(_BLOCK):
            mean = scratch[_MEAN + x]
            square = scratch[_SQUARE + x]
            product = scratch[_PRODUCT + x]
            for k in range(_TAPS_ACROSS):
                v = scratch[_VALUES + k * _BLOCK + x]
                weighted = window[_WEIGHTS + tap + k * _BLOCK + x] * v
                mean += weighted
                square += weighted * v
                product += window[_PATTERN + tap + k * _BLOCK + x] * v
            scratch[_MEAN + x] = mean
            scratch[_SQUARE + x] = square
            scratch[_PRODUCT + x] = product
    _costs_of_sums(width, trial, window, scratch, cost)


@helper
def _costs_of_sums(width: int, trial: Float32s, window: Float32s, scratch: Float32s, cost: Float32s) -> None:
    """Fill `cost` with 1 - ZNCC from the sums in `scratch`; width: of the right image."""
    flat_variance = np.float32(_LEAST_VARIANCE)
    flat_spread = np.float32(_LEAST_VARIANCE**0.5)
    for x in range(_BLOCK):
        spread = window[_SPREAD + x]
        variance = scratch[_SQUARE + x] - scratch[_MEAN + x] * scratch[_MEAN + x]
        pixel_cost = np.float32(1.0) - scratch[_PRODUCT + x] / (max(spread, flat_spread) * np.sqrt(max(variance, flat_variance)))
        pixel_cost = min(max(pixel_cost, np.float32(0.0)), np.float32(1.0))
        if variance < flat_variance or spread < flat_spread:
            pixel_cost = np.float32(_FLAT_COST)
        # no match where the window reaches beyond the right image
        reach = np.float32(_RADIUS) * (abs(scratch[_STEP + x]) + abs(trial[_B + x]))
        if scratch[_MIDDLE + x] - reach < np.float32(0.0) or scratch[_MIDDLE + x] + reach >= np.float32(width - 1):
            pixel_cost = np.float32(1.0)
        cost[x] = pixel_cost


@helper
def _extrapolate(
    source: Float32s, valid: Float32s, y: int, x0: int, n: int, dx: int, dy: int, low: Scalar, high: Scalar, trial: Float32s
) -> None:
    """Extrapolate the planes of `source` at (x0 + dx, y + dy), ... to (x0, y), ...; unusable ones become `_INVALID_DISPARITY`."""
    row = y + dy
    width = source.shape[2]
    # pixels of the block whose source lies in the image
    first = max(0, -x0 - dx)
    last = min(n, width - x0 - dx)
    trial[_D : _D + n] = np.float32(_INVALID_DISPARITY)
    if first >= last:
        return
    d = source[0, row, x0 + dx + first :]
    a = source[1, row, x0 + dx + first :]
    b = source[2, row, x0 + dx + first :]
    validity = valid[row + _RADIUS, _RADIUS + x0 + dx + first :]
    target = trial[first:]
    for x in range(last - first):
        na = a[x]
        nb = b[x]
        nd = d[x] - na * np.float32(dx) - nb * np.float32(dy)
        usable = (low <= nd) & (nd <= high) & (validity[x] > np.float32(0.0))
        target[_D + x] = nd if usable else np.float32(_INVALID_DISPARITY)
        target[_A + x] = na if usable else np.float32(0.0)
        target[_B + x] = nb if usable else np.float32(0.0)


@helper
def _random(x: np.uint32, seed: np.uint32) -> np.float32:
    """Pseudo-random number from -1 to 1, a hash of x and seed (two rounds of multiplication and xor-shift).

    A hash needs no state, so that a pixel's numbers do not depend on the order in which pixels are visited."""
    h = np.uint32(np.uint32(x * np.uint32(0x9E3779B1)) ^ np.uint32(seed * np.uint32(0xC2B2AE3D)))
    h = np.uint32(np.uint32(h ^ np.uint32(h >> np.uint32(16))) * np.uint32(0x7FEB352D))
    h = np.uint32(np.uint32(h ^ np.uint32(h >> np.uint32(15))) * np.uint32(0x846CA68B))
    h = np.uint32(h ^ np.uint32(h >> np.uint32(16)))
    return np.float32(np.int32(h)) * np.float32(1.0 / (1 << 31))


@kernel
def _perturb(
    planes: Float32s, y: int, x0: int, n: int, seed: int, shift: Scalar, turn: Scalar, low: Scalar, high: Scalar, trial: Float32s
) -> None:
    """The planes at (x0, y), ... with random changes of disparity and slopes."""
    d = planes[0, y, x0:]
    a = planes[1, y, x0:]
    b = planes[2, y, x0:]
    seed1 = np.uint32(3 * seed)
    seed2 = np.uint32(3 * seed + 1)
    seed3 = np.uint32(3 * seed + 2)
    for x in range(n):
        column = np.uint32(x0 + x)
        nd = d[x] + _random(column, seed1) * shift
        na = a[x] + _random(column, seed2) * turn
        nb = b[x] + _random(column, seed3) * turn
        usable_slopes = np.float32(_MIN_SLOPE_X) <= na <= np.float32(_MAX_SLOPE_X) and abs(nb) <= np.float32(_MAX_SLOPE_Y)
        usable = low <= nd <= high and usable_slopes
        trial[_D + x] = nd if usable else np.float32(_INVALID_DISPARITY)
        trial[_A + x] = na
        trial[_B + x] = nb


@helper
def _keep_cheaper(
    planes: Float32s, cost: Float32s, valid: Float32s, y: int, x0: int, n: int, trial: Float32s, trial_cost: Float32s
) -> None:
    """Replace the planes at (x0, y), ... where the trial costs less."""
    validity = valid[y + _RADIUS, x0 + _RADIUS :]
    current_cost = cost[y, x0:]
    for x in range(n):
        is_better = trial_cost[x] < current_cost[x] and validity[x] > np.float32(0.0)
        if is_better:
            current_cost[x] = trial_cost[x]
            planes[0, y, x0 + x] = trial[_D + x]
            planes[1, y, x0 + x] = trial[_A + x]
            planes[2, y, x0 + x] = trial[_B + x]


@kernel
def _propagate(
    left: Float32s, pairs: Uint64s, valid: Float32s, planes: Float32s, cost: Float32s, proposals: Float32s,
    number: int, low: Scalar, high: Scalar, largest_shift: Scalar, largest_turn: Scalar, neighbours: Int64s, changes: int,
) -> None:  # fmt: skip
    """One sweep over the image, block by block; the kernel of `Propagation.round`."""
    height, width = cost.shape
    window = np.zeros(_WINDOW, dtype=np.float32)
    scratch = np.zeros(_SCRATCH, dtype=np.float32)
    loaded = np.zeros(_TAPS_ACROSS * _BLOCK, dtype=np.uint64)
    trial = np.zeros(_TRIAL, dtype=np.float32)
    trial_cost = np.zeros(_BLOCK, dtype=np.float32)
    blocks = (width + _BLOCK - 1) // _BLOCK
    sweeps_down = number % 2 == 0
    against_sweep = -1 if sweeps_down else 1
    for i in range(height):
        y = i if sweeps_down else height - 1 - i
        for j in range(blocks):
            block = j if sweeps_down else blocks - 1 - j
            x0 = block * _BLOCK
            n = min(_BLOCK, width - x0)
            if not valid[y + _RADIUS, x0 + _RADIUS : x0 + _RADIUS + n].any():
                continue
            _windows(left, valid, y, x0, n, window)
            # 1. the proposals
            _extrapolate(proposals, valid, y, x0, n, 0, 0, low, high, trial)
            _costs(pairs, y, x0, trial, window, scratch, loaded, trial_cost)
            _keep_cheaper(planes, cost, valid, y, x0, n, trial, trial_cost)
            # 2. the neighbours' planes
            for k in range(len(neighbours)):
                dx = against_sweep * neighbours[k, 0]
                dy = against_sweep * neighbours[k, 1]
                if not 0 <= y + dy < height:
                    continue
                _extrapolate(planes, valid, y, x0, n, dx, dy, low, high, trial)
                _costs(pairs, y, x0, trial, window, scratch, loaded, trial_cost)
                _keep_cheaper(planes, cost, valid, y, x0, n, trial, trial_cost)
            # 3. random changes, each smaller than the one before
            shift = largest_shift
            turn = largest_turn
            for k in range(changes):
                seed = (number * changes + k) * height + y  # another one for each round, change and row
                _perturb(planes, y, x0, n, seed, shift, turn, low, high, trial)
                _costs(pairs, y, x0, trial, window, scratch, loaded, trial_cost)
                _keep_cheaper(planes, cost, valid, y, x0, n, trial, trial_cost)
                shift *= np.float32(_NEXT_SHIFT)
                turn *= np.float32(_NEXT_TURN)


@kernel
def _evaluate(
    left: Float32s, pairs: Uint64s, valid: Float32s, planes: Float32s, cost: Float32s, low: Scalar, high: Scalar
) -> None:
    """The kernel of `Propagation.costs`."""
    height, width = cost.shape
    window = np.zeros(_WINDOW, dtype=np.float32)
    scratch = np.zeros(_SCRATCH, dtype=np.float32)
    loaded = np.zeros(_TAPS_ACROSS * _BLOCK, dtype=np.uint64)
    trial = np.zeros(_TRIAL, dtype=np.float32)
    trial_cost = np.zeros(_BLOCK, dtype=np.float32)
    for y in range(height):
        for x0 in range(0, width, _BLOCK):
            n = min(_BLOCK, width - x0)
            if not valid[y + _RADIUS, x0 + _RADIUS : x0 + _RADIUS + n].any():
                continue
            _windows(left, valid, y, x0, n, window)
            _extrapolate(planes, valid, y, x0, n, 0, 0, low, high, trial)
            _costs(pairs, y, x0, trial, window, scratch, loaded, trial_cost)
            for x in range(n):
                cost[y, x0 + x] = trial_cost[x]

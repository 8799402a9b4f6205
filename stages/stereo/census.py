"""Semi-global matching on census costs (Zabih & Woodfill, ECCV 1994).

The census of a pixel records which of its 9x7 neighbours are darker, so exposure does not matter.  Semi-global matching runs
along eight paths (Hirschmueller, PAMI 2008); the disparities of both views come from the same cost volume.
"""

from __future__ import annotations

import numpy as np

from ..core.jit import helper, kernel
from ..types import Bools, Float32s, Uint8s, Uint16s, Uint64s
from .matcher import DenseMatches, RectifiedPair

_STEP_PENALTY = 12
"""Penalty, in bits of a census, for a change of disparity by 1 from one pixel to the next; larger values flatten slopes."""
_JUMP_PENALTY = 100.0
"""Penalty, in bits, for a larger change where the image is flat; larger values close over thin objects."""
_LEAST_JUMP_PENALTY = 20.0
"""Smallest penalty, in bits, for a larger change: that across a strong edge."""
_GRADIENT_WEIGHT = 0.1
"""How fast the penalty for a larger change falls with the difference of grey levels, per level."""
_UNKNOWN_COST = 35
"""Cost, in bits, of a partner that may not be matched: slightly above the cost of unrelated texture (31 of 62 bits)."""

# The sums of four paths, each of at most 62 bits and a jump penalty, stay far below the limit of uint16.
_SENTINEL = 30000
"""Path cost beyond both ends of the range of disparities: never the cheapest, and small enough that a penalty can be added."""
_UNSET = 65535
"""Largest uint16: a least cost before the first comparison."""


def match_census_sgm(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views, to a fraction of a pixel in the left one, in whole pixels in the right one."""
    return semi_global(pair, census_costs(pair))


def semi_global(pair: RectifiedPair, volume: Uint8s) -> DenseMatches:
    """Disparity of both views from any cost volume (h, w, disparities), uint8, on the scale of `census_costs`."""
    penalties = _jump_penalties(pair.left)
    # the paths from the left and above first, then those from the right and below
    summed = np.zeros(volume.shape, dtype=np.uint16)
    for backward in (False, True):
        _aggregate(volume, penalties, np.uint16(_STEP_PENALTY), backward, summed)
    left, right, confidence1, confidence2 = _best_disparities(summed, pair.disparity_min)
    return DenseMatches(left, right, confidence1, confidence2)


def census_costs(pair: RectifiedPair) -> Uint8s:
    """(h, w, disparities) uint8: Hamming distance, 0 to 62, of the censuses of a pixel and its partner at each disparity."""
    census1 = _census(np.ascontiguousarray(pair.left))
    census2 = _census(np.ascontiguousarray(pair.right))
    count = pair.disparity_max - pair.disparity_min + 1
    return _costs(census1, census2, pair.valid_right, pair.disparity_min, count, np.uint8(_UNKNOWN_COST))


def _jump_penalties(image: Float32s) -> Uint16s:
    """(4, h, w) uint16: penalty of a jump between a pixel and its neighbour to the left, upper left, above, upper right.

    Depth is more likely to jump at an edge of the image (Hirschmueller 2008, equation 13)."""
    height, width = image.shape
    border = np.pad(image, 1, mode="edge")
    penalties = np.empty((4, height, width), dtype=np.uint16)
    for k, (dy, dx) in enumerate(((0, -1), (-1, -1), (-1, 0), (-1, 1))):
        neighbour = border[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]
        penalty = _JUMP_PENALTY / (1 + _GRADIENT_WEIGHT * np.abs(image - neighbour))
        penalties[k] = np.maximum(penalty, _LEAST_JUMP_PENALTY)
    return penalties


@kernel
def _census(image: Float32s) -> Uint64s:
    """(h, w) uint64: one bit for each of the 62 neighbours in a 9x7 window, set where it is darker than the centre."""
    height, width = image.shape
    bits = np.zeros((height, width), dtype=np.uint64)
    for y in range(height):
        for dy in range(-3, 4):
            row = min(max(y + dy, 0), height - 1)
            for dx in range(-4, 5):
                if dx == 0 and dy == 0:
                    continue
                for x in range(width):
                    column = min(max(x + dx, 0), width - 1)
                    bits[y, x] = (bits[y, x] << np.uint64(1)) | np.uint64(image[row, column] < image[y, x])
    return bits


@kernel
def _costs(census1: Uint64s, census2: Uint64s, valid2: Bools, low: int, count: int, unknown_cost: np.uint8) -> Uint8s:
    """(h, w, count) uint8: Hamming distance of the censuses, `unknown_cost` where the partner is invalid or outside the image."""
    height, width = census1.shape
    # masks for counting bits: every second bit, every second pair, every second four, the lowest bit of each byte
    singles = np.uint64(0x5555555555555555)
    pairs = np.uint64(0x3333333333333333)
    fours = np.uint64(0x0F0F0F0F0F0F0F0F)
    ones = np.uint64(0x0101010101010101)
    volume = np.full((height, width, count), unknown_cost, dtype=np.uint8)
    partners = np.empty(width, dtype=np.uint64)
    usable = np.empty(width, dtype=np.bool_)
    for y in range(height):
        # reversed: in the order of increasing disparity
        for x in range(width):
            partners[x] = census2[y, width - 1 - x]
            usable[x] = valid2[y, width - 1 - x]
        for x in range(width):
            # disparities whose partner lies in the right image
            first = max(0, x - low - width + 1)
            last = min(count, x - low + 1)
            if first >= last:
                continue
            own = census1[y, x]
            start = width - 1 - (x - low - first)
            candidates = partners[start:]
            matchable = usable[start:]
            costs = volume[y, x, first:last]
            for k in range(last - first):
                # the number of ones: summed in pairs, fours and bytes, and the bytes by a multiplication (Warren, Hacker's
                # Delight, section 5-1); numba has no instruction for it
                v = own ^ candidates[k]
                v = v - ((v >> np.uint64(1)) & singles)
                v = (v & pairs) + ((v >> np.uint64(2)) & pairs)
                v = (v + (v >> np.uint64(4))) & fours
                costs[k] = np.uint8((v * ones) >> np.uint64(56)) if matchable[k] else unknown_cost
    return volume


@kernel
def _advance(
    costs: Uint8s, previous: Uint16s, least: np.uint16, jump: np.uint16, step: np.uint16, current: Uint16s, total: Uint16s
) -> np.uint16:
    """One step along one path; returns the least of `current`.  `previous`, `current`: (count + 2,), sentinels at both ends.

    L(d) = C(d) + min(L'(d), L'(d - 1) + step, L'(d + 1) + step, min L' + jump) - min L', where L' is `previous` and min L' its
    `least` (Hirschmueller 2008, equation 14).
    """
    count = costs.shape[0]
    limit = np.uint16(least + jump)
    smallest = np.uint16(_UNSET)
    for k in range(count):
        unchanged = previous[k + 1]
        shifted = np.uint16(min(previous[k], previous[k + 2]) + step)
        cheapest = min(min(unchanged, shifted), limit)
        value = np.uint16(np.uint16(costs[k]) + np.uint16(cheapest - least))
        current[k + 1] = value
        total[k] = np.uint16(total[k] + value)
        smallest = min(smallest, value)
    return smallest


@kernel
def _aggregate(volume: Uint8s, jump_penalties: Uint16s, step_penalty: np.uint16, backward: bool, summed: Uint16s) -> None:
    """Add four of the eight paths to `summed`: those that come from the left and above, or from the right and below."""
    height, width, count = volume.shape
    sentinel = np.uint16(_SENTINEL)
    # The three paths that come from the row before are kept for two rows, with a column beyond either side of the image, where
    # they start at 0; the path along the row, for two pixels.
    paths = np.full((2, 3, width + 2, count + 2), sentinel, dtype=np.uint16)
    paths[:, :, :, 1 : count + 1] = np.uint16(0)
    least = np.zeros((2, 3, width + 2), dtype=np.uint16)
    row_costs = np.full((2, count + 2), sentinel, dtype=np.uint16)
    for i in range(height):
        y = height - 1 - i if backward else i
        new = i & 1
        old = 1 - new
        row_costs[:, 1 : count + 1] = np.uint16(0)
        row_least = np.uint16(0)
        slot = 0
        for j in range(width):
            x = width - 1 - j if backward else j
            costs = volume[y, x]
            total = summed[y, x]
            # the penalty of a step is stored at the pixel right of or below it
            penalty = jump_penalties[0, y, min(x + 1, width - 1)] if backward else jump_penalties[0, y, x]
            row_least = _advance(costs, row_costs[slot], row_least, penalty, step_penalty, row_costs[1 - slot], total)
            slot = 1 - slot
            for k in range(3):
                if backward:
                    row = min(y + 1, height - 1)
                    column = min(max(x + k - 1, 0), width - 1)
                    penalty = jump_penalties[3 - k, row, column]
                else:
                    penalty = jump_penalties[1 + k, y, x]
                least[new, k, x + 1] = _advance(
                    costs, paths[old, k, x + k], least[old, k, x + k], penalty, step_penalty, paths[new, k, x + 1], total
                )


@kernel
def _best_disparities(summed: Uint16s, low: int) -> tuple[Float32s, Float32s, Float32s, Float32s]:
    """Disparity of least summed cost for both views, and confidence: relative lead over the next best; 1 in the right view."""
    height, width, count = summed.shape
    left = np.empty((height, width), dtype=np.float32)
    right = np.full((height, width), np.nan, dtype=np.float32)
    confidence1 = np.zeros((height, width), dtype=np.float32)
    confidence2 = np.zeros((height, width), dtype=np.float32)
    least2 = np.empty(width, dtype=np.uint16)  # by pixel of the right view, reversed as in `_costs`
    best2 = np.empty(width, dtype=np.int32)  # and its column in the left view
    for y in range(height):
        least2[:] = np.uint16(_UNSET)
        best2[:] = -1
        for x in range(width):
            sums = summed[y, x]
            best, offset, confidence1[y, x] = _best_disparity(sums)
            left[y, x] = low + best + offset
            # every partner of this pixel keeps the cheapest of the left pixels that ask for it
            first = max(0, x - low - width + 1)
            last = min(count, x - low + 1)
            if first >= last:
                continue
            start = width - 1 - (x - low - first)
            candidates = sums[first:last]
            partner_least = least2[start:]
            partner_best = best2[start:]
            for k in range(last - first):
                is_cheaper = candidates[k] < partner_least[k]
                partner_least[k] = candidates[k] if is_cheaper else partner_least[k]
                partner_best[k] = x if is_cheaper else partner_best[k]
        for position in range(width):
            if best2[position] >= 0:
                partner = width - 1 - position
                right[y, partner] = best2[position] - partner
                confidence2[y, partner] = 1.0
    return left, right, confidence1, confidence2


@helper
def _best_disparity(sums: Uint16s) -> tuple[int, float, np.float32]:
    """Index of the least of the summed costs (count,), the fraction to add to it, and its relative lead over the next best, at
    most 1."""
    count = sums.shape[0]
    least = np.uint16(_UNSET)
    for k in range(count):
        least = min(least, sums[k])
    best = 0
    while sums[best] != least:
        best += 1
    # two lines of equal and opposite slope through the three costs: census costs rise linearly on both sides of the minimum
    offset = 0.0
    if 0 < best < count - 1:
        lower = np.float32(sums[best - 1]) - least
        upper = np.float32(sums[best + 1]) - least
        slope = max(lower, upper)
        if slope > 0:
            offset = float(0.5 * (lower - upper) / slope)
    # the neighbours of the best belong to the same minimum
    rival = np.uint16(_UNSET)
    for k in range(best - 1):
        rival = min(rival, sums[k])
    for k in range(best + 2, count):
        rival = min(rival, sums[k])
    lead = (np.float32(rival) - np.float32(least)) / (np.float32(least) + np.float32(1.0))
    return best, offset, min(np.float32(1.0), lead)

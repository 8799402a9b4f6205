"""Slanted PatchMatch from a census SGM start: a plane of disparity for each pixel, spread to neighbours and refined at random.

After Bleyer, Rhemann & Rother (BMVC 2011), with the start and the cost changed: semi-global matching at a fraction of the size
tells where to look, so two sweeps are enough; the cost is 1 - ZNCC of windows weighted by likeness, which exposure does not
change.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from ..kernels import kernel
from ..types import Bools, Float32s
from .census_sgm import match_census_sgm
from .checks import disagreement, fill_along_rows, without_specks
from .pair import DenseMatches, RectifiedPair, halved, mirrored

Scalar = np.float32
Int64s = npt.NDArray[np.int64]

_SWEEPS = 2
_RADIUS, _STRIDE = 3, 2
_LIKENESS = 8.0
"""Grey levels at which a pixel of the window counts half."""

_DEAREST = 0.6
"""Planes that cost more are no matches."""

_VOTERS, _VOTER_STRIDE = 6, 3
"""How far away, in pixels, and how densely neighbours are asked what a pixel's disparity should be."""

_CONFIRMED_PX = 2.0
"""Both views tell the same of a pixel if they differ by no more."""

_DOUBTFUL = 2.6
"""How much the surroundings of a pixel may disagree with its plane, see `_doubt`."""

_DIRECT_PX = 1.0e6
"""Larger pairs start from PatchMatch at half the size, others from SGM at half the size."""

_BEYOND = 0.5
"""Planes may leave the range of disparities by this share of it: they spread to where the start did not look."""


def match_patchmatch(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views to a fraction of a pixel; confidence 1 - cost, 0 where the surroundings speak against it."""
    view1, view2 = _matched_views(pair)
    left, mirrored_right = view1.smoothed(), view2.smoothed()
    right = np.ascontiguousarray(mirrored_right[:, ::-1])
    confidence1 = view1.confidence(left, disagreement(left, right, -1))
    confidence2 = view2.confidence(mirrored_right, np.ascontiguousarray(disagreement(right, left, 1)[:, ::-1]))
    return DenseMatches(left, right, confidence1, np.ascontiguousarray(confidence2[:, ::-1]))


class _View:
    """The planes of one view, which is the left one of its pair, and what they cost.

    planes: (h, w, 3) float32 disparity and its slopes along x and y; cost: (h, w) float32, 0 to 1."""

    def __init__(self, pair: RectifiedPair, coarse_planes: Float32s) -> None:
        self.pair = pair
        self.planes = np.empty((*pair.left.shape, 3), dtype=np.float32)
        _spread(coarse_planes, self.planes)
        self.cost = np.empty(pair.left.shape, dtype=np.float32)

    def sweep(self, sweep: int, proposals: Float32s | None) -> None:
        pair = self.pair
        beyond = _BEYOND * (pair.disparity_max - pair.disparity_min)
        low, high = pair.disparity_min - beyond, pair.disparity_max + beyond
        if proposals is None:
            proposals = np.full_like(self.planes, np.nan)
        _sweep(
            pair.left, pair.right, pair.valid_left, self.planes, self.cost, proposals,
            sweep, Scalar(low), Scalar(high), Scalar(1.5 * 0.6**sweep), Scalar(0.3 * 0.7**sweep),
        )  # fmt: skip

    def smoothed(self) -> Float32s:
        """Disparity (h, w), nan where too costly."""
        return _voted(self.pair.left, self.planes, _smoothed(self.pair.left, self.planes, self.cost, _DEAREST))

    def confidence(self, disparity: Float32s, difference: Float32s) -> Float32s:
        """(h, w), for the smoothed disparity and its difference from what the other view says."""
        doubt = _doubt(disparity, self.planes, difference)
        return np.where(doubt <= _DOUBTFUL, 1 - self.cost, 0).astype(np.float32)

    def seen_from_other(self) -> Float32s:
        return _seen_from_other(self.planes, self.cost)


def _matched_views(pair: RectifiedPair) -> tuple[_View, _View]:
    """The view of the left image, and that of the right one in a mirror."""
    small = halved(pair)
    if pair.left.size > _DIRECT_PX:
        coarse1, coarse2 = (view.planes for view in _matched_views(small))
        sweeps = 1
    else:
        coarse1, coarse2 = _start(small)
        sweeps = _SWEEPS
    views = _View(pair, coarse1), _View(mirrored(pair), coarse2)
    for sweep in range(sweeps):
        proposals = [view.seen_from_other() for view in views[::-1]] if sweep else [None, None]
        for view, proposed in zip(views, proposals, strict=True):
            view.sweep(sweep, proposed)
    return views


def _start(pair: RectifiedPair) -> tuple[Float32s, Float32s]:
    """Planes (h, w, 3) of both views, those of the right one in a mirror, from semi-global matching; holes filled."""
    found = match_census_sgm(pair)
    planes1 = _planes_of(found.left, found.right, pair.valid_left, -1)
    planes2 = _planes_of(found.right, found.left, pair.valid_right, 1)
    return planes1, planes2[:, ::-1] * np.array([1, -1, 1], dtype=np.float32)


def _planes_of(one: Float32s, other: Float32s, valid: Bools, sign: int) -> Float32s:
    agreed = np.where(valid & (disagreement(one, other, sign) <= 1), one, np.float32(np.nan)).astype(np.float32)
    agreed = without_specks(agreed, 60)
    filled = fill_along_rows(agreed, -sign)
    middle = np.nanmedian(agreed) if np.isfinite(agreed).any() else 0.0
    whole = cv2.medianBlur(np.where(np.isnan(filled), middle, filled).astype(np.float32), 5)
    return np.dstack([whole, *_slopes(np.asarray(whole, dtype=np.float32))])


@kernel
def _slopes(disparity: Float32s) -> tuple[Float32s, Float32s]:
    """Slopes (h, w), (h, w) of disparity along x and y: least squares over an 11x11 window at stride 2, without what jumps."""
    height, width = disparity.shape
    along_x = np.zeros((height, width), dtype=np.float32)
    along_y = np.zeros((height, width), dtype=np.float32)
    for y in range(height):
        for x in range(width):
            centre = disparity[y, x]
            xx, yy, xy, xd, yd = 1.0, 1.0, 0.0, 0.0, 0.0
            for dy in range(-5, 6, 2):
                if not 0 <= y + dy < height:
                    continue
                for dx in range(-5, 6, 2):
                    if not 0 <= x + dx < width:
                        continue
                    rise = disparity[y + dy, x + dx] - centre
                    if abs(rise) <= 1.0 + abs(dx) + 3.0 * abs(dy):
                        xx += dx * dx
                        yy += dy * dy
                        xy += dx * dy
                        xd += dx * rise
                        yd += dy * rise
            det = xx * yy - xy * xy
            along_x[y, x] = (xd * yy - yd * xy) / det
            along_y[y, x] = (yd * xx - xd * xy) / det
    return along_x, along_y


@kernel
def _spread(coarse: Float32s, planes: Float32s) -> None:
    """Planes of an image from those of half its size."""
    height, width = planes.shape[:2]
    for y in range(height):
        for x in range(width):
            d, a, b = coarse[y // 2, x // 2]
            planes[y, x, 0] = 2 * d + a * (x % 2 - 0.5) + b * (y % 2 - 0.5)
            planes[y, x, 1] = a
            planes[y, x, 2] = b


@kernel
def _seen_from_other(planes: Float32s, cost: Float32s) -> Float32s:
    """(h, w, 3): planes of one view as the other, mirrored, sees them; nan where none lands, the cheapest where several do."""
    height, width = cost.shape
    seen = np.full((height, width, 3), np.nan, dtype=np.float32)
    cheapest = np.full(width, np.inf, dtype=np.float32)
    for y in range(height):
        cheapest[:] = np.inf
        for x in range(width):
            d, a, b = planes[y, x, 0], planes[y, x, 1], planes[y, x, 2]
            column = np.int64(np.rint(x - d))
            if not 0 <= column < width:
                continue
            there = width - 1 - column
            if cost[y, x] >= cheapest[there]:
                continue
            cheapest[there] = cost[y, x]
            steeper = 1 / (1 - a)
            seen[y, there, 0] = d + a * steeper * (column - (x - d))
            seen[y, there, 1] = -a * steeper
            seen[y, there, 2] = b * steeper
    return seen


@kernel
def _random(state: np.uint64) -> tuple[np.uint64, np.float32]:
    """Next state of a xorshift generator, and its number from -1 to 1."""
    state ^= state << np.uint64(13)
    state ^= state >> np.uint64(7)
    state ^= state << np.uint64(17)
    return state, np.float32(np.int64(state >> np.uint64(40)) * (1.0 / (1 << 23)) - 1.0)


@kernel
def _cost(
    right: Float32s, x: int, y: int, d: Scalar, a: Scalar, b: Scalar, weights: Float32s, pattern: Float32s, spread: Scalar
) -> Scalar:
    """1 - ZNCC of the window around (x, y) and its image under the plane.

    `weights` sum to 1; `pattern` are the weights times the window's grey minus its mean, so that they sum to 0; `spread` is the
    window's deviation."""
    height, width = right.shape
    step = np.float32(1.0) - a
    reach = np.float32(_RADIUS) * abs(step) + np.float32(_RADIUS) * abs(b)
    middle = np.float32(x) - d
    if middle - reach < 0 or middle + reach >= width - 1:
        return np.float32(1.0)
    mean = np.float32(0.0)
    square = np.float32(0.0)
    product = np.float32(0.0)
    k = 0
    for dy in range(-_RADIUS, _RADIUS + 1, _STRIDE):
        row = right[min(max(y + dy, 0), height - 1)]
        base = middle - b * np.float32(dy)
        for dx in range(-_RADIUS, _RADIUS + 1, _STRIDE):
            at = base + np.float32(dx) * step
            i = np.int32(at)
            v = row[i] + (at - np.float32(i)) * (row[i + 1] - row[i])
            w = weights[k]
            mean += w * v
            square += w * v * v
            product += pattern[k] * v
            k += 1
    variance = square - mean * mean
    if variance < np.float32(0.05) or spread < np.float32(0.2236):
        return np.float32(0.9)
    cost = np.float32(1.0) - product / (spread * np.sqrt(variance))
    return min(max(cost, np.float32(0.0)), np.float32(1.0))


@kernel
def _sweep(
    left: Float32s, right: Float32s, valid: Bools, planes: Float32s, cost: Float32s, proposals: Float32s,
    sweep: int, low: Scalar, high: Scalar, amplitude: Scalar, tilt: Scalar,
) -> None:  # fmt: skip
    """One pass over the image, from the upper left or from the lower right.

    Each pixel tries four neighbours' planes, what the other view proposes, then two random changes."""
    height, width = left.shape
    taps = ((2 * _RADIUS) // _STRIDE + 1) ** 2
    weights = np.empty(taps, dtype=np.float32)
    pattern = np.empty(taps, dtype=np.float32)
    forward = sweep % 2 == 0
    o = -1 if forward else 1
    soft = np.float32(1.0 / _LIKENESS)
    for i in range(height):
        y = i if forward else height - 1 - i
        for j in range(width):
            x = j if forward else width - 1 - j
            if not valid[y, x]:
                cost[y, x] = np.float32(1.0)
                continue
            centre = left[y, x]
            total = np.float32(0.0)
            mean = np.float32(0.0)
            k = 0
            for dy in range(-_RADIUS, _RADIUS + 1, _STRIDE):
                row = min(max(y + dy, 0), height - 1)
                for dx in range(-_RADIUS, _RADIUS + 1, _STRIDE):
                    column = min(max(x + dx, 0), width - 1)
                    v = left[row, column]
                    e = (v - centre) * soft
                    w = np.float32(1.0) / (np.float32(1.0) + e * e)
                    if not valid[row, column]:
                        w = np.float32(0.0)
                    weights[k] = w
                    pattern[k] = v
                    total += w
                    mean += w * v
                    k += 1
            mean /= total
            variance = np.float32(0.0)
            for k in range(taps):
                weights[k] /= total
                e = pattern[k] - mean
                variance += weights[k] * e * e
                pattern[k] = weights[k] * e
            spread = np.sqrt(variance)

            d, a, b = planes[y, x, 0], planes[y, x, 1], planes[y, x, 2]
            c = _cost(right, x, y, d, a, b, weights, pattern, spread) if sweep == 0 else cost[y, x]
            for q in range(4):
                if q == 0:
                    dx, dy = o, 0
                elif q == 1:
                    dx, dy = 0, o
                elif q == 2:
                    dx, dy = 3 * o, 2 * o
                else:
                    dx, dy = -3 * o, 3 * o
                column, row = x + dx, y + dy
                if not (0 <= column < width and 0 <= row < height) or not valid[row, column]:
                    continue
                na, nb = planes[row, column, 1], planes[row, column, 2]
                nd = planes[row, column, 0] - na * np.float32(dx) - nb * np.float32(dy)
                if nd < low or nd > high:
                    continue
                if abs(nd - d) < 0.01 and abs(na - a) < 0.002 and abs(nb - b) < 0.002:
                    continue
                nc = _cost(right, x, y, nd, na, nb, weights, pattern, spread)
                if nc < c:
                    c, d, a, b = nc, nd, na, nb
            nd, na, nb = proposals[y, x, 0], proposals[y, x, 1], proposals[y, x, 2]
            if low <= nd <= high and (abs(nd - d) >= 0.01 or abs(na - a) >= 0.002 or abs(nb - b) >= 0.002):
                nc = _cost(right, x, y, nd, na, nb, weights, pattern, spread)
                if nc < c:
                    c, d, a, b = nc, nd, na, nb
            shift, turn = amplitude, tilt
            state = np.uint64(x) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(y) * np.uint64(0xC2B2AE3D27D4EB4F)
            state ^= np.uint64(sweep + 1) * np.uint64(0x165667B19E3779F9)
            state, _ = _random(state | np.uint64(1))
            for _q in range(2):
                state, r1 = _random(state)
                state, r2 = _random(state)
                state, r3 = _random(state)
                nd, na, nb = d + r1 * shift, a + r2 * turn, b + r3 * turn
                shift *= np.float32(0.2)
                turn *= np.float32(0.3)
                if nd < low or nd > high or na > 0.9 or na < -6.0 or abs(nb) > 6.0:
                    continue
                nc = _cost(right, x, y, nd, na, nb, weights, pattern, spread)
                if nc < c:
                    c, d, a, b = nc, nd, na, nb
            planes[y, x, 0], planes[y, x, 1], planes[y, x, 2] = d, a, b
            cost[y, x] = c


@kernel
def _smoothed(image: Float32s, planes: Float32s, cost: Float32s, dearest: float) -> Float32s:
    """(h, w) disparity: the planes' own, corrected by a least-squares plane through what neighbours within 2 px say.

    They must nearly agree, and weigh by likeness."""
    height, width = cost.shape
    out = np.full((height, width), np.nan, dtype=np.float32)
    soft = np.float32(1.0 / _LIKENESS)
    for y in range(height):
        for x in range(width):
            if cost[y, x] >= dearest:
                continue
            d, a, b = planes[y, x, 0], planes[y, x, 1], planes[y, x, 2]
            grey = image[y, x]
            near = 1.5 + 0.7 * (abs(a) + abs(b))  # errors between the rows shift a steep plane the more
            s, sx, sy, sxx, syy, sxy = 0.0, 0.0, 0.0, 2.0, 2.0, 0.0  # 2: slopes stay the plane's own where little speaks
            v, vx, vy = 0.0, 0.0, 0.0
            for row in range(max(y - 2, 0), min(y + 3, height)):
                dy = row - y
                for column in range(max(x - 2, 0), min(x + 3, width)):
                    dx = column - x
                    e = planes[row, column, 0] - (d + a * dx + b * dy)
                    if cost[row, column] >= dearest or abs(e) > near:
                        continue
                    unlike = (image[row, column] - grey) * soft
                    w = 1.0 / (1.0 + unlike * unlike)
                    s += w
                    sx += w * dx
                    sy += w * dy
                    sxx += w * dx * dx
                    syy += w * dy * dy
                    sxy += w * dx * dy
                    v += w * e
                    vx += w * e * dx
                    vy += w * e * dy
            minor = sxx * syy - sxy * sxy
            det = s * minor - sx * (sx * syy - sxy * sy) + sy * (sx * sxy - sxx * sy)
            out[y, x] = d + (v * minor - sx * (vx * syy - sxy * vy) + sy * (vx * sxy - sxx * vy)) / det
    return out


def _sorting_network(count: int) -> Int64s:
    """(m, 2) places to compare, and to exchange where the first is larger, that sort `count` values (Batcher's merge exchange,
    Knuth 5.2.2 M).  No branch depends on the values, so that whole rows of pixels are sorted at once."""
    pairs = []
    for p in (2**i for i in range((count - 1).bit_length())):
        for k in (p >> i for i in range(p.bit_length())):
            for j in range(k % p, count - k, 2 * k):
                pairs += [(i, i + k) for i in range(j, min(j + k, count - k)) if i // (2 * p) == (i + k) // (2 * p)]
    return np.array(pairs, dtype=np.int64)


_VOTES = ((2 * _VOTERS) // _VOTER_STRIDE + 1) ** 2
_NETWORK = _sorting_network(_VOTES)


@kernel
def _voted(image: Float32s, planes: Float32s, disparity: Float32s) -> Float32s:
    """(h, w) disparity: the median of what the planes of neighbours say, each weighted by its likeness.

    A wrong plane, or one of the other side of an edge, is outvoted; slanted surfaces keep their slant."""
    height, width = disparity.shape
    out = np.full((height, width), np.nan, dtype=np.float32)
    votes = np.empty((_VOTES, width), dtype=np.float32)
    weights = np.empty((_VOTES, width), dtype=np.float32)
    total = np.empty(width, dtype=np.float32)
    so_far = np.empty(width, dtype=np.float32)
    soft = np.float32(1.0 / _LIKENESS)
    for y in range(height):
        total[:] = 0.0
        k = 0
        for dy in range(-_VOTERS, _VOTERS + 1, _VOTER_STRIDE):
            row = min(max(y + dy, 0), height - 1)
            for dx in range(-_VOTERS, _VOTERS + 1, _VOTER_STRIDE):
                for x in range(width):
                    column = min(max(x + dx, 0), width - 1)
                    a, b = planes[row, column, 1], planes[row, column, 2]
                    vote = disparity[row, column] - a * np.float32(column - x) - b * np.float32(row - y)
                    unlike = (image[row, column] - image[y, x]) * soft
                    w = np.float32(1.0) / (np.float32(1.0) + unlike * unlike)
                    if np.isnan(vote):
                        vote, w = np.float32(0.0), np.float32(0.0)
                    votes[k, x], weights[k, x] = vote, w
                    total[x] += w
                k += 1
        for q in range(_NETWORK.shape[0]):
            i, j = _NETWORK[q]
            for x in range(width):
                vote1, vote2, w1, w2 = votes[i, x], votes[j, x], weights[i, x], weights[j, x]
                swap = vote1 > vote2
                votes[i, x] = vote2 if swap else vote1
                votes[j, x] = vote1 if swap else vote2
                weights[i, x] = w2 if swap else w1
                weights[j, x] = w1 if swap else w2
        so_far[:] = 0.0
        for k in range(_VOTES):
            for x in range(width):
                before = so_far[x]
                so_far[x] = before + weights[k, x]
                if 2 * before < total[x] and 2 * so_far[x] >= total[x] and not np.isnan(disparity[y, x]):
                    out[y, x] = votes[k, x]
    return out


@kernel
def _doubt(disparity: Float32s, planes: Float32s, difference: Float32s) -> Float32s:
    """(h, w) doubt in each pixel's plane: how far its 5x5 neighbours lie from it on average, the more where disparity is torn.

    Neighbours that the other view does not confirm count as 3 px away: where one is wrong, those beside it are suspect."""
    height, width = disparity.shape
    doubt = np.full((height, width), np.inf, dtype=np.float32)
    for y in range(height):
        for x in range(width):
            if not difference[y, x] <= _CONFIRMED_PX:
                continue
            d, a, b = disparity[y, x], planes[y, x, 1], planes[y, x, 2]
            low, high = d, d
            away = 0.0
            count = 0
            for row in range(max(y - 2, 0), min(y + 3, height)):
                for column in range(max(x - 2, 0), min(x + 3, width)):
                    count += 1
                    if not difference[row, column] <= _CONFIRMED_PX:
                        away += 3.0
                        continue
                    v = disparity[row, column]
                    low, high = min(low, v), max(high, v)
                    away += min(abs(v - d - a * (column - x) - b * (row - y)), 3.0)
            doubt[y, x] = away / count * (1 + 0.15 * (high - low))
    return doubt

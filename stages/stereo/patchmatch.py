"""Slanted PatchMatch from a census SGM start: a plane of disparity for each pixel, spread to neighbours and refined at random.

After Bleyer, Rhemann & Rother (BMVC 2011), with the start and the cost changed: semi-global matching at a fraction of the size
tells where to look, so two rounds of propagation are enough; the cost is 1 - ZNCC of windows weighted by likeness, which exposure
does not change.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..core.jit import kernel
from ..types import Bools, Float32s
from .census import match_census_sgm
from .consistency import cross_checked, disagreement, fill_along_rows
from .matcher import DenseMatches, RectifiedPair, halved, mirrored
from .plane_filter import doubt, smoothed
from .propagation import Propagation, Trials
from .sgbm import match_sgbm

_ROUNDS = 2
_DEAREST = 0.6
"""Planes that cost more are no matches."""
_DOUBTFUL = 2.5
"""How much the surroundings of a pixel may disagree with its plane, see `doubt`."""
_DIRECT_PX = 1.0e6
"""Larger pairs start from PatchMatch at half the size, others from SGM at half the size."""
_LIKELY = 0.1
"""A surface that is likely to be there may cost so much more than what was found."""
_BEYOND = 0.5
"""Planes may leave the range of disparities by this share of it: they spread to where the start did not look."""
_AGAIN = Trials(np.array([(0, 1), (1, 0), (8, 0)]), changes=3, shift_px=0.8, turn=0.2)
"""Where another night shows where to start: that is nearly right, and lies on planes that have been voted on."""
_BLOCK = 128
_XX, _YY, _XY, _XD, _YD = (i * _BLOCK for i in range(5))
"""Places of sums in the scratch of `_slopes`."""


def match_patchmatch(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views to a fraction of a pixel; confidence 1 - cost, 0 where the surroundings speak against it."""
    view1, view2 = _matched_views(pair)
    for view in (view1, view2):
        view.planes = view.smoothed(rounds=2 if pair.reference_left is None else 1)
    left, mirrored_right = view1.planes[0], view2.planes[0]
    mirrored_left, right = (np.ascontiguousarray(disparity[:, ::-1]) for disparity in (left, mirrored_right))
    confidence1, confidence2 = view1.confidence(right), view2.confidence(mirrored_left)
    return DenseMatches(left.copy(), right, confidence1, np.ascontiguousarray(confidence2[:, ::-1]))  # without the slopes


class _View:
    """The planes of one view, which is the left one of its pair, and what they cost.

    planes: (3, h, w) float32 disparity and its slopes along x and y; cost: (h, w) float32, 0 to 1."""

    def __init__(self, pair: RectifiedPair, planes: Float32s) -> None:
        self.pair = pair
        self.planes = planes
        self.cost = np.ones(pair.left.shape, dtype=np.float32)

    def propagation(self) -> Propagation:
        beyond = _BEYOND * (self.pair.disparity_max - self.pair.disparity_min)
        low, high = self.pair.disparity_min - beyond, self.pair.disparity_max + beyond
        return Propagation(self.pair.left, self.pair.right, self.pair.valid_left, low, high)

    def lean_on_prior(self, propagation: Propagation) -> None:
        """Take the likely surface where it shows the other image about as well as what was found: repeated tiles fit at many
        disparities, and bare asphalt at any; and where what was found lies behind the floor."""
        prior = self.pair.prior_left
        if prior is None:
            return
        along_y, along_x = np.gradient(prior)
        planes = np.stack([prior, along_x, along_y]).astype(np.float32)
        cost = propagation.costs(planes)
        known = np.isfinite(planes).all(axis=0)
        likely = known & (cost < _DEAREST) & (cost <= self.cost + _LIKELY)
        if (floor := self.pair.floor_left) is not None:
            likely |= known & ((floor - self.planes[0]) * (prior - floor) > 0)
        self.planes[:, likely] = planes[:, likely]
        self.cost[likely] = cost[likely]

    def smoothed(self, rounds: int) -> Float32s:
        """Planes (3, h, w), nan where too costly."""
        return smoothed(self.pair.left, self.planes, self.cost, _DEAREST, rounds=rounds)

    def settled(self) -> Float32s:
        """Planes (3, h, w) for the next size: the smoothed ones, and its own where those are too costly."""
        planes = self.smoothed(rounds=1)
        return np.where(np.isnan(planes[0]), self.planes, planes)

    def confidence(self, other: Float32s) -> Float32s:
        """(h, w), once the planes are smoothed, for the disparity that the other view says, in the sense of this one's pair."""
        sure = doubt(self.planes, disagreement(self.planes[0], other, -1)) <= _DOUBTFUL
        return np.where(sure, 1 - self.cost, 0).astype(np.float32)


def _matched_views(pair: RectifiedPair) -> tuple[_View, _View]:
    """The view of the left image, and that of the right one in a mirror."""
    if pair.reference_left is not None and pair.reference_right is not None:
        return _matched_again(pair)
    large, small = pair.left.size > _DIRECT_PX, halved(pair)
    views = _matched_views(small) if large else _propagated(small, _as_planes(small, match_census_sgm(small)), 1)
    return _propagated(pair, [_doubled(view.settled(), pair.left.shape) for view in views], 1 if large else _ROUNDS)


def _matched_again(pair: RectifiedPair) -> tuple[_View, _View]:
    """The same where another night shows where to start: a quick search of the whole range at half the size finds what is new,
    and one round settles which of both it is."""
    views = _View(pair, _planes_then(pair)), _View(mirrored(pair), _planes_then(mirrored(pair)))
    small = halved(pair)
    for view, coarse in zip(views, _as_planes(small, match_sgbm(small)), strict=True):
        propagation, searched = view.propagation(), _doubled(coarse, pair.left.shape)
        view.planes = np.where(np.isnan(view.planes), searched, view.planes)
        view.cost = propagation.costs(view.planes)
        propagation.round(0, view.planes, view.cost, searched, _AGAIN)
        view.lean_on_prior(propagation)
    return views


def _planes_then(pair: RectifiedPair) -> Float32s:
    """(3, h, w) planes of the left view as another night knows them, nan where it doesn't."""
    then = pair.reference_left
    assert then is not None
    return np.stack([then, *_slopes(then)])


def _propagated(pair: RectifiedPair, start: Sequence[Float32s], rounds: int) -> tuple[_View, _View]:
    views = _View(pair, start[0]), _View(mirrored(pair), start[1])
    propagations = [view.propagation() for view in views]
    for number in range(rounds):
        proposals = [_seen_from_other(v.planes, v.cost) for v in views[::-1]] if number else [view.planes for view in views]
        for view, propagation, proposed in zip(views, propagations, proposals, strict=True):
            propagation.round(number, view.planes, view.cost, proposed)
            view.lean_on_prior(propagation)
    return views


def _as_planes(pair: RectifiedPair, found: DenseMatches) -> tuple[Float32s, Float32s]:
    """Planes (3, h, w) of both views, those of the right one in a mirror, from what a matcher found; holes filled."""
    planes1 = _planes_of(found.left, found.right, pair.valid_left, -1)
    planes2 = _planes_of(found.right, found.left, pair.valid_right, 1)
    return planes1, planes2[:, :, ::-1] * np.array([[[1]], [[-1]], [[1]]], dtype=np.float32)


def _planes_of(one: Float32s, other: Float32s, valid: Bools, sign: int) -> Float32s:
    agreed = cross_checked(one, other, valid, sign, 60)
    filled = fill_along_rows(agreed, -sign)
    median = np.nanmedian(agreed) if np.isfinite(agreed).any() else 0.0
    whole = cv2.medianBlur(np.where(np.isnan(filled), median, filled).astype(np.float32), 5)
    return np.stack([whole, *_slopes(np.asarray(whole, dtype=np.float32))])


@kernel
def _slopes(disparity: Float32s) -> tuple[Float32s, Float32s]:
    """Slopes (h, w), (h, w) of disparity along x and y: least squares over an 11x11 window at stride 2, without what jumps."""
    height, width = disparity.shape
    along_x = np.zeros((height, width), dtype=np.float32)
    along_y = np.zeros((height, width), dtype=np.float32)
    bordered = np.full((height + 10, width + 10 + _BLOCK), np.nan, dtype=np.float32)
    for y in range(height):
        for x in range(width):
            bordered[y + 5, x + 5] = disparity[y, x]
    s = np.empty(5 * _BLOCK, dtype=np.float64)
    for y in range(height):
        for x0 in range(0, width, _BLOCK):
            n = min(_BLOCK, width - x0)
            centre, known = bordered[y + 5, x0 + 5 :], 0
            for x in range(n):
                known += 0 if np.isnan(centre[x]) else 1
            if known == 0:
                continue
            for x in range(5 * _BLOCK):
                s[x] = 1.0 if x < _XY else 0.0
            for dy in range(-5, 6, 2):
                for dx in range(-5, 6, 2):
                    there = bordered[y + dy + 5, x0 + dx + 5 :]
                    furthest = np.float32(1.0 + abs(dx) + 3.0 * abs(dy))
                    across, down = np.float64(dx), np.float64(dy)
                    for x in range(_BLOCK):
                        rise = there[x] - centre[x]
                        near = abs(rise) <= furthest  # never where it is nan: outside
                        one = np.float64(1.0) if near else np.float64(0.0)
                        up = np.float64(rise) if near else np.float64(0.0)
                        s[_XX + x] += across * across * one
                        s[_YY + x] += down * down * one
                        s[_XY + x] += across * down * one
                        s[_XD + x] += across * up
                        s[_YD + x] += down * up
            for x in range(n):
                xx, yy, xy, xd, yd = s[_XX + x], s[_YY + x], s[_XY + x], s[_XD + x], s[_YD + x]
                det = xx * yy - xy * xy
                along_x[y, x0 + x] = (xd * yy - yd * xy) / det
                along_y[y, x0 + x] = (yd * xx - xd * xy) / det
    return along_x, along_y


def _doubled(coarse: Float32s, shape: tuple[int, int]) -> Float32s:
    """Planes (3, h, w) of an image of this shape from those of half its size."""
    planes = np.repeat(np.repeat(coarse, 2, axis=1), 2, axis=2)[:, : shape[0], : shape[1]].astype(np.float64)
    y, x = (np.arange(side) % 2 - 0.5 for side in shape)
    planes[0] = 2 * planes[0] + planes[1] * x + planes[2] * y[:, None]
    return planes.astype(np.float32)


@kernel
def _seen_from_other(planes: Float32s, cost: Float32s) -> Float32s:
    """(3, h, w): planes of one view as the other, mirrored, sees them; nan where none lands, the cheapest where several do."""
    height, width = cost.shape
    seen = np.full((3, height, width), np.nan, dtype=np.float32)
    cheapest = np.full(width, np.inf, dtype=np.float32)
    for y in range(height):
        cheapest[:] = np.inf
        for x in range(width):
            d, a, b = planes[0, y, x], planes[1, y, x], planes[2, y, x]
            column = np.int64(np.rint(x - d))
            if not 0 <= column < width:
                continue
            there = width - 1 - column
            if cost[y, x] >= cheapest[there]:
                continue
            cheapest[there] = cost[y, x]
            steeper = 1 / (1 - a)
            seen[0, y, there] = d + a * steeper * (column - (x - d))
            seen[1, y, there] = -a * steeper
            seen[2, y, there] = b * steeper
    return seen

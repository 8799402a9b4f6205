"""Slanted PatchMatch from a census SGM start: a disparity plane for each pixel, spread to neighbours and refined at random.

After Bleyer, Rhemann & Rother (BMVC 2011), with another start and another cost.  Semi-global matching at a fraction of the size
provides the start, so that two rounds of propagation are enough.  The cost is 1 - ZNCC over windows whose pixels are weighted
by similarity to the centre; it does not depend on exposure.
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
from .plane_filter import plane_deviation, smoothed
from .propagation import Propagation, Trials
from .sgbm import match_sgbm

_ROUNDS = 2
"""Rounds of propagation at full size after a start from semi-global matching; a third one finds hardly anything."""
_MOST_COST = 0.6
"""Planes with a higher cost (1 - ZNCC) are no matches; larger values keep more pixels and more wrong ones."""
_MOST_DEVIATION = 2.5
"""Confidence is 0 where the `plane_deviation` of a pixel exceeds this, pixels."""
_DIRECT_PX = 1.0e6
"""Pairs with more pixels than this start from PatchMatch at half the size, smaller ones from SGM at half the size."""
_PRIOR_ADVANTAGE = 0.1
"""The prior surface replaces a found plane if its cost is higher by at most this much."""
_RANGE_MARGIN = 0.5
"""Planes may leave the disparity range by this share of its width, since they spread to where the start did not search."""
_REFERENCE_TRIALS = Trials(np.array([(0, 1), (1, 0), (8, 0)]), changes=3, shift_px=0.8, turn=0.2)
"""Trials where another night provides the start: its planes are nearly right, and already smoothed."""
_SPECKLE_PX = 60
"""Connected pieces of the start with fewer pixels are dropped: they match anywhere."""
_SLOPE_RADIUS = 5
"""Radius of the window to which slopes are fitted, pixels; larger values smooth them."""
_SLOPE_STRIDE = 2
"""Distance between the pixels of that window that are used."""
_BLOCK = 128
"""Pixels of a row that are processed at once, so that the compiler can use SIMD instructions."""

# Rows of the scratch array of `_slopes`: sums over the neighbours at (x, y) from the pixel, whose disparity is higher by d.
_XX = 0 * _BLOCK  # of x^2
_YY = 1 * _BLOCK  # of y^2
_XY = 2 * _BLOCK  # of x y
_XD = 3 * _BLOCK  # of x d
_YD = 4 * _BLOCK  # of y d
_SUMS = 5 * _BLOCK


def match_patchmatch(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views to a fraction of a pixel; confidence is 1 - cost, and 0 where surrounding planes disagree."""
    view1, view2 = _matched_views(pair)
    # another night's disparity was smoothed then
    rounds = 2 if pair.reference_left is None else 1
    view1.planes = view1.smoothed(rounds)
    view2.planes = view2.smoothed(rounds)
    left = view1.planes[0].copy()  # a copy frees the slopes
    right = _mirrored_image(view2.planes[0])
    confidence1 = view1.confidence(right)
    confidence2 = view2.confidence(_mirrored_image(left))  # view 2 sees everything mirrored
    return DenseMatches(left, right, confidence1, _mirrored_image(confidence2))


def _mirrored_image(image: Float32s) -> Float32s:
    return np.ascontiguousarray(image[:, ::-1])


class _View:
    """The planes of one view, which is the left one of its pair, and their costs.

    planes: (3, h, w) float32 disparity and its slopes along x and y; cost: (h, w) float32, 0 to 1."""

    def __init__(self, pair: RectifiedPair, planes: Float32s) -> None:
        self.pair = pair
        self.planes = planes
        self.cost = np.ones(pair.left.shape, dtype=np.float32)

    def propagation(self) -> Propagation:
        """Propagation over this view; planes may leave the disparity range by a margin."""
        margin = _RANGE_MARGIN * (self.pair.disparity_max - self.pair.disparity_min)
        low = self.pair.disparity_min - margin
        high = self.pair.disparity_max + margin
        return Propagation(self.pair.left, self.pair.right, self.pair.valid_left, low, high)

    def prefer_prior(self, propagation: Propagation) -> None:
        """Use the prior surface where it costs little more than the planes found, since repeated tiles match at many disparities
        and bare asphalt at any; and where the planes found lie behind the floor."""
        prior = self.pair.prior_left
        if prior is None:
            return
        along_y, along_x = np.gradient(prior)
        planes = np.stack([prior, along_x, along_y]).astype(np.float32)
        cost = propagation.costs(planes)
        known = np.isfinite(planes).all(axis=0)
        preferred = known & (cost < _MOST_COST) & (cost <= self.cost + _PRIOR_ADVANTAGE)
        floor = self.pair.floor_left
        if floor is not None:
            # the plane found and the prior lie on different sides of the floor: one is nearer, so the other is behind it
            is_behind = (floor - self.planes[0]) * (prior - floor) > 0
            preferred |= known & is_behind
        self.planes[:, preferred] = planes[:, preferred]
        self.cost[preferred] = cost[preferred]

    def smoothed(self, rounds: int) -> Float32s:
        """Smoothed planes (3, h, w), nan where the cost is too high."""
        return smoothed(self.pair.left, self.planes, self.cost, _MOST_COST, rounds=rounds)

    def starting_planes(self) -> Float32s:
        """Planes (3, h, w) from which the next size starts: smoothed, or as found where the cost is too high."""
        planes = self.smoothed(rounds=1)
        return np.where(np.isnan(planes[0]), self.planes, planes)

    def confidence(self, other: Float32s) -> Float32s:
        """(h, w) confidence of smoothed planes, given the `other` view's disparity in the orientation of this view's pair."""
        difference = disagreement(self.planes[0], other, -1)
        reliable = plane_deviation(self.planes, difference) <= _MOST_DEVIATION
        return np.where(reliable, 1 - self.cost, 0).astype(np.float32)


def _matched_views(pair: RectifiedPair) -> tuple[_View, _View]:
    """Matched views: of the left image, and of the right image, which is the left one of the mirrored pair."""
    if pair.reference_left is not None and pair.reference_right is not None:
        return _matched_from_reference(pair)
    small = halved(pair)
    if pair.left.size > _DIRECT_PX:
        # a start from PatchMatch is nearly right, so that one round is enough
        small_views = _matched_views(small)
        rounds = 1
    else:
        small_views = _propagated(small, _as_planes(small, match_census_sgm(small)), 1)
        rounds = _ROUNDS
    start = [_doubled(view.starting_planes(), pair.left.shape) for view in small_views]
    return _propagated(pair, start, rounds)


def _matched_from_reference(pair: RectifiedPair) -> tuple[_View, _View]:
    """Matched views, started from another night's disparity: SGM over the whole range at half the size finds what is new, and one
    round of PatchMatch chooses between the two."""
    views = _View(pair, _planes_of_reference(pair)), _View(mirrored(pair), _planes_of_reference(mirrored(pair)))
    small = halved(pair)
    for view, coarse in zip(views, _as_planes(small, match_sgbm(small)), strict=True):
        propagation = view.propagation()
        new_planes = _doubled(coarse, pair.left.shape)
        view.planes = np.where(np.isnan(view.planes), new_planes, view.planes)
        view.cost = propagation.costs(view.planes)
        propagation.round(0, view.planes, view.cost, new_planes, _REFERENCE_TRIALS)
        view.prefer_prior(propagation)
    return views


def _planes_of_reference(pair: RectifiedPair) -> Float32s:
    """(3, h, w) planes of the left view by the other night's disparity, nan where it had none."""
    reference = pair.reference_left
    assert reference is not None
    return np.stack([reference, *_slopes(reference)])


def _propagated(pair: RectifiedPair, start: Sequence[Float32s], rounds: int) -> tuple[_View, _View]:
    """Both views after some rounds of propagation from the `start`: planes (3, h, w) of the left and the mirrored right view."""
    view1 = _View(pair, start[0])
    view2 = _View(mirrored(pair), start[1])
    propagation1 = view1.propagation()
    propagation2 = view2.propagation()
    for number in range(rounds):
        # the first round evaluates the start; later ones try what the other view found, before either view changes
        proposals1 = view1.planes
        proposals2 = view2.planes
        if number > 0:
            proposals1 = _in_other_view(view2.planes, view2.cost)
            proposals2 = _in_other_view(view1.planes, view1.cost)
        propagation1.round(number, view1.planes, view1.cost, proposals1)
        view1.prefer_prior(propagation1)
        propagation2.round(number, view2.planes, view2.cost, proposals2)
        view2.prefer_prior(propagation2)
    return view1, view2


def _as_planes(pair: RectifiedPair, matches: DenseMatches) -> tuple[Float32s, Float32s]:
    """Planes (3, h, w) of both views from a matcher's disparity, with holes filled; the right view's are mirrored."""
    planes1 = _planes_of(matches.left, matches.right, pair.valid_left, -1)
    planes2 = _planes_of(matches.right, matches.left, pair.valid_right, 1)
    # mirroring turns the slope along x around
    signs = np.array([1, -1, 1], dtype=np.float32)[:, None, None]
    return planes1, planes2[:, :, ::-1] * signs


def _planes_of(disparity: Float32s, other_disparity: Float32s, valid: Bools, sign: int) -> Float32s:
    """Planes (3, h, w) of one view from its `disparity` where the other view agrees; elsewhere, that of the pixels around."""
    agreed = cross_checked(disparity, other_disparity, valid, sign, _SPECKLE_PX)
    filled = fill_along_rows(agreed, -sign)
    # rows without any value get the median of all
    median = 0.0
    if np.isfinite(agreed).any():
        median = float(np.nanmedian(agreed))
    complete = np.where(np.isnan(filled), median, filled).astype(np.float32)
    smooth = np.asarray(cv2.medianBlur(complete, 5), dtype=np.float32)
    return np.stack([smooth, *_slopes(smooth)])


@kernel
def _slopes(disparity: Float32s) -> tuple[Float32s, Float32s]:
    """Slopes (h, w), (h, w) of disparity along x and y: least squares over an 11x11 window at stride 2, without jumps.

    The fitted plane goes through the pixel's own disparity, so that two normal equations are left:
    xx a + xy b = xd and xy a + yy b = yd."""
    height, width = disparity.shape
    along_x = np.zeros((height, width), dtype=np.float32)
    along_y = np.zeros((height, width), dtype=np.float32)
    # a whole block beyond the right edge, so that blocks are always complete
    bordered = np.full((height + 2 * _SLOPE_RADIUS, width + 2 * _SLOPE_RADIUS + _BLOCK), np.nan, dtype=np.float32)
    for y in range(height):
        for x in range(width):
            bordered[y + _SLOPE_RADIUS, x + _SLOPE_RADIUS] = disparity[y, x]
    sums = np.empty(_SUMS, dtype=np.float64)
    for y in range(height):
        row = y + _SLOPE_RADIUS
        for x0 in range(0, width, _BLOCK):
            n = min(_BLOCK, width - x0)
            column = x0 + _SLOPE_RADIUS
            centre = bordered[row, column:]
            known = 0
            for x in range(n):
                known += 0 if np.isnan(centre[x]) else 1
            if known == 0:
                continue
            # xx and yy start at 1 instead of 0: with few neighbours, slopes stay near 0
            for x in range(_SUMS):
                sums[x] = 1.0 if x < _XY else 0.0
            for dy in range(-_SLOPE_RADIUS, _SLOPE_RADIUS + 1, _SLOPE_STRIDE):
                for dx in range(-_SLOPE_RADIUS, _SLOPE_RADIUS + 1, _SLOPE_STRIDE):
                    neighbours = bordered[row + dy, column + dx :]
                    # larger rises are jumps; ground seen at a low angle rises more from row to row than along a row
                    most_rise = np.float32(1.0 + abs(dx) + 3.0 * abs(dy))
                    across = np.float64(dx)
                    down = np.float64(dy)
                    for x in range(_BLOCK):
                        rise = neighbours[x] - centre[x]
                        is_near = abs(rise) <= most_rise  # False for nan, as outside the image
                        weight = np.float64(1.0) if is_near else np.float64(0.0)
                        weighted_rise = np.float64(rise) if is_near else np.float64(0.0)
                        sums[_XX + x] += across * across * weight
                        sums[_YY + x] += down * down * weight
                        sums[_XY + x] += across * down * weight
                        sums[_XD + x] += across * weighted_rise
                        sums[_YD + x] += down * weighted_rise
            for x in range(n):
                xx = sums[_XX + x]
                yy = sums[_YY + x]
                xy = sums[_XY + x]
                xd = sums[_XD + x]
                yd = sums[_YD + x]
                det = xx * yy - xy * xy
                along_x[y, x0 + x] = (xd * yy - yd * xy) / det
                along_y[y, x0 + x] = (yd * xx - xd * xy) / det
    return along_x, along_y


def _doubled(coarse: Float32s, shape: tuple[int, int]) -> Float32s:
    """Planes (3, h, w) for an image of this shape from the planes of the half-size image."""
    height, width = shape
    planes = np.repeat(np.repeat(coarse, 2, axis=1), 2, axis=2)[:, :height, :width].astype(np.float64)
    # Pixel centres lie half a pixel of the doubled image beside those of the half-size one; a slope is the same at both sizes.
    x = np.arange(width) % 2 - 0.5
    y = np.arange(height) % 2 - 0.5
    planes[0] = 2 * planes[0] + planes[1] * x + planes[2] * y[:, None]
    return planes.astype(np.float32)


@kernel
def _in_other_view(planes: Float32s, cost: Float32s) -> Float32s:
    """(3, h, w) planes of one view in the other, mirrored one; nan where none lands, the cheapest where several do.

    On the plane d(x) = d + a (x - x0), the partner moves by 1 - a when x moves by 1, so that slopes are divided by 1 - a."""
    height, width = cost.shape
    transferred = np.full((3, height, width), np.nan, dtype=np.float32)
    cheapest = np.full(width, np.inf, dtype=np.float32)
    for y in range(height):
        cheapest[:] = np.inf
        for x in range(width):
            d = planes[0, y, x]
            a = planes[1, y, x]
            b = planes[2, y, x]
            column = np.int64(np.rint(x - d))
            if not 0 <= column < width:
                continue
            mirrored_column = width - 1 - column
            if cost[y, x] >= cheapest[mirrored_column]:
                continue
            cheapest[mirrored_column] = cost[y, x]
            stretch = 1 / (1 - a)
            # the disparity at the whole column next to the partner; the sign of the slope along x turns with the mirror
            transferred[0, y, mirrored_column] = d + a * stretch * (column - (x - d))
            transferred[1, y, mirrored_column] = -a * stretch
            transferred[2, y, mirrored_column] = b * stretch
    return transferred

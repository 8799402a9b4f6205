"""Textureless surfaces on planes: a patch of plaster, asphalt or snow gives no reliable depth, but a whole wall of it does.

Where there is hardly any texture, a patch matches by its noise, and next to a window by the window: depths scatter about the
surface by several times the expected sigma.  A plane through the depths of a whole textureless region (`mvs.textureless`)
averages their errors.  It is used where enough depths define it, unless the photographs contradict it.

References
----------
Planes as priors that the photographs can override: Xu, Tao, Planar Prior Assisted PatchMatch Multi-View Stereo, AAAI 2020 (ACMP).
Pixels judged by reliable ones on the same surface: Wang et al., Adaptive Patch Deformation for Textureless-Resilient Multi-View
Stereo, CVPR 2023 (APD).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from ..types import Bools, Float32s, Frame, Int32s, Uint32s
from .kernels import Support
from .propagation import Propagation
from .textureless import NEAR_PX, RegionPlane, from_middle, planes_of_regions, textureless_regions

_WINDOW_PX = 25
"""Half the side of the window, pixels of an image 768 wide, over which costs and supporting depths of a plane are averaged."""

_MOST_SIGMA_PX = 0.5
"""Largest standard deviation of a plane where it is used, pixels of a source, without `_SHARED_PX`."""

_SHARED_PX = 0.2
"""Standard deviation of the error that all depths of a plane have in common, pixels of a source."""

_RELIEF_COST = 0.045
"""Planes whose mean cost exceeds that of the depths they would replace by more than this are not used: the surface has relief.
Measured: 95 % of the textureless ones in the demo's weak yard cost less than 0.03 more; waves of 1.5 pixels cost 0.06 more, a
tank's flank 0.2."""

_FEWEST_SOURCES = 2.0
"""Mean number of sources that must see the depths nearby for a plane to replace a sure depth: the error of a single source,
calibration included, is common to all its depths."""

_CHANCE_PX = 0.42
"""Fewer sources suffice if depths scatter about their plane by more than this, in pixels of the sources that see them: more than
such a source errs as a whole.  (With a short baseline, little noise in pixels already makes much scatter in depth.)"""

_STEEP_PX = 0.7
"""Depths are not `chance` where inverse depth changes by more than this per pixel, pixels of a source: twice the match error."""


@dataclass(frozen=True)
class _Laid:
    """The planes of a view, (h, w) each but the first, written region by region."""

    planes: Float32s
    """(3, h, w), in pixels of a source; nan for none."""
    sigma: Float32s
    """Standard deviation of the planes."""
    anchors: Bools
    """Depths that support the plane of their region."""
    spread: Float32s
    """Standard deviation of single depths about the plane."""


@dataclass(frozen=True)
class PlanePriors:
    """Result for textureless surfaces, (h, w) each."""

    sigma: Float32s
    """Standard deviation of the inverse depths that were put on planes, nan elsewhere."""
    chance: Bools
    """Depths on no plane that were matched by chance, and therefore lie off the surface."""


def apply_plane_priors(
    frame: Frame,
    propagation: Propagation,
    planes: Float32s,
    support: Support,
    sure: Bools,
    scale: np.float32,
    max_cost: float,
) -> PlanePriors:
    """Put textureless surfaces on planes of many pixels; changes `planes` and the sources of `support` in place.

    Parameters
    ----------
    frame : the view's frame.
    propagation, planes, support : of the view: (3, h, w) planes, and the sources' evidence for them.
    sure : (h, w), True for reliable depths.
    scale : pixels in a source per unit of inverse depth.
    max_cost : a source sees a plane that costs less.
    """
    spacing = max(1, round(max(sure.shape) / 768))
    # 1. Fit planes to the sure depths of each textureless region, and lay them over the regions.
    regions = textureless_regions(frame.image, frame.mask, spacing)
    known = np.where(sure, scale * planes[0], np.float32(np.nan))
    region_planes = planes_of_regions(regions, known, spacing)
    laid = _laid_planes(regions, region_planes, known)
    replaced = np.isfinite(laid.sigma) & (laid.planes[0] > 0)

    # 2. Let the photographs contradict them, except in gaps, which are always filled: a sure depth is replaced only if the plane
    #    shows no relief, and if more than one source's error, or mere noise, speaks for the plane.
    if replaced.any():
        trial = np.where(replaced, laid.planes / scale, np.float32(np.nan))
        trial_support = propagation.support(trial, max_cost)
        sources, mean_sources = _sources_nearby(laid.anchors, support.sources, propagation.sources, spacing)
        replaced &= ~sure | ~_shows_relief(trial_support, support, replaced & sure, spacing)
        replaced &= ~sure | (mean_sources >= _FEWEST_SOURCES) | _noisy(laid, support, scale, spacing)
        planes[:, replaced] = trial[:, replaced]
        own_sources = np.where(sure, support.sources, np.uint32(0))
        support.sources[replaced] = (sources | trial_support.sources | own_sources)[replaced]
    sigma = np.where(replaced, laid.sigma / scale, np.float32(np.nan)).astype(np.float32)

    # 3. Depths that no plane covers are doubted, but not where an error shifts them along the surface by a pixel at most.
    steep = scale * np.hypot(planes[1], planes[2]) > _STEEP_PX
    chance = _doubted(regions, region_planes) & ~replaced & ~steep
    return PlanePriors(sigma, chance)


def _laid_planes(regions: Int32s, region_planes: Sequence[RegionPlane], known: Float32s) -> _Laid:
    """The planes of a view's textureless regions.  known: (h, w) inverse depths in pixels of a source, nan for none."""
    nan = np.full((4, *known.shape), np.nan, np.float32)
    laid = _Laid(nan[:3], nan[3], np.zeros(known.shape, bool), np.zeros(known.shape, np.float32))
    for plane in region_planes:
        in_regions = np.isin(regions, plane.regions)
        y, x = np.nonzero(in_regions)
        rows = slice(y.min(), y.max() + 1)
        columns = slice(x.min(), x.max() + 1)
        _lay_plane(laid, plane, (rows, columns), in_regions[rows, columns], known[rows, columns])
    return laid


def _lay_plane(laid: _Laid, plane: RegionPlane, box: tuple[slice, slice], in_regions: Bools, known: Float32s) -> None:
    """Use a plane at those pixels of its regions (`in_regions`) where its sigma is small, and smaller than an earlier plane's."""
    # 1. Value and sigma of the plane at each pixel.
    y, x = np.mgrid[box]
    position = from_middle(x.ravel(), y.ravel(), laid.sigma.shape)
    value = (position @ plane.plane).reshape(in_regions.shape)
    sigma = np.sqrt(plane.variance(position).reshape(in_regions.shape) + _SHARED_PX**2)
    replaced = in_regions & (sigma <= np.hypot(_MOST_SIGMA_PX, _SHARED_PX)) & ~(laid.sigma[box] <= sigma)

    # 2. Write them: inverse depth and its slopes along x and y.
    for layer, values in zip(laid.planes, (value, plane.plane[1], plane.plane[2]), strict=True):
        layer[box] = np.where(replaced, values, layer[box])
    laid.sigma[box] = np.where(replaced, sigma, laid.sigma[box])
    laid.spread[box] = np.where(replaced, plane.spread, laid.spread[box])
    with np.errstate(invalid="ignore"):  # nan where no depth is known
        laid.anchors[box] |= replaced & (np.abs(known - value) <= NEAR_PX)


def _sources_nearby(anchors: Bools, sources: Uint32s, count: int, spacing: int) -> tuple[Uint32s, Float32s]:
    """(h, w) bits of the sources that see anchors nearby, and the mean number of sources that see an anchor."""
    anchored = np.maximum(_window_sums(anchors, spacing), 1)
    bits = np.zeros(anchors.shape, np.uint32)
    mean_sources = np.zeros(anchors.shape, np.float32)
    for k in range(count):
        bit = np.uint32(1 << k)
        share = _window_sums(anchors & ((sources & bit) > 0), spacing) / anchored
        bits[share > 0] |= bit
        mean_sources += share
    return bits, mean_sources


def _shows_relief(trial_support: Support, support: Support, mask: Bools, spacing: int) -> Bools:
    """(h, w): do planes cost more than the depths nearby that they would replace, both in the best source and in the second best?
    A single source may fit by chance.  Where no second source sees the depth, only the best one counts."""
    # costs above 1 (unseen) count as 1, that of no correlation
    first = np.minimum(trial_support.first, 1) - np.minimum(support.first, 1)
    second = np.minimum(trial_support.second, 1) - np.minimum(support.second, 1)
    no_second_source = np.minimum(trial_support.second, support.second) >= 1
    second = np.where(no_second_source, first, second)
    # sums are compared instead of means, so that nothing is divided by the number of pixels
    limit = _RELIEF_COST * _window_sums(mask, spacing)
    first_sum = _window_sums(np.where(mask, first, np.float32(0)), spacing)
    second_sum = _window_sums(np.where(mask, second, np.float32(0)), spacing)
    return np.asarray(np.minimum(first_sum, second_sum) > limit)


def _noisy(laid: _Laid, support: Support, scale: np.float32, spacing: int) -> Bools:
    """(h, w): do single depths scatter by more than one source errs as a whole (`_CHANCE_PX`)?"""
    # mean parallax of the anchors nearby, as a share of `scale`
    parallax = _window_sums(np.where(laid.anchors, np.sqrt(support.parallax), np.float32(0)), spacing)
    parallax /= scale * np.maximum(_window_sums(laid.anchors, spacing), 1)
    with np.errstate(invalid="ignore"):  # where no depth nearby supports a plane
        return laid.spread * parallax > _CHANCE_PX


def _doubted(regions: Int32s, region_planes: Sequence[RegionPlane]) -> Bools:
    """(h, w): textureless regions without a plane that is reliable in their middle."""
    unreliable = np.arange(regions.max() + 1) > 0
    boxes = ndimage.find_objects(regions)  # of region k at k - 1
    for plane in region_planes:
        for k in plane.regions:
            rows, columns = boxes[k - 1]
            y = np.array([(rows.start + rows.stop) // 2])
            x = np.array([(columns.start + columns.stop) // 2])
            variance = plane.variance(from_middle(x, y, regions.shape))[0]
            if variance <= _MOST_SIGMA_PX**2:
                unreliable[k] = False
    return unreliable[regions]


def _window_sums(values: Bools | Float32s, spacing: int) -> Float32s:
    """(h, w) sums over the window around each pixel."""
    side = 2 * _WINDOW_PX * spacing + 1
    sums = cv2.boxFilter(values.astype(np.float32), -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(sums, dtype=np.float32)

"""Even regions whose own depths tell nothing, put on the planes of those around them where the photographs see them there.

A piece of plaster between windows matches by its noise and by their reveals: its depths scatter by more than a pixel, or all lie
off by some, and tell a plane that leans or none.  Single patches say little of it, but what a plane costs in the mean over the
region does: that of the wall around costs no more than the depths found, and no more than itself moved to either side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..types import Bools, Float32s, Float64s
from .propagation import Propagation, Support
from .textureless import RegionPlane, TexturelessRegions, from_middle

SURE_PX = 0.5
"""Standard deviation of a plane where it is taken, at most."""

_BESIDE = 50
"""So far around a region, pixels of an image 768 wide, planes are looked for..."""

_ENOUGH = 400
"""...that have so many pixels there."""

_ASIDE_PX = 2.0
"""A plane is compared with itself moved by so much..."""

_CLEARLY, _AS_FOUND = 0.02, 0.05
"""...which may cost less by no more than this, and the depths found by no more than that."""


@dataclass(frozen=True)
class CheckedPlanes:
    """What was put on planes by sight, (h, w) each but the first."""

    planes: Float32s
    """(3, h, w), in pixels of a source; nan for none."""
    sigma: Float32s
    """Their standard deviation."""
    doubted: Bools
    """Regions whose depths tell nothing, whether they were put on a plane or not."""


def checked_planes(
    regions: TexturelessRegions, found: Sequence[RegionPlane], propagation: Propagation, support: Support, sure: Bools,
    scale: np.float32, max_cost: float, spacing: int,
) -> CheckedPlanes:  # fmt: skip
    """Put doubtful regions of a picture on the planes of those around them.

    Parameters
    ----------
    regions, found : of the picture, and the planes that its depths tell.
    propagation, support, sure, scale, max_cost : see `mvs.plane_prior.apply_plane_priors`.
    spacing : pixels for each of an image 768 wide.
    """
    shape = regions.number.shape
    doubtful = np.ones(len(regions.thick), bool)
    doubtful[0] = False
    boxes = ndimage.find_objects(regions.number)
    for plane in found:
        for k in plane.regions:
            if plane.variance(_middle(boxes[k - 1], shape))[0] <= SURE_PX**2:
                doubtful[k] = False
    nan = np.full((4, *shape), np.nan, np.float32)
    checked = CheckedPlanes(nan[:3], nan[3], doubtful[regions.number])
    tried = []
    for k in np.flatnonzero(doubtful).tolist():
        beside = _around(regions, boxes[k - 1], found, spacing)
        if beside is not None:
            tried.append(k)
            _put(checked, beside, boxes[k - 1], regions.number[boxes[k - 1]] == k)
    if tried:
        seen = _seen(regions, checked.planes, propagation, support, sure, scale, max_cost)
        unseen = ~np.isin(regions.number, [k for k in tried if seen[k]])
        checked.planes[:, unseen] = np.nan
        checked.sigma[unseen] = np.nan
    return checked


def _middle(box: tuple[slice, slice], shape: tuple[int, ...]) -> Float64s:
    y, x = (np.array([(along.start + along.stop) // 2]) for along in box)
    return from_middle(x, y, shape)


def _around(
    regions: TexturelessRegions, box: tuple[slice, slice], planes: Sequence[RegionPlane], spacing: int
) -> RegionPlane | None:
    """The plane that has most pixels around a region, if it is sure in the region."""
    reach = _BESIDE * spacing
    rows, columns = (slice(max(0, along.start - reach), along.stop + reach) for along in box)
    count = np.bincount(regions.number[rows, columns].ravel(), minlength=len(regions.thick))
    middle = _middle(box, regions.number.shape)
    having = [(int(count[list(plane.regions)].sum()), -i) for i, plane in enumerate(planes)]
    having = [(n, i) for n, i in having if n >= _ENOUGH * spacing**2 and planes[-i].variance(middle)[0] <= SURE_PX**2]
    return planes[-max(having)[1]] if having else None


def _put(checked: CheckedPlanes, plane: RegionPlane, box: tuple[slice, slice], mine: Bools) -> None:
    y, x = np.nonzero(mine)
    y, x = y + box[0].start, x + box[1].start
    at = from_middle(x, y, checked.sigma.shape)
    for layer, values in zip(checked.planes, (at @ plane.plane, plane.plane[1], plane.plane[2]), strict=True):
        layer[y, x] = values
    checked.sigma[y, x] = np.sqrt(plane.variance(at))


def _seen(
    regions: TexturelessRegions, planes: Float32s, propagation: Propagation, support: Support, sure: Bools, scale: np.float32,
    max_cost: float,
) -> Bools:  # fmt: skip
    """(regions + 1,): do the photographs show the region on its plane, in the mean?"""
    there = np.isfinite(planes[0])
    number = regions.number[there]
    count = np.maximum(np.bincount(number, minlength=len(regions.thick)), 1)

    def mean(cost: Float32s) -> Float64s:
        return np.bincount(number, np.minimum(cost[there], 1), len(regions.thick)) / count

    def moved(by: float) -> Float64s:
        trial = planes / scale
        trial[0] += np.float32(by) / scale
        return mean(propagation.support(trial, max_cost).first)

    here = moved(0.0)
    as_found = mean(np.where(sure, support.first, np.float32(max_cost)).astype(np.float32))
    aside = np.minimum(moved(-_ASIDE_PX), moved(_ASIDE_PX))
    return np.asarray((here <= as_found + _AS_FOUND) & (here <= aside + _CLEARLY), dtype=bool)

"""The ground that a change covers, and how high it stands there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import ndimage

from ..core.ground_grid import cells_of
from ..types import Bools, Float64s, GroundGrid, Int64s, Uint8s

_SOLID = 0.5
"""What covers more than this share of its convex hull fills it, but for places that are as they were: of most things only the
sides that face the cameras are seen."""
_PARTS = 8
"""Parts of a cell's edge: a container's sides at whole cells of 10 cm are 2 m³ of its 38."""
_NARROW = 0.75
"""What is narrower than so many cells are errors of the cloud beyond the edges of a thing, unless it is all there is."""
_BEYOND = 0.25
"""A surface ends beyond its outermost points by this share of their distance.  A half, were it not that matched surfaces reach
over their edges: boxes of exact points lose 8 % of their volume by 0, things on the yard gain 8 % by 0.4."""


@dataclass(frozen=True)
class Footprint:
    """The cells of the ground that a change covers, (m,) each."""

    cells: Int64s
    share: Float64s
    """Of each cell that it covers, 0 to 1."""
    base: Float64s
    """Height of what is below it on the other night, world lengths..."""
    height: Float64s
    """...and its own above that."""
    doubt: float
    """Standard deviation of the volume for what it covers without having been seen, and what is left out though it was seen."""


OPEN = 3.0**-0.5
"""Standard deviation of a share of which nothing is known, from the end at which it is taken to be: 0 or 1."""


def covered(grid: GroundGrid, points: Float64s, same: Bools, apart: float) -> tuple[Float64s, Float64s]:
    """(rows, columns) share of each cell that a surface covers, and the part of it that no point shows.

    Parameters
    ----------
    grid, points : the cells, and (n, 3) of the surface, over these.
    same : (rows, columns) cells that are known to be as they were.
    apart : distance of neighbouring points: gaps of twice that are closed.
    """
    fine = replace(grid, cell=grid.cell / _PARTS, rows=grid.rows * _PARTS, columns=grid.columns * _PARTS)
    places = np.divmod(cells_of(fine, points), fine.columns)
    first = np.maximum(np.min(places, axis=1) // _PARTS - 1, 0)
    last = np.minimum(np.max(places, axis=1) // _PARTS + 2, same.shape)
    reach = int(np.ceil(apart / fine.cell))
    mask = np.zeros((last - first) * _PARTS + 2 * reach, np.uint8)
    mask[tuple(place - start * _PARTS + reach for place, start in zip(places, first, strict=True))] = 1
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _disk(reach))
    closed = ndimage.binary_fill_holes(closed).astype(np.uint8)
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, _disk(round(_NARROW * _PARTS)))
    outside = (opened if opened.any() else closed)[reach:-reach, reach:-reach] == 0
    solid = ndimage.distance_transform_edt(outside) <= _BEYOND * apart / fine.cell
    window = slice(first[0], last[0]), slice(first[1], last[1])
    whole = _filled_out(solid, np.kron(same[window], np.ones((_PARTS, _PARTS), bool)))
    shares = np.zeros((2, *same.shape))
    for share, part in zip(shares, (whole, whole & ~solid), strict=True):
        share[window] = part.reshape(last[0] - first[0], _PARTS, last[1] - first[1], _PARTS).mean(axis=(1, 3))
    return shares[0], shares[1]


def _disk(radius: int) -> Uint8s:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), dtype=np.uint8)


def _filled_out(footprint: Bools, same: Bools) -> Bools:
    """The cells, and those of their convex hull that are not known to be as they were, where they cover much of it."""
    row, column = np.nonzero(footprint)
    hull = np.zeros(footprint.shape, np.uint8)
    cv2.fillConvexPoly(hull, cv2.convexHull(np.column_stack([column, row]).astype(np.int32)), 1)
    return footprint | ((hull > 0) & ~same) if footprint.sum() > _SOLID * hull.sum() else footprint

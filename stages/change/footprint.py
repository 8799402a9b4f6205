"""The ground that a change covers, and its height there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import ndimage

from ..core.ground_grid import cells_of
from ..types import Bools, Float64s, GroundGrid, Int64s, Uint8s

_SOLID_SHARE = 0.5
"""A footprint that covers more than this share of its convex hull is extended to all of it except unchanged cells: of most
things only the sides that face the cameras are seen."""
_SUBCELLS = 8
"""Subdivisions of a cell's edge: with whole cells of 10 cm, the sides of a container make up 2 of its 38 m³."""
_NARROW_CELLS = 0.75
"""Radius, in cells, of the opening that removes narrow parts (errors beyond the edges of a thing), unless nothing is left."""
_EXTENSION_SPACINGS = 0.25
"""Distance by which a surface extends beyond its outermost points, in point spacings.  It would be 0.5 if matched surfaces did
not reach over their edges: with 0, boxes of exact points lose 8 % of their volume; with 0.4, things on the yard gain 8 %."""
UNKNOWN_SHARE_SIGMA = 3.0**-0.5
"""Standard deviation of an unknown share, evenly spread from 0 to 1, about the end at which it is assumed to be (0 or 1)."""


@dataclass(frozen=True)
class Footprint:
    """The cells of the ground that a change covers, (m,) each."""

    cells: Int64s
    share: Float64s
    """Covered share of each cell, 0 to 1."""
    base: Float64s
    """Height of the surface below on the other night, world units."""
    height: Float64s
    """Height of the change above `base`, world units."""
    volume_sigma: float
    """Standard deviation of the volume from cells that are covered but were not seen, and from seen points that are left out."""

    def volume(self, grid: GroundGrid) -> float:
        """Volume of the change above `base`, world units cubed."""
        return float((self.share * self.height).sum() * grid.cell**2)


def covered_shares(grid: GroundGrid, points: Float64s, unchanged: Bools, spacing: float) -> tuple[Float64s, Float64s]:
    """(rows, columns) share of each cell that a surface covers, and the part of this share where there are no points.

    Parameters
    ----------
    grid, points : the cells, and the points (n, 3) of the surface, which lie over them.
    unchanged : (rows, columns) cells that are known to be unchanged.
    spacing : distance of neighbouring points: gaps up to twice as wide are closed.
    """
    fine = replace(grid, cell=grid.cell / _SUBCELLS, rows=grid.rows * _SUBCELLS, columns=grid.columns * _SUBCELLS)
    fine_rows, fine_columns = np.divmod(cells_of(fine, points), fine.columns)

    # 1. Mark the points in a window: the whole cells around them and one more on each side, plus a margin for the closing.
    first_row = max(fine_rows.min() // _SUBCELLS - 1, 0)
    first_column = max(fine_columns.min() // _SUBCELLS - 1, 0)
    last_row = min(fine_rows.max() // _SUBCELLS + 2, unchanged.shape[0])
    last_column = min(fine_columns.max() // _SUBCELLS + 2, unchanged.shape[1])
    n_rows = last_row - first_row
    n_columns = last_column - first_column
    margin = int(np.ceil(spacing / fine.cell))
    mask = np.zeros((n_rows * _SUBCELLS + 2 * margin, n_columns * _SUBCELLS + 2 * margin), np.uint8)
    mask[fine_rows - first_row * _SUBCELLS + margin, fine_columns - first_column * _SUBCELLS + margin] = 1

    # 2. Close gaps between points, and remove narrow parts.
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _disk(margin))
    closed = ndimage.binary_fill_holes(closed).astype(np.uint8)
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, _disk(round(_NARROW_CELLS * _SUBCELLS)))
    if not opened.any():
        opened = closed
    outside = opened[margin:-margin, margin:-margin] == 0

    # 3. Extend it beyond its outermost points, and to its hull.
    solid = ndimage.distance_transform_edt(outside) <= _EXTENSION_SPACINGS * spacing / fine.cell
    window = slice(first_row, last_row), slice(first_column, last_column)
    fine_unchanged = np.kron(unchanged[window], np.ones((_SUBCELLS, _SUBCELLS), bool))
    extended = _extend_to_hull(solid, fine_unchanged)

    # 4. The share of each whole cell: the mean over its subcells.
    covered = np.zeros(unchanged.shape)
    unseen = np.zeros(unchanged.shape)
    covered[window] = _cell_means(extended)
    unseen[window] = _cell_means(extended & ~solid)
    return covered, unseen


def _cell_means(fine: Bools) -> Float64s:
    """(rows, columns) share of True among the subcells of each cell."""
    rows = fine.shape[0] // _SUBCELLS
    columns = fine.shape[1] // _SUBCELLS
    return np.asarray(fine.reshape(rows, _SUBCELLS, columns, _SUBCELLS).mean(axis=(1, 3)), dtype=np.float64)


def _disk(radius: int) -> Uint8s:
    """A disk of some radius in pixels, as a structuring element."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), dtype=np.uint8)


def _extend_to_hull(footprint: Bools, unchanged: Bools) -> Bools:
    """The footprint, extended to its convex hull except for unchanged cells if it covers more than `_SOLID_SHARE` of the hull."""
    row, column = np.nonzero(footprint)
    hull = np.zeros(footprint.shape, np.uint8)
    cv2.fillConvexPoly(hull, cv2.convexHull(np.column_stack([column, row]).astype(np.int32)), 1)
    if footprint.sum() <= _SOLID_SHARE * hull.sum():
        return footprint
    return footprint | ((hull > 0) & ~unchanged)

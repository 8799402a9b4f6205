"""A night's points over the cells of the ground, and the surface that they show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..core.ground_grid import cells_of, quantile_by_cell
from ..types import Bools, Float32s, Float64s, GroundGrid, Int64s

TOP_QUANTILE = 0.9
"""Quantile of the heights in a cell that counts as its surface: one wrong point must not raise a roof."""
_GAP = 2
"""Unseen cells within this many cells of seen ones, on either side, are gaps between points and count as seen."""


@dataclass(frozen=True)
class GroundPoints:
    """Points over the cells of the ground grid; points outside it are left out."""

    cells: Int64s
    """(n,) index of the cell."""
    levels: Float64s
    """(n,) heights, world units."""


def points_over_ground(grid: GroundGrid, points: Float64s) -> GroundPoints:
    """The points (n, 3) that lie over the ground grid."""
    cells = cells_of(grid, points)
    inside = cells >= 0
    return GroundPoints(cells[inside], points[inside] @ grid.axes[2])


def surface_below(near: Bools, other: GroundPoints, most_level: float) -> Float64s | None:
    """(rows, columns) heights of the other night's surface, filled in from the nearest cells; None if none of it is near.

    near: (rows, columns) the cells whose points count; most_level: height above which they belong to something else.
    """
    lower = np.flatnonzero(near.ravel()[other.cells])
    lower = lower[other.levels[lower] <= most_level]
    if not len(lower):
        return None
    return fill_gaps(tops(other.cells[lower], other.levels[lower], near.shape), near)


def tops(cells: Int64s, levels: Float64s, shape: tuple[int, ...]) -> Float64s:
    """(rows, columns) height of the surface in each cell, from the heights of its points; nan without any."""
    return quantile_by_cell(cells, levels, int(np.prod(shape)), TOP_QUANTILE).reshape(shape)


def fill_gaps(values: Float64s, inside: Bools) -> Float64s:
    """Values (rows, columns), with the nearest known value of the cells `inside` wherever these have none."""
    known = np.isfinite(values) & inside
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)], dtype=np.float64)


def seen_cells(heights: Float64s | Float32s) -> Bools:
    """(rows, columns) cells that were seen, including gaps between points of up to twice `_GAP` cells."""
    margin = _GAP + 1  # without one, cells at the border of the grid would be lost
    padded = np.pad(np.isfinite(heights), margin)
    closed = ndimage.binary_closing(padded, iterations=_GAP)
    return np.asarray(closed[margin:-margin, margin:-margin], dtype=np.bool_)

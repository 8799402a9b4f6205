"""Grids of square cells on the ground, seen from above, and the directions east, north and up."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from ..types import Bools, Camera, Float64s, GroundGrid, Int64s
from .ordering import by_cell

_MARGIN_SHARE = 0.1
"""Margin of a grid beyond the percentiles that bound its points (`extent`), as a share of the distance between them."""


def ground_axes(cameras: Iterable[Camera], plane: Float64s | None = None) -> Float64s:
    """(3, 3) unit vectors in the world, one per row: east, north and up.

    These are the world's own axes if its z points up for every camera.  Otherwise up is the normal of the ground `plane` (4,),
    or minus the mean of the cameras' y axes without one, and east is the first camera's x axis, projected onto the ground.
    """
    views = list(cameras)
    if all(-camera.R[1, 2] > 0.5 for camera in views):
        return np.eye(3)
    # a camera's y axis points down in the image
    if plane is not None:
        up = plane[:3]
    else:
        up = -np.sum([camera.R[1] for camera in views], axis=0)
    if np.linalg.norm(up) > 1e-6:
        up = up / np.linalg.norm(up)
    else:  # cameras upside down beside upright ones
        up = -views[0].R[1]
    first_x = views[0].R[0]
    east = first_x - (first_x @ up) * up
    if np.linalg.norm(east) > 1e-6:
        east = east / np.linalg.norm(east)
    else:  # the camera's x axis is plumb: any level direction will do
        east = np.linalg.svd(up[None])[2][1]
    return np.stack([east, np.cross(up, east), up])


def grid_over(points: Float64s, axes: Float64s, cell: float) -> GroundGrid:
    """The grid that covers world points (n, 3), at least one, except outliers far from the rest.

    axes: see `ground_axes`; cell: edge of a cell in world units; the grid's corners lie at multiples of it.
    """
    flat = points @ axes[:2].T
    low, high = extent(flat, 1)
    # cells counted from the world's origin, so that grids of different nights have their corners at the same places
    first_column, first_row = np.floor(low / cell)
    last_column, last_row = np.floor(high / cell)
    left = float(first_column * cell)
    top = float((last_row + 1) * cell)
    rows = int(last_row - first_row) + 1
    columns = int(last_column - first_column) + 1
    return GroundGrid(axes, left, top, float(cell), rows, columns)


def extent(xy: Float64s, percent: float) -> tuple[Float64s, Float64s]:
    """Lower and upper corner (2,) around points (n, 2), ignoring `percent` of them at each end if these lie far outside."""
    low, high = np.percentile(xy, [percent, 100 - percent], axis=0)
    margin = _MARGIN_SHARE * (high - low)
    return np.maximum(low - margin, xy.min(axis=0)), np.minimum(high + margin, xy.max(axis=0))


def cells_of(grid: GroundGrid, points: Float64s) -> Int64s:
    """(n,) index of the cell (row-major) over which each of the points (n, 3) lies; -1 outside the grid."""
    x, y, z = np.asarray(points, np.float64).T
    # without BLAS, whose sums differ between machines
    (a, b, c), (d, e, f) = grid.axes[:2]
    east = x * a + y * b + z * c
    north = x * d + y * e + z * f
    # rows are counted from the top, as in images
    column = np.floor((east - grid.left) / grid.cell)
    row = np.floor((grid.top - north) / grid.cell)
    inside = (column >= 0) & (row >= 0) & (column < grid.columns) & (row < grid.rows)
    return np.where(inside, row * grid.columns + column, -1).astype(np.int64)


def inside_polygon(corners: Sequence[Sequence[float]], x: Float64s, y: Float64s) -> Bools:
    """Which of the points x, y (arrays of the same shape) lie inside the polygon with these corners (x, y)?"""
    # a point is inside if a ray from it toward +x crosses the border an odd number of times
    inside = np.zeros(np.shape(x), bool)
    for (x1, y1), (x2, y2) in pairwise([*corners, corners[0]]):
        with np.errstate(divide="ignore", invalid="ignore"):  # horizontal edges are never crossed
            crossing = (x2 - x1) * (y - y1) / np.float64(y2 - y1) + x1
            inside ^= ((y1 > y) != (y2 > y)) & (x < crossing)
    return inside


def cells_inside(grid: GroundGrid, corners: Sequence[Sequence[float]]) -> Bools:
    """(rows, columns) bool, True for cells whose centre lies inside a polygon."""
    east = grid.left + (np.arange(grid.columns) + 0.5) * grid.cell
    north = grid.top - (np.arange(grid.rows) + 0.5) * grid.cell
    return inside_polygon(corners, *np.meshgrid(east, north))


def cell_centres(grid: GroundGrid, heights: Float64s) -> Float64s:
    """(rows * columns, 3) world points at the centres of the cells, at heights (rows, columns)."""
    east = grid.left + (np.arange(grid.columns) + 0.5) * grid.cell
    north = grid.top - (np.arange(grid.rows) + 0.5) * grid.cell
    x, y = np.meshgrid(east, north)
    return np.asarray(np.column_stack([x.ravel(), y.ravel(), heights.ravel()]) @ grid.axes, dtype=np.float64)


def quantile_by_cell(cells: Int64s, values: Float64s, count: int, quantile: float) -> Float64s:
    """(count,) a quantile of the values in each cell, nan where there are none.

    Parameters
    ----------
    cells, values : (n,) index of each value's cell, or -1 to ignore it; and the values.
    count : number of cells.
    quantile : 0 to 1.
    """
    inside = cells >= 0
    cells, values = cells[inside], values[inside]
    # by cell, and within each by value, since sorting by cell is stable
    ascending = np.argsort(values)
    order, starts = by_cell(cells[ascending], count)
    counts = np.diff(starts)
    occupied = np.flatnonzero(counts)
    rank = np.rint(quantile * (counts[occupied] - 1)).astype(np.int64)
    filled = np.full(count, np.nan)
    filled[occupied] = values[ascending[order[starts[occupied] + rank]]]
    return filled


def preferred_above(value: float) -> float:
    """The smallest of 1, 2 or 5 times a power of ten that is not below a positive value."""
    decade = 10.0 ** float(np.floor(np.log10(value)))
    least_step = value / decade * (1 - 1e-9)  # 2.0000000001 rounds up to 2, not to 5
    for step in (1.0, 2.0, 5.0):
        if step >= least_step:
            return float(decade * step)
    return float(decade * 10.0)

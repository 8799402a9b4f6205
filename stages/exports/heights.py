"""Height maps: the surface seen from straight above, on a grid of square cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..core.ground_grid import extent, preferred_above
from ..types import Float32s, Float64s

MOST_CELLS = 50_000_000
"""Largest number of cells of a map: 200 MB of heights.  Beyond it, cells grow."""
QUANTILE = 0.9
"""Quantile of the heights in a cell that is its height: nearly the highest, as one wrong point must not raise a roof."""


@dataclass(frozen=True)
class HeightMap:
    """Heights seen from above, on a grid; the first row has the largest y."""

    heights: Float32s
    """(rows, columns) float32, nan where unknown."""
    left: float
    top: float
    """x and y of the outer corner of the first cell."""
    cell: float
    """Edge of a cell."""
    left_out: int
    """Number of points far from the rest, which the map does not cover."""


def height_map(points: Float64s, cell: float | None = None) -> HeightMap:
    """Height map of points (n, 3), z up.

    cell: its edge in the points' unit; None: twice the median point spacing, rounded up to 1, 2 or 5 times a power of ten.
    """
    low, high = extent(points[:, :2], 0.1)
    edge, first_column, last_row, columns, rows = map_cells(low, high, cell or preferred_above(2 * spacing(points)))
    inside = np.all((points[:, :2] >= low) & (points[:, :2] <= high), axis=1)
    x, y, z = points[inside].T
    # the cell of each point; rounding may put a point on the outer edge one cell too far
    column = np.clip(np.floor(x / edge).astype(np.int64) - first_column, 0, columns - 1)
    row = np.clip(last_row - np.floor(y / edge).astype(np.int64), 0, rows - 1)
    cell_index = row * columns + column
    # sorted by cell, then by height: the quantile of a cell is a position among its points
    order = np.lexsort((z, cell_index))
    cells, start, count = np.unique(cell_index[order], return_index=True, return_counts=True)
    heights = np.full(rows * columns, np.nan, np.float32)
    heights[cells] = z[order][start + np.rint(QUANTILE * (count - 1)).astype(np.int64)]
    left = first_column * edge
    top = (last_row + 1) * edge
    return HeightMap(heights.reshape(rows, columns), left, top, edge, int(np.sum(~inside)))


def map_cells(low: Float64s, high: Float64s, edge: float) -> tuple[float, int, int, int, int]:
    """Cell edge of a map from `low` to `high`, (2,) each, first column, last row, columns and rows.  The edge grows to limit
    the cells (`MOST_CELLS`); corners lie at multiples of it, so that maps of different nights align."""
    while np.prod((high - low) / edge + 1) > MOST_CELLS:
        edge = preferred_above(1.5 * edge)
    # numbers of cells from the origin of the coordinates; rows of an image run from north to south
    first_column = int(np.floor(low[0] / edge))
    last_row = int(np.floor(high[1] / edge))
    columns = int(np.floor(high[0] / edge)) - first_column + 1
    rows = last_row - int(np.floor(low[1] / edge)) + 1
    return edge, first_column, last_row, columns, rows


def spacing(points: Float64s) -> float:
    """Median distance of a point from its nearest neighbour; 1 for a single point."""
    # centred, since map coordinates of millions of metres cost digits
    centred = points - points.mean(axis=0)
    queries = centred[:: max(1, len(points) // 20_000)]
    distances, _ = cKDTree(centred).query(queries, k=2)  # the nearest point of each is itself
    if len(points) <= 1:
        return 1.0
    return float(np.median(distances[:, 1]))

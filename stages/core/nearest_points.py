"""Exact nearest neighbours of image points by a grid of cells: the search covers a square of cells around each query.

Image points are spread evenly enough for this to be several times faster than a tree.  Instead of keeping a sorted list, the
search counts the distances below a limit and bisects the limit, which the compiler can vectorise.
"""

from __future__ import annotations

import numpy as np

from ..types import Float64s, Int32s, Int64s
from .jit import helper, kernel
from .ordering import by_cell

_POINTS_PER_CELL = 2.0
_ENOUGH = 1.5
"""Points expected in the first square of the search, if they are spread evenly, as a multiple of the k that are needed."""
_HALVINGS = 100


def nearest_points(points: Float64s, queries: Float64s, k: int) -> tuple[Float64s, Int32s]:
    """Distances (m, k) and row indices (m, k) of the k `points` (n, 2) nearest to each of `queries` (m, 2), unsorted.

    k is at most n.  Of points at equal distance an arbitrary one is returned, but the same in every call.
    """
    by_axis = np.ascontiguousarray(points.T)  # extremes along the long axis would be several times slower
    low, high = by_axis.min(axis=1), by_axis.max(axis=1)
    extent = np.maximum(high - low, 1e-9)
    size = max(float(np.sqrt(extent[0] * extent[1] * _POINTS_PER_CELL / len(points))), float(extent.max()) / len(points))
    columns, rows = np.floor((high - low) / size).astype(np.int64) + 1
    column, row = ((points - low) / size).astype(np.int64).T
    order, starts = by_cell(row * columns + column, columns * rows)
    squared, index = np.empty((len(queries), k)), np.empty((len(queries), k), np.int32)
    room = np.empty((3, len(points))), np.empty((3, len(points)), np.int32)
    room[0][:2] = by_axis[:, order]
    reach = int(np.ceil(0.5 * (np.sqrt(_ENOUGH * k / _POINTS_PER_CELL) - 1)))
    _search(queries, *room, order, starts, low, size, columns, rows, reach, squared, index)
    return np.sqrt(squared), index


@kernel
def _search(
    queries: Float64s, points: Float64s, chosen: Int32s, names: Int64s, starts: Int64s, low: Float64s, size: float,
    columns: int, rows: int, begin: int, squared: Float64s, index: Int32s,
) -> None:  # fmt: skip
    """Write the squared distances and the names of the nearest points.

    points: (3, n) x and y in cell order (`starts` holds each cell's first point), and room for distances; chosen: room for
    indices; begin: number of cells by which the first square extends to each side.
    """
    k = squared.shape[1]
    for q in range(len(queries)):
        x, y = queries[q, 0] - low[0], queries[q, 1] - low[1]
        cx, cy = int(min(max(x / size, 0.0), columns - 1.0)), int(min(max(y / size, 0.0), rows - 1.0))
        reach, found, limit = begin, 0, 0.0
        while True:
            left, right = max(cx - reach, 0), min(cx + reach, columns - 1)
            top, bottom = max(cy - reach, 0), min(cy + reach, rows - 1)
            found = 0
            for row in range(top, bottom + 1):
                first, last = starts[row * columns + left], starts[row * columns + right + 1]
                _distances(points, first, last, queries[q, 0], queries[q, 1], found, chosen)
                found += last - first
            # points outside the square lie beyond its nearest side that is not a border of the grid
            side = np.inf
            if left > 0:
                side = min(side, x - left * size)
            if right < columns - 1:
                side = min(side, (right + 1) * size - x)
            if top > 0:
                side = min(side, y - top * size)
            if bottom < rows - 1:
                side = min(side, (bottom + 1) * size - y)
            limit = _largest(points, found) if side == np.inf else side * side
            if found >= k and (side == np.inf or (side > 0 and _count(points, found, limit) >= k)):
                break
            reach += 1
        low_limit, high_limit = -1.0, limit
        for _ in range(_HALVINGS):
            middle = 0.5 * (low_limit + high_limit)
            count = _count(points, found, middle)
            if count >= k:
                high_limit = middle
            else:
                low_limit = middle
            if count == k or not low_limit < 0.5 * (low_limit + high_limit) < high_limit:
                break
        _take(points, chosen, found, low_limit, high_limit, names, squared[q], index[q])


@helper
def _distances(points: Float64s, first: int, last: int, x: float, y: float, found: int, chosen: Int32s) -> None:
    """Write squared distances and indices of the points of a row of cells, behind those of the first `found` points."""
    for n in range(last - first):
        dx, dy = points[0, first + n] - x, points[1, first + n] - y
        points[2, found + n] = dx * dx + dy * dy
        chosen[0, found + n] = first + n


@helper
def _largest(points: Float64s, found: int) -> float:
    most = 0.0
    for n in range(found):
        most = max(most, points[2, n])
    return most


@helper
def _count(points: Float64s, found: int, limit: float) -> int:
    count = 0
    for n in range(found):
        count += 1 if points[2, n] <= limit else 0
    return count


@helper
def _take(
    points: Float64s, chosen: Int32s, found: int, low: float, high: float, names: Int64s, squared: Float64s, index: Int32s
) -> None:
    """Write the points up to the low limit, then points between both limits as far as there is room."""
    below = between = 0
    for n in range(found):
        d = points[2, n]
        chosen[1, below], chosen[2, between] = n, n
        below += 1 if d <= low else 0
        between += 1 if low < d <= high else 0
    for c in range(len(squared)):
        n = chosen[1, c] if c < below else chosen[2, c - below]
        squared[c], index[c] = points[2, n], names[chosen[0, n]]

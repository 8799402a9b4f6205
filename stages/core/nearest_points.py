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
"""Mean number of points in a cell of the grid.  More: fewer cells, but more points of each square lie outside the circle."""
_FIRST_SQUARE_RATIO = 1.5
"""Points expected in the first square of the search, if they are spread evenly, as a multiple of the k that are needed."""
_HALVINGS = 100
"""Most bisections of the limit: enough to separate any two different distances."""


def nearest_points(points: Float64s, queries: Float64s, k: int) -> tuple[Float64s, Int32s]:
    """Distances (m, k) and row indices (m, k) of the k `points` (n, 2) nearest to each of `queries` (m, 2), unsorted.

    k is at most n.  Of points at equal distance an arbitrary one is returned, but the same in every call.
    """
    by_axis = np.ascontiguousarray(points.T)  # extremes along the long axis would be several times slower
    low = by_axis.min(axis=1)
    high = by_axis.max(axis=1)
    extent = np.maximum(high - low, 1e-9)
    # points on a line would have no area: at most as many columns, and rows, as there are points
    cell_of_area = float(np.sqrt(extent[0] * extent[1] * _POINTS_PER_CELL / len(points)))
    cell_size = max(cell_of_area, float(extent.max()) / len(points))
    columns, rows = np.floor((high - low) / cell_size).astype(np.int64) + 1
    column, row = ((points - low) / cell_size).astype(np.int64).T
    order, starts = by_cell(row * columns + column, columns * rows)
    distances_sq = np.empty((len(queries), k))
    index = np.empty((len(queries), k), np.int32)
    # points in cell order: those of neighbouring cells of a row lie side by side in memory
    workspace = np.empty((3, len(points)))
    workspace[:2] = by_axis[:, order]
    scratch = np.empty((3, len(points)), np.int32)
    # the square of 2 reach + 1 cells that should hold enough points
    reach = int(np.ceil(0.5 * (np.sqrt(_FIRST_SQUARE_RATIO * k / _POINTS_PER_CELL) - 1)))
    _search(queries, workspace, scratch, order, starts, low, cell_size, columns, rows, reach, distances_sq, index)
    return np.sqrt(distances_sq), index


@kernel
def _search(
    queries: Float64s, points: Float64s, scratch: Int32s, order: Int64s, starts: Int64s, low: Float64s, cell_size: float,
    columns: int, rows: int, first_reach: int, distances_sq: Float64s, index: Int32s,
) -> None:  # fmt: skip
    """Write the squared distances and the original indices of the nearest points.

    points: (3, n) x and y in cell order (`starts` holds each cell's first point), and room for distances; scratch: room for
    indices; order: original index of each point; first_reach: number of cells by which the first square extends to each side.
    """
    k = distances_sq.shape[1]
    for q in range(len(queries)):
        # 1. the smallest square of cells around the query that is sure to hold the k nearest
        x = queries[q, 0] - low[0]
        y = queries[q, 1] - low[1]
        cx = int(min(max(x / cell_size, 0.0), columns - 1.0))
        cy = int(min(max(y / cell_size, 0.0), rows - 1.0))
        reach = first_reach
        n_found = 0
        limit = 0.0
        while True:
            left = max(cx - reach, 0)
            right = min(cx + reach, columns - 1)
            top = max(cy - reach, 0)
            bottom = min(cy + reach, rows - 1)
            n_found = 0
            for row in range(top, bottom + 1):
                first = starts[row * columns + left]
                last = starts[row * columns + right + 1]
                _add_distances(points, first, last, queries[q, 0], queries[q, 1], n_found, scratch)
                n_found += last - first
            # points outside the square lie beyond its nearest side that is not a border of the grid
            side_distance = np.inf
            if left > 0:
                side_distance = min(side_distance, x - left * cell_size)
            if right < columns - 1:
                side_distance = min(side_distance, (right + 1) * cell_size - x)
            if top > 0:
                side_distance = min(side_distance, y - top * cell_size)
            if bottom < rows - 1:
                side_distance = min(side_distance, (bottom + 1) * cell_size - y)
            if side_distance == np.inf:  # the square covers all points
                limit = _largest_distance(points, n_found)
                if n_found >= k:
                    break
            else:
                limit = side_distance * side_distance
                if n_found >= k and side_distance > 0 and _count_below(points, n_found, limit) >= k:
                    break
            reach += 1

        # 2. the limit of their squared distances, by bisection: fewer than k are below the low one, at least k below the high one
        low_limit = -1.0
        high_limit = limit
        for _ in range(_HALVINGS):
            middle = 0.5 * (low_limit + high_limit)
            count = _count_below(points, n_found, middle)
            if count >= k:
                high_limit = middle
            else:
                low_limit = middle
            # ends at exactly k, or when no number is left between the limits, as for points at equal distance
            if count == k or not low_limit < 0.5 * (low_limit + high_limit) < high_limit:
                break

        # 3. the points themselves
        _write_nearest(points, scratch, n_found, low_limit, high_limit, order, distances_sq[q], index[q])


@helper
def _add_distances(points: Float64s, first: int, last: int, x: float, y: float, n_found: int, scratch: Int32s) -> None:
    """Write squared distances and indices of the points of a row of cells, behind those of the first `n_found` points."""
    for n in range(last - first):
        dx = points[0, first + n] - x
        dy = points[1, first + n] - y
        points[2, n_found + n] = dx * dx + dy * dy
        scratch[0, n_found + n] = first + n


@helper
def _largest_distance(points: Float64s, n_found: int) -> float:
    """Largest of the squared distances found."""
    largest = 0.0
    for n in range(n_found):
        largest = max(largest, points[2, n])
    return largest


@helper
def _count_below(points: Float64s, n_found: int, limit: float) -> int:
    """Number of squared distances up to a limit; adds 0 or 1 without a branch, so that the loop is vectorised."""
    count = 0
    for n in range(n_found):
        count += 1 if points[2, n] <= limit else 0
    return count


@helper
def _write_nearest(
    points: Float64s, scratch: Int32s, n_found: int, low: float, high: float, order: Int64s, distances_sq: Float64s, index: Int32s
) -> None:
    """Write the points up to the low limit, then points between both limits as far as there is room."""
    below = between = 0
    for n in range(n_found):
        distance_sq = points[2, n]
        # written always, and overwritten by the next one unless it counts: a branch would cost more
        scratch[1, below] = n
        scratch[2, between] = n
        below += 1 if distance_sq <= low else 0
        between += 1 if low < distance_sq <= high else 0
    for slot in range(len(distances_sq)):
        n = scratch[1, slot] if slot < below else scratch[2, slot - below]
        distances_sq[slot] = points[2, n]
        index[slot] = order[scratch[0, n]]

"""Exact nearest neighbours among points of an image: a grid of cells, looked at in growing squares around each query.

Points of an image are spread well enough for this to be several times faster than a tree.
"""

from __future__ import annotations

import numpy as np

from ..types import Float64s, Int32s
from .jit import kernel

_POINTS_PER_CELL = 2.0


def nearest_points(points: Float64s, queries: Float64s, k: int) -> tuple[Float64s, Int32s]:
    """Distances (m, k) and rows (m, k) of the k nearest of `points` (n, 2) to each of `queries` (m, 2), nearest first.

    k is at most n; of points at one distance, any comes first, the same at every call.
    """
    by_axis = np.ascontiguousarray(points.T)  # several times faster than extremes along the long axis
    low, high = by_axis.min(axis=1), by_axis.max(axis=1)
    extent = np.maximum(high - low, 1e-9)
    size = max(float(np.sqrt(extent[0] * extent[1] * _POINTS_PER_CELL / len(points))), float(extent.max()) / len(points))
    columns, rows = np.floor((high - low) / size).astype(np.int64) + 1
    order, starts = _by_cell(points, low, size, columns, rows)
    distance, index = np.full((len(queries), k), np.inf), np.zeros((len(queries), k), np.int32)
    _search(queries, points[order], order, starts, low, size, columns, rows, distance, index)
    return np.sqrt(distance), index


@kernel
def _by_cell(points: Float64s, low: Float64s, size: float, columns: int, rows: int) -> tuple[Int32s, Int32s]:
    """Rows (n,) of `points` in order of their cells, and where in it each cell starts (cells + 1,)."""
    cell = np.empty(len(points), np.int32)
    starts = np.zeros(columns * rows + 1, np.int32)
    for k in range(len(points)):
        cell[k] = int((points[k, 1] - low[1]) / size) * columns + int((points[k, 0] - low[0]) / size)
        starts[cell[k] + 1] += 1
    for c in range(columns * rows):
        starts[c + 1] += starts[c]
    order, free = np.empty(len(points), np.int32), starts.copy()
    for k in range(len(points)):
        order[free[cell[k]]] = k
        free[cell[k]] += 1
    return order, starts


@kernel
def _search(
    queries: Float64s,
    points: Float64s,
    names: Int32s,
    starts: Int32s,
    low: Float64s,
    size: float,
    columns: int,
    rows: int,
    squared: Float64s,
    index: Int32s,
) -> None:
    """Write squared distances and names of the nearest; points: in order of their cells, whose first ones are `starts`."""
    k = squared.shape[1]
    for q in range(len(queries)):
        x, y = queries[q, 0] - low[0], queries[q, 1] - low[1]
        cx, cy = int(min(max(x / size, 0.0), columns - 1.0)), int(min(max(y / size, 0.0), rows - 1.0))
        best, name = squared[q], index[q]
        for reach in range(max(columns, rows)):
            left, right, top, bottom = cx - reach, cx + reach, cy - reach, cy + reach
            for row in range(max(top, 0), min(bottom, rows - 1) + 1):
                # the whole row where the square begins or ends, else its two ends
                whole = row in (top, bottom)
                for end in range(1 if whole else 2):
                    first, last = max(right if end == 1 else left, 0), min(right if whole or end == 1 else left, columns - 1)
                    if first > last:
                        continue
                    for at in range(starts[row * columns + first], starts[row * columns + last + 1]):
                        dx, dy = points[at, 0] - queries[q, 0], points[at, 1] - queries[q, 1]
                        d = dx * dx + dy * dy
                        if d >= best[k - 1]:
                            continue
                        place = k - 1
                        while place > 0 and d < best[place - 1]:
                            best[place], name[place] = best[place - 1], name[place - 1]
                            place -= 1
                        best[place], name[place] = d, names[at]
            # no point outside the square is nearer than its nearest side that has points beyond it
            side = np.inf
            if left > 0:
                side = min(side, x - left * size)
            if right < columns - 1:
                side = min(side, (right + 1) * size - x)
            if top > 0:
                side = min(side, y - top * size)
            if bottom < rows - 1:
                side = min(side, (bottom + 1) * size - y)
            if best[k - 1] <= side * side:
                break

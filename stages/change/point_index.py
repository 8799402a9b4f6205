"""Points of a cloud by the cells of a grid in space: neighbours within a ball or a cylinder are found without a tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.jit import kernel
from ..core.ordering import by_cell
from ..types import Float32s, Float64s, Int64s

_MOST_CELLS = 40_000_000


@dataclass(frozen=True)
class PointIndex:
    """A cloud in the order of its cells."""

    points: Float64s
    """(n, 3) in that order."""
    order: Int64s
    """(n,) their places in the cloud as it was given."""
    starts: Int64s
    """(cells + 1,) where each cell begins."""
    low: Float64s
    """(3,) corner of the first cell."""
    edge: float
    shape: Int64s
    """(3,) cells along each axis."""


def index_points(points: Float64s, edge: float) -> PointIndex:
    """Points (n, 3), not empty, by cells of about `edge`: of larger ones where there would be too many."""
    low, high = (np.array([side(points[:, axis]) for axis in range(3)]) for side in (np.min, np.max))
    while np.prod(np.floor((high - low) / edge) + 1) > _MOST_CELLS:
        edge *= 1.5
    shape = np.floor((high - low) / edge).astype(np.int64) + 1
    cell = np.empty(len(points), np.int64)
    _number(points, low, edge, shape, cell)
    order, starts = by_cell(cell, int(np.prod(shape)))
    return PointIndex(points[order], order, starts, low, float(edge), shape)


@kernel
def _number(points: Float64s, low: Float64s, edge: float, shape: Int64s, out: Int64s) -> None:
    for k in range(len(points)):
        cell = 0
        for a in range(3):
            cell = cell * shape[a] + min(int(np.floor((points[k, a] - low[a]) / edge)), shape[a] - 1)
        out[k] = cell


def one_of_each_cell(points: Float64s, edge: float) -> Int64s:
    """Places (m,) of the first point in each cell of a grid anchored at 0, in the order of the points."""
    at = np.floor(points / edge).astype(np.int64)
    at -= at.min(axis=0)
    span = at.max(axis=0) + 1
    _, first = np.unique((at[:, 0] * span[1] + at[:, 1]) * span[2] + at[:, 2], return_index=True)
    return np.sort(first)


def mean_normals(queries: Float64s, index: PointIndex, normals: Float32s, radius: float) -> Float64s:
    """(m, 3) of unit length: mean normal of the cloud within a radius of each query, nan without any.

    Parameters
    ----------
    queries : (m, 3) places.
    index : of the cloud.
    normals : (n, 3) of the cloud, as it was indexed.
    radius : Metres.
    """
    out = np.full((len(queries), 3), np.nan)
    ordered = normals[index.order].astype(np.float64)
    _mean_normals(queries, index.points, ordered, index.starts, index.low, index.edge, index.shape, radius, out)
    return out


@kernel
def _mean_normals(
    queries: Float64s,
    points: Float64s,
    normals: Float64s,
    starts: Int64s,
    low: Float64s,
    edge: float,
    shape: Int64s,
    radius: float,
    out: Float64s,
) -> None:
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for q in range(len(queries)):
        for a in range(3):
            first[a] = max(int(np.floor((queries[q, a] - radius - low[a]) / edge)), 0)
            last[a] = min(int(np.floor((queries[q, a] + radius - low[a]) / edge)), shape[a] - 1)
        nx, ny, nz = 0.0, 0.0, 0.0
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                row = (i * shape[1] + j) * shape[2]
                if last[2] < first[2]:
                    continue
                for k in range(starts[row + first[2]], starts[row + last[2] + 1]):
                    dx, dy, dz = points[k, 0] - queries[q, 0], points[k, 1] - queries[q, 1], points[k, 2] - queries[q, 2]
                    if dx * dx + dy * dy + dz * dz <= radius * radius:
                        nx += normals[k, 0]
                        ny += normals[k, 1]
                        nz += normals[k, 2]
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 1e-9:
            out[q, 0], out[q, 1], out[q, 2] = nx / length, ny / length, nz / length

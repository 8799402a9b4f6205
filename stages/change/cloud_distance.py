"""Distances between two clouds along the normals of one, each with its level of detection: M3C2.

At each core point a cylinder is placed along the normal; the distance is measured between the mean positions of both clouds in
it.  The points' own standard deviations are used instead of the spread in the cylinder, as both clouds have them.

References: Lague, Brodu, Leroux, Accurate 3D comparison of complex topography with terrestrial laser scanner, ISPRS J. 82,
2013; Winiwarter, Anders, Höfle, M3C2-EP, ISPRS J. 178, 2021 (known uncertainties instead of the spread).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..core.jit import helper, kernel
from ..core.ordering import by_cell
from ..types import Float32s, Float64s, Int64s

CONFIDENCE = 1.96
"""Number of standard deviations that holds 95 % of all errors."""
_BLOCK = 64
"""Number of points that are processed at once, so that the compiler can vectorise."""
_MOST_CELLS = 40_000_000
"""Largest number of cells of an index."""


@dataclass(frozen=True)
class Distances:
    """Distances at the core points, (n,) each."""

    distance: Float64s
    """From the first cloud to the second along the normal; nan if either has too few points in the cylinder."""
    sigma: Float64s
    """Standard deviation of the distance."""
    count1: Int64s
    """Points of the first cloud in the cylinder."""
    count2: Int64s
    """Points of the second cloud in the cylinder."""

    @property
    def detectable(self) -> Float64s:
        """Level of detection, (n,): a larger distance is a change, with 95 % confidence."""
        return CONFIDENCE * self.sigma


class PointIndex(NamedTuple):
    """A cloud sorted by the cells of a grid."""

    points: Float64s
    """(n, 3) in the order of their cells."""
    order: Int64s
    """(n,) indices of the sorted points in the cloud as it was given."""
    starts: Int64s
    """(cells + 1,) where each cell begins."""
    low: Float64s
    """(3,) corner of the first cell."""
    edge: float
    shape: Int64s
    """(3,) cells along each axis."""


@dataclass(frozen=True)
class MeasuredCloud:
    """A cloud with a standard deviation for each point."""

    points: Float64s
    """(n, 3)"""
    sigma: Float64s
    """(n,)"""
    index: PointIndex | None = None
    """Spatial index of the points, with cells of the size of a cylinder; built when needed if None."""


def cloud_distances(
    core: Float64s,
    normals: Float64s,
    first: MeasuredCloud,
    second: MeasuredCloud,
    *,
    radius: float,
    reach: float,
    registration: float = 0.0,
    fewest_points: int = 4,
) -> Distances:
    """Distances from the first cloud to the second.

    Parameters
    ----------
    core, normals : (n, 3) where to measure, and unit directions; nan directions give nan.
    first, second : the clouds.
    radius, reach : radius and half length of the cylinder, whose middle is the core point.
    registration : standard deviation of the position of one cloud relative to the other.
    fewest_points : smallest number of points of each cloud in a cylinder; with fewer the distance is nan.
    """
    measured = [_in_cylinders(core, normals, cloud, radius, reach) for cloud in (first, second)]
    (mean1, variance1, count1), (mean2, variance2, count2) = measured
    has_enough = (count1 >= fewest_points) & (count2 >= fewest_points)
    sigma = np.sqrt(variance1 + variance2 + registration**2)
    return Distances(np.where(has_enough, mean2 - mean1, np.nan), np.where(has_enough, sigma, np.nan), count1, count2)


def _in_cylinders(
    core: Float64s, normals: Float64s, cloud: MeasuredCloud, radius: float, reach: float
) -> tuple[Float64s, Float64s, Int64s]:
    """Mean position along the normal of the points in each cylinder, the variance of that mean, and how many there are."""
    mean, variance, count = np.full(len(core), np.nan), np.full(len(core), np.nan), np.zeros(len(core), np.int64)
    if len(cloud.points) and len(core):
        index = cloud.index or index_points(cloud.points, 2.0 * radius)
        columns, sigma_sq = np.ascontiguousarray(index.points.T), cloud.sigma[index.order] ** 2
        _measure_cylinders(core, normals, index, columns, sigma_sq, radius, reach, mean, variance, count)
    return mean, variance, count


@kernel
def _measure_cylinders(
    core: Float64s, normals: Float64s, index: PointIndex, columns: Float64s, sigma_sq: Float64s, radius: float, reach: float,
    mean: Float64s, variance: Float64s, count: Int64s,
) -> None:  # fmt: skip
    """columns, sigma_sq: (3, n) the index's points, and (n,) their variances."""
    low, edge, shape, starts = index.low, index.edge, index.shape, index.starts
    near_sq = (radius + 0.8661 * edge) ** 2  # plus half a cell's diagonal: cells farther away hold no point of the cylinder
    first, last, scratch = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(2 * _BLOCK)
    for q in range(len(core)):
        n0, n1, n2 = normals[q]
        if not np.isfinite(n0):
            continue
        for a in range(3):
            half_extent = abs(normals[q, a]) * reach + radius
            first[a], last[a] = _cells_within(core[q, a], half_extent, low[a], edge, shape[a])
        t_sum, sigma_sq_sum, inside_count = 0.0, 0.0, 0
        for i in range(first[0], last[0] + 1):
            x = low[0] + (i + 0.5) * edge - core[q, 0]
            for j in range(first[1], last[1] + 1):
                y = low[1] + (j + 0.5) * edge - core[q, 1]
                column = (i * shape[1] + j) * shape[2]
                begin, end = -1, -1  # the cells of a column are contiguous
                for k in range(first[2], last[2] + 1):
                    z = low[2] + (k + 0.5) * edge - core[q, 2]
                    t = x * n0 + y * n1 + z * n2
                    if x * x + y * y + z * z - t * t <= near_sq:
                        begin = starts[column + k] if begin < 0 else begin
                        end = starts[column + k + 1]
                for p0 in range(begin, end, _BLOCK):
                    n = min(_BLOCK, end - p0)
                    px, py, pz = columns[0, p0:], columns[1, p0:], columns[2, p0:]
                    for p in range(n):
                        dx, dy, dz = px[p] - core[q, 0], py[p] - core[q, 1], pz[p] - core[q, 2]
                        t = dx * n0 + dy * n1 + dz * n2
                        inside = abs(t) <= reach and dx * dx + dy * dy + dz * dz - t * t <= radius * radius
                        scratch[p] = 1.0 if inside else 0.0
                        scratch[_BLOCK + p] = t if inside else 0.0
                    for p in range(n):
                        t_sum += scratch[_BLOCK + p]
                        sigma_sq_sum += scratch[p] * sigma_sq[p0 + p]
                        inside_count += int(scratch[p])
        count[q] = inside_count
        if inside_count:
            mean[q] = t_sum / inside_count
            variance[q] = sigma_sq_sum / inside_count / inside_count


@helper
def _cells_within(centre: float, half_extent: float, low: float, edge: float, count: int) -> tuple[int, int]:
    """The first and the last cell, along one axis, within some distance of a centre; there is none if the last one is smaller."""
    first, last = np.floor((centre - half_extent - low) / edge), np.floor((centre + half_extent - low) / edge)
    return max(int(first), 0), min(int(last), count - 1)


def index_points(points: Float64s, edge: float) -> PointIndex:
    """Sorts points (n, 3), at least one, into cells of about `edge`, or larger ones if there were more than `_MOST_CELLS`."""
    low, high = (np.array([extreme(points[:, axis]) for axis in range(3)]) for extreme in (np.min, np.max))
    while np.prod(np.floor((high - low) / edge) + 1) > _MOST_CELLS:
        edge *= 1.5
    shape = np.floor((high - low) / edge).astype(np.int64) + 1
    cell = np.ravel_multi_index(((points - low) / edge).astype(np.int64).T, shape, mode="clip")
    order, starts = by_cell(cell, int(np.prod(shape)))
    return PointIndex(points[order], order, starts, low, float(edge), shape)


def one_of_each_cell(points: Float64s, edge: float) -> Int64s:
    """Indices (m,) of the first point in each cell of a grid anchored at 0, in the order of the points."""
    cells = np.floor(points / edge).astype(np.int64)
    cells -= cells.min(axis=0)
    cell_counts = cells.max(axis=0) + 1
    _, first = np.unique((cells[:, 0] * cell_counts[1] + cells[:, 1]) * cell_counts[2] + cells[:, 2], return_index=True)
    return np.sort(first)


def spacing_of(points: Float64s) -> float:
    """Median distance of a point (n, 3) from its nearest neighbour, estimated from some 5000 points."""
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    distances, _ = tree.query(points[:: max(1, len(points) // 5000)], k=2, workers=1)
    return max(float(np.median(distances[:, 1])) if len(points) > 1 else 1.0, 1e-9)


def mean_normals(queries: Float64s, index: PointIndex, normals: Float32s, radius: float) -> Float64s:
    """(m, 3) of unit length: mean normal of the cloud within a radius of each query, nan if it has no points there.

    Parameters
    ----------
    queries, radius : (m, 3) points, and the radius around them in metres.
    index, normals : index of the cloud, and its normals (n, 3) in the order before indexing.
    """
    out = np.full((len(queries), 3), np.nan)
    ordered = normals[index.order].astype(np.float64)
    _mean_normals(queries, index, ordered, radius, out)
    return out


@kernel
def _mean_normals(queries: Float64s, index: PointIndex, normals: Float64s, radius: float, out: Float64s) -> None:
    points, shape, first, last = index.points, index.shape, np.empty(3, np.int64), np.empty(3, np.int64)
    for q in range(len(queries)):
        for a in range(3):
            first[a], last[a] = _cells_within(queries[q, a], radius, index.low[a], index.edge, shape[a])
        if last[2] < first[2]:
            continue
        nx, ny, nz = 0.0, 0.0, 0.0
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                column = (i * shape[1] + j) * shape[2]
                for k in range(index.starts[column + first[2]], index.starts[column + last[2] + 1]):
                    dx, dy, dz = points[k, 0] - queries[q, 0], points[k, 1] - queries[q, 1], points[k, 2] - queries[q, 2]
                    if dx * dx + dy * dy + dz * dz <= radius * radius:
                        nx += normals[k, 0]
                        ny += normals[k, 1]
                        nz += normals[k, 2]
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 1e-9:
            out[q, 0], out[q, 1], out[q, 2] = nx / length, ny / length, nz / length

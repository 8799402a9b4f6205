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
"""Largest number of cells of an index: its `starts` take 8 bytes a cell.  Above it, cells are made larger."""
_HALF_DIAGONAL = 0.8661
"""Half the diagonal of a cube of unit edge, sqrt(3) / 2, rounded up."""


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
    """(n,) indices of the sorted points in the original cloud."""
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
    mean1, variance1, count1 = _in_cylinders(core, normals, first, radius, reach)
    mean2, variance2, count2 = _in_cylinders(core, normals, second, radius, reach)
    has_enough = (count1 >= fewest_points) & (count2 >= fewest_points)
    # Lague et al., eq. 1, with variances of the means from the points' own standard deviations (Winiwarter et al.).
    sigma = np.sqrt(variance1 + variance2 + registration**2)
    return Distances(
        distance=np.where(has_enough, mean2 - mean1, np.nan),
        sigma=np.where(has_enough, sigma, np.nan),
        count1=count1,
        count2=count2,
    )


def _in_cylinders(
    core: Float64s, normals: Float64s, cloud: MeasuredCloud, radius: float, reach: float
) -> tuple[Float64s, Float64s, Int64s]:
    """Mean position along the normal of the points in each cylinder, the variance of that mean, and how many there are."""
    mean = np.full(len(core), np.nan)
    variance = np.full(len(core), np.nan)
    count = np.zeros(len(core), np.int64)
    if len(cloud.points) and len(core):
        index = cloud.index or index_points(cloud.points, 2.0 * radius)
        columns = np.ascontiguousarray(index.points.T)  # each coordinate in one piece, for vector instructions
        sigma_sq = cloud.sigma[index.order] ** 2
        _measure_cylinders(core, normals, index, columns, sigma_sq, radius, reach, mean, variance, count)
    return mean, variance, count


@kernel
def _measure_cylinders(
    core: Float64s, normals: Float64s, index: PointIndex, columns: Float64s, sigma_sq: Float64s, radius: float, reach: float,
    mean: Float64s, variance: Float64s, count: Int64s,
) -> None:  # fmt: skip
    """columns, sigma_sq: (3, n) the index's points, and (n,) their variances."""
    low = index.low
    edge = index.edge
    shape = index.shape
    starts = index.starts
    near_sq = (radius + _HALF_DIAGONAL * edge) ** 2  # cells whose centre is farther from the axis hold no point of the cylinder
    first = np.empty(3, np.int64)
    last = np.empty(3, np.int64)
    scratch = np.empty(2 * _BLOCK)  # of a block of points: 1 if inside, else 0; then t if inside, else 0
    for q in range(len(core)):
        n0, n1, n2 = normals[q]
        if not np.isfinite(n0):
            continue
        # The box of cells around the cylinder.
        for a in range(3):
            half_extent = abs(normals[q, a]) * reach + radius
            first[a], last[a] = _cells_within(core[q, a], half_extent, low[a], edge, shape[a])
        t_sum = 0.0
        sigma_sq_sum = 0.0
        inside_count = 0
        for i in range(first[0], last[0] + 1):
            x = low[0] + (i + 0.5) * edge - core[q, 0]
            for j in range(first[1], last[1] + 1):
                y = low[1] + (j + 0.5) * edge - core[q, 1]
                # Cells of a column, and so their points, are contiguous: of those near the axis, from the first to the last.
                column = (i * shape[1] + j) * shape[2]
                begin = -1
                end = -1
                for k in range(first[2], last[2] + 1):
                    z = low[2] + (k + 0.5) * edge - core[q, 2]
                    t = x * n0 + y * n1 + z * n2
                    if x * x + y * y + z * z - t * t <= near_sq:
                        if begin < 0:
                            begin = starts[column + k]
                        end = starts[column + k + 1]
                for p0 in range(begin, end, _BLOCK):
                    n = min(_BLOCK, end - p0)
                    px = columns[0, p0:]
                    py = columns[1, p0:]
                    pz = columns[2, p0:]
                    # This loop has no branches and no sums, so the compiler turns it into vector instructions; the next one
                    # adds up in the order of the points, so that the sums do not depend on the machine.
                    for p in range(n):
                        dx = px[p] - core[q, 0]
                        dy = py[p] - core[q, 1]
                        dz = pz[p] - core[q, 2]
                        t = dx * n0 + dy * n1 + dz * n2  # along the axis; the rest of the distance is across
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
    first = np.floor((centre - half_extent - low) / edge)
    last = np.floor((centre + half_extent - low) / edge)
    return max(int(first), 0), min(int(last), count - 1)


def index_points(points: Float64s, edge: float) -> PointIndex:
    """Sort points (n, 3), at least one, into cells of about `edge`, or larger ones if there were more than `_MOST_CELLS`."""
    low = points.min(axis=0)
    high = points.max(axis=0)
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
    number = (cells[:, 0] * cell_counts[1] + cells[:, 1]) * cell_counts[2] + cells[:, 2]
    _, first = np.unique(number, return_index=True)
    return np.sort(first)


def spacing_of(points: Float64s) -> float:
    """Median distance of a point (n, 3) from its nearest neighbour, estimated from some 5000 points."""
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)  # quick to build: few queries follow
    sample = points[:: max(1, len(points) // 5000)]
    distances, _ = tree.query(sample, k=2, workers=1)  # the nearest point of each is itself
    spacing = 1.0
    if len(points) > 1:
        spacing = float(np.median(distances[:, 1]))
    return max(spacing, 1e-9)  # duplicates of points must not make it 0


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
    """normals: (n, 3) in the order of the index.  out: (m, 3), nan where nothing is written."""
    points = index.points
    shape = index.shape
    first = np.empty(3, np.int64)
    last = np.empty(3, np.int64)
    for q in range(len(queries)):
        for a in range(3):
            first[a], last[a] = _cells_within(queries[q, a], radius, index.low[a], index.edge, shape[a])
        if last[2] < first[2]:
            continue
        nx = 0.0
        ny = 0.0
        nz = 0.0
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                # The points of a column's cells are contiguous.
                column = (i * shape[1] + j) * shape[2]
                for k in range(index.starts[column + first[2]], index.starts[column + last[2] + 1]):
                    dx = points[k, 0] - queries[q, 0]
                    dy = points[k, 1] - queries[q, 1]
                    dz = points[k, 2] - queries[q, 2]
                    if dx * dx + dy * dy + dz * dz <= radius * radius:
                        nx += normals[k, 0]
                        ny += normals[k, 1]
                        nz += normals[k, 2]
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 1e-9:  # opposite normals may cancel
            out[q, 0] = nx / length
            out[q, 1] = ny / length
            out[q, 2] = nz / length


def count_near(queries: Float64s, index: PointIndex, radius: float) -> Int64s:
    """(m,) number of the index's points within a radius of each query (m, 3)."""
    counts = np.zeros(len(queries), np.int64)
    _count_near(queries, index, radius, counts)
    return counts


@kernel
def _count_near(queries: Float64s, index: PointIndex, radius: float, counts: Int64s) -> None:
    points = index.points
    shape = index.shape
    first = np.empty(3, np.int64)
    last = np.empty(3, np.int64)
    for q in range(len(queries)):
        for a in range(3):
            first[a], last[a] = _cells_within(queries[q, a], radius, index.low[a], index.edge, shape[a])
        if last[2] < first[2]:
            continue
        count = 0
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                # The points of a column's cells are contiguous.
                column = (i * shape[1] + j) * shape[2]
                for k in range(index.starts[column + first[2]], index.starts[column + last[2] + 1]):
                    dx = points[k, 0] - queries[q, 0]
                    dy = points[k, 1] - queries[q, 1]
                    dz = points[k, 2] - queries[q, 2]
                    if dx * dx + dy * dy + dz * dz <= radius * radius:
                        count += 1
        counts[q] = count

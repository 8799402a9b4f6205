"""Clustering of changed points: those that are connected on the ground are one change, with its place, size and volume.

A volume is the sum of height differences over the cells that a change covers: its upper surface minus what was below it on the
other night.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import ndimage

from ..core.ground_grid import cells_of, quantile_by_cell
from ..types import Bools, Change, Float64s, GroundGrid, Int64s, Uint8s
from .evidence import CORE, Evidence
from .footprint import UNKNOWN_SHARE_SIGMA, Footprint, covered_shares

_TOP_QUANTILE = 0.9
"""Quantile of the heights in a cell that counts as its surface: one wrong point must not raise a roof."""
_SAME_VOLUME = 0.3
"""Largest difference in volume between a moved thing at both places, as a share of the larger one.  A weak test: with few
cameras, a vehicle and a stack may have the same volume."""
_SAME_HEIGHT = 0.25
"""Largest difference in height, as a share of the larger one."""
_SAME_LENGTH = 0.2
"""Largest difference in length, as a share of the larger one (measured on the yard: up to 0.07 for one thing, 0.28 or more for
two)."""
_SAME_COLOUR = 0.05
"""Largest difference between a moved thing's colours at both places, as shares of red and green."""
_FOOT_SHARE = 0.25
"""Cells where a change has less than this share of its height are its foot, and are not part of its footprint."""
_UPPER_SHARE = 0.1
"""Points lower than the highest nearby by more than this share of the change's height are its sides and cover no ground."""
_LEAST_MEASURED = 0.5
"""A change is judged by measured distances if more than this share of its points has one."""
_CLEAR_SIGMAS = 3.0
"""Smallest height of a change (0.9 quantile over its cells), in standard deviations of its points."""
_LEAST_CLEARED = 0.75
"""Smallest mean of `Evidence.cleared` over the points of a confirmed change; points below it do not count for its area."""
_LEAST_CLEARED_POSSIBLE = 0.5
"""Smallest such mean of a possible change, which only adds uncertainty: nights that lost half of their cameras reach it."""
_CERTAIN_RATIO = 6.0
"""Smallest ratio of a change's volume to its error from surface noise and from its edges; with less, edges of walls and
vehicles become changes."""
_EDGE_SPACINGS = 0.5
"""Error of edges for this ratio, in point spacings.  The volume's standard deviation takes a whole spacing: edges of matched
surfaces are off by about a pixel, equally all around."""
_NO_LIKENESS = -2.0
"""Likeness of a change whose images cannot be compared: below every correlation."""


@dataclass(frozen=True)
class ChangeCluster:
    """A change, and the core points of a night's evidence of which it consists."""

    change: Change
    footprint: Footprint
    rows: Int64s
    """Rows of the evidence."""
    vanished: bool
    """True if the points are of the earlier night: the thing has vanished."""
    confirmed: bool
    """True if enough cameras saw through its place for a report; otherwise its volume only adds uncertainty."""
    colour: Float64s
    """(2,) mean shares of red and green."""


def find_clusters(
    side: Evidence,
    colors: Uint8s,
    grid: GroundGrid,
    other: GroundPoints,
    *,
    vanished: bool,
    spacing: float,
    least_area: float,
    similar: float,
) -> list[ChangeCluster]:
    """Changes that a night's changed points form, if enough cameras saw through their places and the images differ.

    Not all of them are confirmed.

    Parameters
    ----------
    side, colors : evidence on one night's surface, and the colours (n, 3) of its core points.
    grid, other : cells of the ground, and the other night's cloud over them.
    vanished : True if that night is the earlier one, so that its changes have vanished.
    spacing : of the points.
    least_area : smallest surface area of a change.
    similar : median correlation of the images from which on a place has not changed.
    """
    labels, count = _labelled_cells(side, grid)
    changed_cells = np.where(side.changed, cells_of(grid, side.core), -1)
    label_of_point = np.where(changed_cells >= 0, labels.ravel()[changed_cells], 0)
    unchanged_cells = cells_of(grid, side.core[side.measured & ~side.changed])
    unchanged = np.bincount(unchanged_cells[unchanged_cells >= 0], minlength=labels.size).reshape(labels.shape) > 0
    clusters = []
    for number in range(1, count + 1):
        # 1. Is it large enough, and do cameras and images agree that something changed?
        rows = np.flatnonzero(label_of_point == number)
        surface = len(rows) * (CORE * spacing) ** 2
        if surface < least_area:
            continue
        likeness = _NO_LIKENESS
        correlations = side.ncc[rows][np.isfinite(side.ncc[rows])]
        if len(correlations):
            likeness = float(np.median(correlations))
        cleared = float(np.nanmean(side.cleared[rows]))
        if likeness >= similar or not cleared >= _LEAST_CLEARED_POSSIBLE:  # "not": cleared may be nan
            continue

        # 2. The ground that it covers.
        confirmed = cleared >= _LEAST_CLEARED
        footprint = _footprint(side, rows, labels == number, unchanged, grid, other, spacing, trimmed=confirmed)
        if footprint is None:
            continue

        # 3. Its place, size and volume.
        measured = side.measured[rows]
        swept_volume = np.inf  # with too few distances, the volume that the surface has swept is unknown
        if measured.mean() > _LEAST_MEASURED:
            swept_volume = surface * float(side.distance[rows][measured].mean())
        change = _describe(side, rows, footprint, grid, spacing, swept_volume)
        if change is None:
            continue
        change = replace(change, kind="vanished" if vanished else "new", likeness=likeness)
        mean_color = colors[rows].mean(axis=0)
        colour = mean_color[:2] / max(float(mean_color.sum()), 1.0)
        clusters.append(ChangeCluster(change, footprint, rows, vanished, confirmed, colour))
    return clusters


def _labelled_cells(side: Evidence, grid: GroundGrid) -> tuple[Int64s, int]:
    """(rows, columns) number of the connected group of cells with changed points, 0 for others; and the number of groups."""
    cells = cells_of(grid, side.core[side.changed])
    occupied = np.zeros((grid.rows, grid.columns), bool)
    occupied.ravel()[cells[cells >= 0]] = True  # a view: the array is contiguous
    # Close gaps of up to four cells; the margin keeps groups at the border of the grid whole.
    closed = ndimage.binary_closing(np.pad(occupied, 3), iterations=2)[3:-3, 3:-3]
    labels, count = ndimage.label(closed | occupied, np.ones((3, 3)))  # corners connect, too
    return labels, count


def paired(clusters: list[ChangeCluster]) -> list[tuple[ChangeCluster, ChangeCluster | None]]:
    """Moved things as pairs of a new and a vanished change, assigned by closest volume first; all other changes with None."""
    new = [cluster for cluster in clusters if not cluster.vanished]
    vanished = [cluster for cluster in clusters if cluster.vanished]
    candidates = []
    for i, a in enumerate(new):
        for j, b in enumerate(vanished):
            if _match(a, b):
                candidates.append((abs(a.change.volume - b.change.volume), i, j))

    origins: dict[int, int] = {}  # of each new change that is a moved thing, the vanished one
    for _, i, j in sorted(candidates):
        if i not in origins and j not in origins.values():
            origins[i] = j

    pairs: list[tuple[ChangeCluster, ChangeCluster | None]] = []
    for i, j in sorted(origins.items()):
        origin = vanished[j].change
        change = replace(new[i].change, kind="moved", from_x=origin.x, from_y=origin.y, from_z=origin.z)
        pairs.append((replace(new[i], change=change), vanished[j]))
    for i, cluster in enumerate(new):
        if i not in origins:
            pairs.append((cluster, None))
    for j, cluster in enumerate(vanished):
        if j not in origins.values():
            pairs.append((cluster, None))
    return pairs


def _match(cluster1: ChangeCluster, cluster2: ChangeCluster) -> bool:
    """Have two changes the same size and colour?"""
    a = cluster1.change
    b = cluster2.change
    same_colour = np.abs(cluster1.colour - cluster2.colour).max() <= _SAME_COLOUR
    return (
        _is_near(a.volume, b.volume, _SAME_VOLUME)
        and _is_near(a.height, b.height, _SAME_HEIGHT)
        and _is_near(a.length, b.length, _SAME_LENGTH)
        and bool(same_colour)
    )


def _is_near(a: float, b: float, share: float) -> bool:
    """Do two sizes differ by at most a share of the larger one?"""
    return abs(a - b) <= share * max(a, b)


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


def _footprint(
    side: Evidence, rows: Int64s, area: Bools, unchanged: Bools, grid: GroundGrid, other: GroundPoints, spacing: float, *,
    trimmed: bool,
) -> Footprint | None:  # fmt: skip
    """The ground that changed points cover; None if the surface below is unknown, or if they hardly rise above it.

    rows: of the evidence; area, unchanged: (rows, columns) cells of the change, and cells known to be unchanged; trimmed: leave
    out points that too few cameras saw through.
    """
    points = side.core[rows]
    levels = points @ grid.axes[2]
    cells = cells_of(grid, points)

    # 1. The surface below, from the other night's points; those far above belong to something else.
    near = ndimage.binary_dilation(area, iterations=4)
    lower = np.flatnonzero(near.ravel()[other.cells])
    lower = lower[other.levels[lower] <= levels.max() + 2 * spacing]
    if not len(lower):
        return None
    base = _fill_gaps(_tops(other.cells[lower], other.levels[lower], near.shape), near)

    # 2. Does the change rise above it, or is it a wall whose upper edge is noisy?
    top = _tops(cells, levels, near.shape)
    noise = float(np.median(side.sigma[rows]))
    typical_height = float(np.nanquantile(top - base, 0.9))
    if typical_height <= _CLEAR_SIGMAS * noise:
        return None

    # 3. Points on the sides cover no ground: only those near the highest of their own and the eight cells around count.
    highest = ndimage.maximum_filter(np.nan_to_num(top, nan=-np.inf), 3).ravel()[cells]
    is_upper = levels >= highest - max(_UPPER_SHARE * typical_height, _CLEAR_SIGMAS * noise)
    is_cleared = is_upper
    if trimmed:
        is_cleared = is_upper & ~(side.cleared[rows] < _LEAST_CLEARED)
    if not is_cleared.any():
        return None

    def ground_under(chosen: Bools) -> tuple[Int64s, Float64s, Float64s, Float64s]:
        """Cells that the chosen points cover, shares, heights, and the volume inferred where there are no points."""
        covered, without_points = covered_shares(grid, points[chosen], unchanged, CORE * spacing)
        share = covered.ravel()
        unseen = without_points.ravel()
        surface = _fill_gaps(_tops(cells[chosen], levels[chosen], near.shape), near)
        height = (surface - base).ravel()
        ground_cells = np.flatnonzero((share > 0) & (height > _FOOT_SHARE * typical_height))
        unseen_volume = unseen[ground_cells] * height[ground_cells] * grid.cell**2
        return ground_cells, share[ground_cells], height[ground_cells], unseen_volume

    ground_cells, share, height, unseen_volume = ground_under(is_cleared)
    if not len(ground_cells):
        return None

    # 4. What is unsure of the volume: parts without points, and points that are left out.
    most_share = share
    most_height = height
    if np.any(is_upper & ~is_cleared):
        _, most_share, most_height, unseen_volume = ground_under(is_upper)
    left_out = abs(float(most_share @ most_height - share @ height)) * grid.cell**2
    volume_sigma = UNKNOWN_SHARE_SIGMA * float(np.hypot(unseen_volume.sum(), left_out))
    return Footprint(ground_cells, share, base.ravel()[ground_cells], height, volume_sigma)


def _tops(cells: Int64s, levels: Float64s, shape: tuple[int, ...]) -> Float64s:
    """(rows, columns) height of the surface in each cell, from the heights of its points; nan without any."""
    return quantile_by_cell(cells, levels, int(np.prod(shape)), _TOP_QUANTILE).reshape(shape)


def _describe(
    side: Evidence, rows: Int64s, footprint: Footprint, grid: GroundGrid, spacing: float, swept_volume: float
) -> Change | None:
    """Place, size and volume of a change; None if the volume is hardly more than its error.

    swept_volume: volume between both nights' surfaces along the normals; for a strip of wall it is less than by heights.
    """
    # 1. Is the volume certain?
    is_covered = np.zeros((grid.rows, grid.columns), bool)
    is_covered.ravel()[footprint.cells] = True
    noise = float(np.median(side.sigma[rows]))
    volume = float((footprint.share * footprint.height).sum() * grid.cell**2)
    rim_length = float((is_covered & ~ndimage.binary_erosion(is_covered)).sum() * grid.cell)
    height = float(np.quantile(footprint.height, 0.9))
    area = float(footprint.share.sum() * grid.cell**2)
    rim_error = spacing * rim_length * height
    surface_error = area * noise
    if min(volume, swept_volume) < _CERTAIN_RATIO * np.hypot(_EDGE_SPACINGS * rim_error, surface_error):
        return None
    # 2. Length and width are those of the smallest rectangle around the centres of its cells; cells at the rim are half covered.
    row, column = np.divmod(footprint.cells, grid.columns)
    middle, sides_in_cells, _ = cv2.minAreaRect(np.column_stack([column, row]).astype(np.float32))
    width, length = sorted(float(max(extent, 1) * grid.cell) for extent in sides_in_cells)

    # 3. Its place is the middle of the rectangle, at half the height, from axes of the ground to those of the world.
    level = float(np.median(footprint.base)) + 0.5 * height
    x_on_ground = grid.left + (middle[0] + 0.5) * grid.cell
    y_on_ground = grid.top - (middle[1] + 0.5) * grid.cell
    centre = np.array([x_on_ground, y_on_ground, level]) @ grid.axes
    return Change(
        kind="new",
        x=float(centre[0]),
        y=float(centre[1]),
        z=float(centre[2]),
        length=length,
        width=width,
        height=height,
        area=area,
        volume=volume,
        volume_sigma=float(np.linalg.norm([rim_error, surface_error, footprint.volume_sigma])),
        significance=float(np.median(side.significance[rows])),
        likeness=_NO_LIKENESS,
        points=len(rows),
        cameras="",
    )


def _fill_gaps(values: Float64s, inside: Bools) -> Float64s:
    """Values (rows, columns), with the nearest known value of the cells `inside` wherever these have none."""
    known = np.isfinite(values) & inside
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)], dtype=np.float64)

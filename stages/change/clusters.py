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
_SAME_VOLUME, _SAME_HEIGHT, _SAME_LENGTH = 0.3, 0.25, 0.2
"""Largest difference in volume, height and length of a moved thing, as shares of the larger one.  On the yard (eight cameras),
lengths differ by up to 7 % for one thing, 28 % or more for two; volumes alone (four cameras) took a vehicle for a stack."""
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
_LEAST_CLEARED, _LEAST_CLEARED_POSSIBLE = 0.75, 0.5
"""Smallest mean of `Evidence.cleared` over a change's points: for a confirmed change, and for a possible one (nights that lost
half of their cameras).  Points below the first do not count for the area of a confirmed change."""
_CERTAIN_RATIO, _EDGE_SPACINGS = 6.0, 0.5
"""Smallest ratio of a change's volume to its error from surface noise and from edges that are wrong by `_EDGE_SPACINGS`.  The
volume's standard deviation takes a whole spacing: edges of matched surfaces are off by about a pixel, equally all around."""


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
    cells = np.where(side.changed, cells_of(grid, side.core), -1)
    occupied = np.zeros(grid.rows * grid.columns, bool)
    occupied[cells[cells >= 0]] = True
    closed = ndimage.binary_closing(np.pad(occupied.reshape(grid.rows, grid.columns), 3), iterations=2)[3:-3, 3:-3]
    labels, count = ndimage.label(closed | occupied.reshape(closed.shape), np.ones((3, 3)))
    label_of = np.where(cells >= 0, labels.ravel()[cells], 0)
    unchanged_cells = cells_of(grid, side.core[side.measured & ~side.changed])
    unchanged = np.bincount(unchanged_cells[unchanged_cells >= 0], minlength=occupied.size).reshape(closed.shape) > 0
    clusters = []
    for number in range(1, count + 1):
        rows = np.flatnonzero(label_of == number)
        surface = len(rows) * (CORE * spacing) ** 2
        if surface < least_area:
            continue
        correlations = side.ncc[rows][np.isfinite(side.ncc[rows])]
        likeness, cleared = float(np.median(correlations)) if len(correlations) else -2.0, float(np.nanmean(side.cleared[rows]))
        if likeness >= similar or not cleared >= _LEAST_CLEARED_POSSIBLE:
            continue
        confirmed = cleared >= _LEAST_CLEARED
        footprint = _footprint(side, rows, labels == number, unchanged, grid, other, spacing, trimmed=confirmed)
        if footprint is None:
            continue
        too_few = side.measured[rows].mean() <= _LEAST_MEASURED  # too few distances for the volume that the surface has swept
        swept_volume = np.inf if too_few else surface * float(side.distance[rows][side.measured[rows]].mean())
        change = _describe(side, rows, footprint, grid, spacing, swept_volume)
        if change is not None:
            mean_color = colors[rows].mean(axis=0)
            colour = mean_color[:2] / max(float(mean_color.sum()), 1.0)
            change = replace(change, kind="vanished" if vanished else "new", likeness=likeness)
            clusters.append(ChangeCluster(change, footprint, rows, vanished, confirmed, colour))
    return clusters


def paired(clusters: list[ChangeCluster]) -> list[tuple[ChangeCluster, ChangeCluster | None]]:
    """Moved things as pairs of a new and a vanished change, assigned by closest volume first; all other changes with None."""
    new, vanished = [b for b in clusters if not b.vanished], [b for b in clusters if b.vanished]
    candidates = sorted(
        (abs(a.change.volume - b.change.volume), i, j) for i, a in enumerate(new) for j, b in enumerate(vanished) if _match(a, b)
    )
    origins: dict[int, int] = {}
    for _, i, j in candidates:
        if i not in origins and j not in origins.values():
            origins[i] = j
    moved = []
    for i, j in sorted(origins.items()):
        origin = vanished[j].change
        change = replace(new[i].change, kind="moved", from_x=origin.x, from_y=origin.y, from_z=origin.z)
        moved.append((replace(new[i], change=change), vanished[j]))
    single = [b for i, b in enumerate(new) if i not in origins] + [b for j, b in enumerate(vanished) if j not in origins.values()]
    return [*moved, *((cluster, None) for cluster in single)]


def _match(cluster1: ChangeCluster, cluster2: ChangeCluster) -> bool:
    a, b = cluster1.change, cluster2.change
    sizes = ((a.volume, b.volume, _SAME_VOLUME), (a.height, b.height, _SAME_HEIGHT), (a.length, b.length, _SAME_LENGTH))
    same_size = all(abs(x - y) <= share * max(x, y) for x, y, share in sizes)
    return same_size and bool(np.abs(cluster1.colour - cluster2.colour).max() <= _SAME_COLOUR)


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
    points, count = side.core[rows], grid.rows * grid.columns
    levels, cells = points @ grid.axes[2], cells_of(grid, points)
    near = ndimage.binary_dilation(area, iterations=4)
    lower = np.flatnonzero(near.ravel()[other.cells])
    lower = lower[other.levels[lower] <= levels.max() + 2 * spacing]
    if not len(lower):
        return None
    base = _fill_gaps(quantile_by_cell(other.cells[lower], other.levels[lower], count, _TOP_QUANTILE).reshape(near.shape), near)
    top = quantile_by_cell(cells, levels, count, _TOP_QUANTILE).reshape(near.shape)
    noise, typical_height = float(np.median(side.sigma[rows])), float(np.nanquantile(top - base, 0.9))
    if typical_height <= _CLEAR_SIGMAS * noise:  # a wall whose upper edge is noisy
        return None
    highest = ndimage.maximum_filter(np.nan_to_num(top, nan=-np.inf), 3).ravel()[cells]
    is_upper = levels >= highest - max(_UPPER_SHARE * typical_height, _CLEAR_SIGMAS * noise)
    is_cleared = is_upper & ~(side.cleared[rows] < _LEAST_CLEARED) if trimmed else is_upper
    if not is_cleared.any():
        return None

    def ground_under(chosen: Bools) -> tuple[Int64s, Float64s, Float64s, Float64s]:
        """Cells that the chosen points cover, shares, heights, and the volume inferred where there are no points."""
        share, unseen = (part.ravel() for part in covered_shares(grid, points[chosen], unchanged, CORE * spacing))
        surface = _fill_gaps(quantile_by_cell(cells[chosen], levels[chosen], count, _TOP_QUANTILE).reshape(near.shape), near)
        height = (surface - base).ravel()
        ground_cells = np.flatnonzero((share > 0) & (height > _FOOT_SHARE * typical_height))
        return ground_cells, share[ground_cells], height[ground_cells], unseen[ground_cells] * height[ground_cells] * grid.cell**2

    ground_cells, share, height, unseen = ground_under(is_cleared)
    if not len(ground_cells):
        return None
    most_share, most_height = share, height
    if np.any(is_upper & ~is_cleared):
        _, most_share, most_height, unseen = ground_under(is_upper)
    left_out = abs(float(most_share @ most_height - share @ height)) * grid.cell**2
    volume_sigma = UNKNOWN_SHARE_SIGMA * float(np.hypot(unseen.sum(), left_out))
    return Footprint(ground_cells, share, base.ravel()[ground_cells], height, volume_sigma)


def _describe(
    side: Evidence, rows: Int64s, footprint: Footprint, grid: GroundGrid, spacing: float, swept_volume: float
) -> Change | None:
    """Place, size and volume of a change; None if the volume is hardly more than its error.

    swept_volume: volume between both nights' surfaces along the normals; for a strip of wall it is less than by heights.
    """
    is_covered = np.zeros((grid.rows, grid.columns), bool)
    is_covered.ravel()[footprint.cells] = True
    noise = float(np.median(side.sigma[rows]))
    volume = float((footprint.share * footprint.height).sum() * grid.cell**2)
    rim_length = float((is_covered & ~ndimage.binary_erosion(is_covered)).sum() * grid.cell)
    height = float(np.quantile(footprint.height, 0.9))
    area = float(footprint.share.sum() * grid.cell**2)
    rim_error, surface_error = spacing * rim_length * height, area * noise
    if min(volume, swept_volume) < _CERTAIN_RATIO * np.hypot(_EDGE_SPACINGS * rim_error, surface_error):
        return None
    row, column = np.divmod(footprint.cells, grid.columns)
    middle, sides, _ = cv2.minAreaRect(np.column_stack([column, row]).astype(np.float32))
    level = float(np.median(footprint.base)) + 0.5 * height
    centre = np.array([grid.left + (middle[0] + 0.5) * grid.cell, grid.top - (middle[1] + 0.5) * grid.cell, level]) @ grid.axes
    sides = sorted(float(max(v, 1) * grid.cell) for v in sides)  # cells at the rim are half covered
    return Change(
        kind="new",
        x=float(centre[0]),
        y=float(centre[1]),
        z=float(centre[2]),
        length=sides[1],
        width=sides[0],
        height=height,
        area=area,
        volume=volume,
        volume_sigma=float(np.linalg.norm([rim_error, surface_error, footprint.volume_sigma])),
        significance=float(np.median(side.significance[rows])),
        likeness=-2.0,
        points=len(rows),
        cameras="",
    )


def _fill_gaps(values: Float64s, inside: Bools) -> Float64s:
    """Values (rows, columns), with the nearest known value of the cells `inside` wherever these have none."""
    known = np.isfinite(values) & inside
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)], dtype=np.float64)

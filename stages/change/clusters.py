"""Clustering of changed points: those that are connected on the ground are one change, with its place, size and volume.

A volume is the sum of height differences over the cells that a change covers: its upper surface minus what was below it on the
other night.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import ndimage

from ..core.ground_grid import cells_of
from ..types import Bools, Change, Float64s, GroundGrid, Int64s, Uint8s
from .evidence import CORE, Epoch, Evidence
from .footprint import UNKNOWN_SHARE_SIGMA, Footprint, covered_shares
from .ground_points import GroundPoints, fill_gaps, surface_below, tops
from .hull import NOTHING_UNSEEN, UnseenParts

_SAME_VOLUME = 0.3
"""Largest difference in volume between a moved thing at both places, as a share of the larger one.  A weak test: with few
cameras, a vehicle and a stack may have the same volume."""
_SAME_HEIGHT = 0.12
"""Largest difference in height, as a share of the larger one."""
_SAME_LENGTH = 0.2
"""Largest difference in length, as a share of the larger one (measured on the yard: up to 0.07 for one thing, 0.28 or more for
two)."""
_MOST_UNSEEN = 1.0
"""Largest volume of its unseen parts, as a share of the seen one, with which the size of a thing is known well enough to find it
again elsewhere."""
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
SURE_SIGMAS = 1.96
"""Standard deviations between a value and either end of its interval: 95 % of normal errors lie within."""
_NO_LIKENESS = -2.0
"""Likeness of a change whose images cannot be compared: below every correlation."""


@dataclass(frozen=True)
class Side:
    """A night, compared with the other one."""

    night: Epoch
    evidence: Evidence
    colors: Uint8s
    """(n, 3) colours of the evidence's points."""
    ground: GroundPoints
    """The night's cloud over the ground."""


@dataclass(frozen=True)
class Surface:
    """Seen surface of a change: points of one or several nights; arrays are (n,) unless stated otherwise."""

    points: Float64s
    """(n, 3) points."""
    sigma: Float64s
    """Their standard deviations, world units."""
    cleared: Float64s
    """`Evidence.cleared` of the points."""


@dataclass(frozen=True)
class ChangeCluster:
    """A change: its surface, the ground that it covers, and the core points of tonight's evidence on it."""

    change: Change
    footprint: Footprint
    surface: Surface
    rows: Int64s
    """Rows of the evidence; empty for a change that tonight shows nothing of."""
    vanished: bool
    """True if the points are of the earlier night: the thing has vanished."""
    confirmed: bool
    """True if enough cameras saw through its place for a report, and its volume is clearly more than its error; otherwise it only
    adds uncertainty."""
    colour: Float64s
    """(2,) mean shares of red and green."""
    swept_volume: float = np.inf
    """Volume between both nights' surfaces, world units cubed; inf if too few distances are known."""
    seen: bool = True
    """False if it is carried on from earlier nights, and tonight knows nothing of it."""
    unseen: UnseenParts = NOTHING_UNSEEN
    """What unseen parts of it may fill."""


def changed_groups(side: Evidence, grid: GroundGrid) -> Int64s:
    """(rows, columns) number of the connected group of cells with changed points, 0 for others."""
    cells = cells_of(grid, side.core[side.changed])
    occupied = np.zeros((grid.rows, grid.columns), bool)
    occupied.ravel()[cells[cells >= 0]] = True  # a view: the array is contiguous
    # Close gaps of up to four cells; the margin keeps groups at the border of the grid whole.
    closed = ndimage.binary_closing(np.pad(occupied, 3), iterations=2)[3:-3, 3:-3]
    labels, _ = ndimage.label(closed | occupied, np.ones((3, 3)))  # corners connect, too
    return np.asarray(labels, dtype=np.int64)


def unchanged_cells(side: Evidence, grid: GroundGrid) -> Bools:
    """(rows, columns) cells in which points were measured that have not changed."""
    cells = cells_of(grid, side.core[side.measured & ~side.changed])
    counts = np.bincount(cells[cells >= 0], minlength=grid.rows * grid.columns)
    return np.asarray(counts.reshape(grid.rows, grid.columns) > 0)


def find_clusters(
    own: Side,
    other: GroundPoints,
    grid: GroundGrid,
    groups: Int64s,
    *,
    vanished: bool,
    spacing: float,
    least_area: float,
    similar: float,
) -> list[ChangeCluster]:
    """Changes that a night's changed points form, if at least half of the cameras saw through their places and the images differ.

    Not all of them are confirmed.

    Parameters
    ----------
    own, other : the night, compared with the other one; and the other night's cloud over the ground.
    grid : cells of the ground.
    groups : (rows, columns) number of the group of changed cells that may be a change; 0 for none.
    vanished : True if that night is the earlier one, so that its changes have vanished.
    spacing : of the points.
    least_area : smallest surface area of a change.
    similar : median correlation of the images from which on a place has not changed.
    """
    side = own.evidence
    label_of_point = groups_of_points(side, grid, groups)
    unchanged = unchanged_cells(side, grid)
    clusters = []
    for number in np.unique(groups[groups > 0]):
        # 1. Is it large enough, and do cameras and images agree that something changed?
        rows = np.flatnonzero(label_of_point == number)
        area = len(rows) * (CORE * spacing) ** 2
        if area < least_area:
            continue
        likeness = likeness_of(side, rows)
        cleared = float(np.nanmean(side.cleared[rows]))
        if likeness >= similar or not cleared >= _LEAST_CLEARED_POSSIBLE:  # "not": cleared may be nan
            continue

        # 2. The ground that it covers.
        is_cleared = cleared >= _LEAST_CLEARED
        surface = surface_of(side, rows)
        footprint = footprint_of(surface, groups == number, unchanged, grid, other, spacing, trimmed=is_cleared)
        if footprint is None:
            continue

        # 3. Its place, size and volume.
        measured = side.measured[rows]
        swept_volume = np.inf  # with too few distances, the volume that the surface has swept is unknown
        if measured.mean() > _LEAST_MEASURED:
            swept_volume = area * float(side.distance[rows][measured].mean())
        confirmed = is_cleared and _is_certain(surface, footprint, grid, spacing, swept_volume)
        change = describe(surface, footprint, grid, spacing)
        change = replace(
            change,
            kind="vanished" if vanished else "new",
            likeness=likeness,
            significance=float(np.median(side.significance[rows])),
        )
        colour = colour_of(own.colors[rows])
        clusters.append(ChangeCluster(change, footprint, surface, rows, vanished, confirmed, colour, swept_volume))
    return clusters


def groups_of_points(side: Evidence, grid: GroundGrid, groups: Int64s) -> Int64s:
    """(n,) number of the group that each core point belongs to, 0 for none; groups: (rows, columns), see `find_clusters`."""
    cells = np.where(side.changed, cells_of(grid, side.core), -1)
    return np.where(cells >= 0, groups.ravel()[cells], 0)


def surface_of(side: Evidence, rows: Int64s) -> Surface:
    """The surface that some core points show."""
    return Surface(side.core[rows], side.sigma[rows], side.cleared[rows].astype(np.float64))


def likeness_of(side: Evidence, rows: Int64s) -> float:
    """Median correlation of the photographs at some core points; -2 if they cannot be compared."""
    correlations = side.ncc[rows][np.isfinite(side.ncc[rows])]
    if not len(correlations):
        return _NO_LIKENESS
    return float(np.median(correlations))


def colour_of(colors: Uint8s) -> Float64s:
    """(2,) mean shares of red and green of colours (n, 3), at least one."""
    mean_color = colors.mean(axis=0)
    return np.asarray(mean_color[:2] / max(float(mean_color.sum()), 1.0), dtype=np.float64)


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
    for i, cluster in enumerate(new):
        pairs.append((cluster, vanished[origins[i]] if i in origins else None))
    for j, cluster in enumerate(vanished):
        if j not in origins.values():
            pairs.append((cluster, None))
    return pairs


def _match(cluster1: ChangeCluster, cluster2: ChangeCluster) -> bool:
    """Have two changes the same size and colour, as far as they were seen?"""
    a = cluster1.change
    b = cluster2.change
    if any(cluster.unseen.volume.sum() > _MOST_UNSEEN * cluster.change.volume for cluster in (cluster1, cluster2)):
        return False
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


def footprint_of(
    surface: Surface,
    area: Bools,
    unchanged: Bools,
    grid: GroundGrid,
    other: GroundPoints,
    spacing: float,
    *,
    trimmed: bool,
) -> Footprint | None:
    """The ground that a surface covers; None if what is below it is unknown, or if it hardly rises above that.

    Parameters
    ----------
    surface : its points, at least one, over the grid.
    area, unchanged : (rows, columns) cells of the change, and cells known to be unchanged.
    grid, other : cells of the ground, and the other night's cloud over them.
    spacing : of the points.
    trimmed : leave out points that too few cameras saw through.
    """
    points = surface.points
    levels = points @ grid.axes[2]
    cells = cells_of(grid, points)

    # 1. The surface below, from the other night's points; those far above belong to something else.
    near = ndimage.binary_dilation(area, iterations=4)
    base = surface_below(near, other, float(levels.max()) + 2 * spacing)
    if base is None:
        return None

    # 2. Does the change rise above it, or is it a wall whose upper edge is noisy?
    top = tops(cells, levels, near.shape)
    noise = float(np.median(surface.sigma))
    typical_height = float(np.nanquantile(top - base, 0.9))
    if typical_height <= _CLEAR_SIGMAS * noise:
        return None

    # 3. Points on the sides cover no ground: only those near the highest of their own and the eight cells around count.
    highest = ndimage.maximum_filter(np.nan_to_num(top, nan=-np.inf), 3).ravel()[cells]
    is_upper = levels >= highest - max(_UPPER_SHARE * typical_height, _CLEAR_SIGMAS * noise)
    is_cleared = is_upper
    if trimmed:
        is_cleared = is_upper & ~(surface.cleared < _LEAST_CLEARED)
    if not is_cleared.any():
        return None

    def ground_under(chosen: Bools) -> tuple[Int64s, Float64s, Float64s, Float64s]:
        """Cells that the chosen points cover, shares, heights, and the volume inferred where there are no points."""
        covered, without_points = covered_shares(grid, points[chosen], unchanged, CORE * spacing)
        share = covered.ravel()
        unseen = without_points.ravel()
        top_of_chosen = fill_gaps(tops(cells[chosen], levels[chosen], near.shape), near)
        height = (top_of_chosen - base).ravel()
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


def with_unseen(cluster: ChangeCluster, unseen: UnseenParts, grid: GroundGrid, spacing: float) -> ChangeCluster:
    """The change with the interval of its volume: its seen part, and what unseen parts may add.

    The least volume is that below which points were seen, the most that of the seen part and all unseen ones together, whose
    border is as uncertain as that of the seen part.

    Parameters
    ----------
    cluster, unseen : the change, and what its unseen parts may fill.
    grid, spacing : cells of the ground, and the spacing of the points.
    """
    change = cluster.change
    seen_errors = errors_of(cluster.surface, cluster.footprint, grid, spacing)
    seen_sigma = float(np.linalg.norm(seen_errors))
    all_cells = np.union1d(cluster.footprint.cells, unseen.cells)
    most_sigma = float(np.hypot(spacing * _rim_length(all_cells, grid) * change.height, seen_errors[1]))
    inferred = cluster.footprint.volume_sigma / UNKNOWN_SHARE_SIGMA
    hidden = float(unseen.volume.sum())
    change = replace(
        change,
        volume_sigma=float(np.linalg.norm([seen_sigma, cluster.footprint.volume_sigma, UNKNOWN_SHARE_SIGMA * hidden])),
        volume_least=max(0.0, change.volume - inferred - SURE_SIGMAS * seen_sigma),
        volume_most=change.volume + hidden + SURE_SIGMAS * max(seen_sigma, most_sigma),
    )
    return replace(cluster, change=change, unseen=unseen)


def errors_of(surface: Surface, footprint: Footprint, grid: GroundGrid, spacing: float) -> tuple[float, float]:
    """Standard deviations of a volume: that from the change's edges, and that from the noise of its surface.

    Parameters
    ----------
    surface, footprint : of the change.
    grid, spacing : cells of the ground, and the spacing of the points.
    """
    height = float(np.quantile(footprint.height, 0.9))
    area = float(footprint.share.sum() * grid.cell**2)
    return spacing * _rim_length(footprint.cells, grid) * height, area * float(np.median(surface.sigma))


def _rim_length(cells: Int64s, grid: GroundGrid) -> float:
    """Length of the border of some cells (m,) of the ground."""
    is_covered = np.zeros((grid.rows, grid.columns), bool)
    is_covered.ravel()[cells] = True
    return float((is_covered & ~ndimage.binary_erosion(is_covered)).sum() * grid.cell)


def _is_certain(surface: Surface, footprint: Footprint, grid: GroundGrid, spacing: float, swept_volume: float) -> bool:
    """Is the volume clearly more than its error?

    swept_volume: volume between both nights' surfaces along the normals; for a strip of wall it is less than by heights.
    """
    rim_error, surface_error = errors_of(surface, footprint, grid, spacing)
    volume = min(footprint.volume(grid), swept_volume)
    return volume >= _CERTAIN_RATIO * float(np.hypot(_EDGE_SPACINGS * rim_error, surface_error))


def describe(surface: Surface, footprint: Footprint, grid: GroundGrid, spacing: float) -> Change:
    """Place, size and volume of a change.

    Parameters
    ----------
    surface, footprint, grid, spacing : the change, and the cells of the ground and spacing of the points.
    """
    # 1. The seen volume, and its standard deviation.
    volume = footprint.volume(grid)
    height = float(np.quantile(footprint.height, 0.9))
    area = float(footprint.share.sum() * grid.cell**2)
    rim_error, surface_error = errors_of(surface, footprint, grid, spacing)

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
        likeness=_NO_LIKENESS,
        points=len(surface.points),
    )

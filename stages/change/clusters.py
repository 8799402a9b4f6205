"""Changed points become things: what hangs together on the ground is one change, with its place, size and volume.

Volumes are differences of heights over the cells that a change covers: of its upper surface less what was below it on the other
night.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import ndimage

from ..core.ground_grid import cells_of, quantile_by_cell
from ..types import Bools, Change, Float64s, GroundGrid, Int64s
from .evidence import CORE, Evidence
from .footprint import OPEN, Footprint, covered

_TOP = 0.9
"""Quantile of heights over a cell that counts as its surface: one wrong point must not raise a roof."""
_SAME_VOLUME, _SAME_HEIGHT, _SAME_LENGTH = 0.3, 0.25, 0.2
"""What has moved keeps its volume, height and length within these shares.  The yard by eight cameras, night after night: lengths
of one thing differ by up to 7 %, of two things by 28 % and more; volumes alone took a vehicle for a stack by four cameras..."""
_SAME_COLOUR = 0.05
"""...and its colour, as shares of red and green, within this."""
_FOOT = 0.25
"""Cells where a thing has less than this share of its height lie at its foot, and don't count for its sides."""
_UPPER = 0.1
"""What lies lower than the highest nearby by more than this share of the change's height are its sides, which cover nothing."""
_LEAST_MEASURED = 0.5
"""What has distances for more than this share of its points is judged by them."""
_CLEAR = 3.0
"""Most of a change is higher than so many standard deviations of its points."""
_CLEARED, _LIKELY = 0.75, 0.5
"""Of the cameras that saw it, this share must see through its place, in the mean over its points; single points for which it is
less do not count for its area.  Where most do, and not so many, it may be a change: nights that lost half of their cameras."""
_CERTAIN, _EDGE = 6.0, 0.5
"""The volume of a change is so many times what noise of its surface, and such a share of a spacing along its edges, amount to.
Its standard deviation holds a whole spacing: edges of matched surfaces are about a pixel off, alike all around."""


@dataclass(frozen=True)
class ChangeCluster:
    """A change, and which core points of a night's evidence it consists of."""

    change: Change
    footprint: Footprint
    rows: Int64s
    """Of the evidence."""
    of_then: bool
    """The points are those of then: it has vanished."""
    confirmed: bool
    """By so many cameras that it is reported; else its volume is a doubt."""
    colour: Float64s
    """(2,) mean shares of red and green."""


def find_clusters(
    side: Evidence,
    colors: Float64s,
    grid: GroundGrid,
    other: Over,
    *,
    of_then: bool,
    spacing: float,
    least_area: float,
    alike: float,
) -> list[ChangeCluster]:
    """The things that a night's changed points make, as far as most cameras say so that could and the photographs differ.

    Not all are confirmed.

    Parameters
    ----------
    side, colors : what is known of one night's surface, and (n, 3) of its core points.
    grid, other : cells of the ground, and the other night's cloud over it.
    of_then : is that night the earlier one: is what it alone has, gone?
    spacing : of the points.
    least_area : a change has at least so much surface.
    alike : places whose pictures correlate better, in the median, have not changed.
    """
    cells = np.where(side.changed, cells_of(grid, side.core), -1)
    covered = np.zeros(grid.rows * grid.columns, bool)
    covered[cells[cells >= 0]] = True
    closed = ndimage.binary_closing(np.pad(covered.reshape(grid.rows, grid.columns), 3), iterations=2)[3:-3, 3:-3]
    labels, count = ndimage.label(closed | covered.reshape(closed.shape), np.ones((3, 3)))
    label_of = np.where(cells >= 0, labels.ravel()[cells], 0)
    still = cells_of(grid, side.core[side.measured & ~side.changed])
    same = np.bincount(still[still >= 0], minlength=covered.size).reshape(closed.shape) > 0
    found = []
    for number in range(1, count + 1):
        rows = np.flatnonzero(label_of == number)
        surface = len(rows) * (CORE * spacing) ** 2
        if surface < least_area:
            continue
        known = side.ncc[rows][np.isfinite(side.ncc[rows])]
        likeness, cleared = float(np.median(known)) if len(known) else -2.0, float(np.nanmean(side.cleared[rows]))
        if likeness >= alike or not cleared >= _LIKELY:
            continue
        confirmed = cleared >= _CLEARED
        footprint = _footprint(side, rows, labels == number, same, grid, other, spacing, trimmed=confirmed)
        if footprint is None:
            continue
        far = side.measured[rows].mean() <= _LEAST_MEASURED  # then distances do not tell what the surface has swept
        swept = np.inf if far else surface * float(side.distance[rows][side.measured[rows]].mean())
        change = _described(side, rows, footprint, grid, spacing, swept)
        if change is not None:
            shares = colors[rows].mean(axis=0)
            colour = shares[:2] / max(float(shares.sum()), 1.0)
            change = replace(change, kind="vanished" if of_then else "new", likeness=likeness)
            found.append(ChangeCluster(change, footprint, rows, of_then, confirmed, colour))
    return found


def paired(clusters: list[ChangeCluster]) -> list[tuple[ChangeCluster, ChangeCluster | None]]:
    """What has moved: a new thing with the vanished one that it was before, the most alike first; all others alone."""
    new, gone = [b for b in clusters if not b.of_then], [b for b in clusters if b.of_then]
    ways = sorted(
        (abs(a.change.volume - b.change.volume), i, j) for i, a in enumerate(new) for j, b in enumerate(gone) if _alike(a, b)
    )
    came_from: dict[int, int] = {}
    for _, i, j in ways:
        if i not in came_from and j not in came_from.values():
            came_from[i] = j
    moved = [(_moved(new[i], gone[j]), gone[j]) for i, j in sorted(came_from.items())]
    left = [b for i, b in enumerate(new) if i not in came_from] + [b for j, b in enumerate(gone) if j not in came_from.values()]
    return [*moved, *((cluster, None) for cluster in left)]


def _alike(one: ChangeCluster, two: ChangeCluster) -> bool:
    a, b = one.change, two.change
    sizes = ((a.volume, b.volume, _SAME_VOLUME), (a.height, b.height, _SAME_HEIGHT), (a.length, b.length, _SAME_LENGTH))
    same = all(abs(x - y) <= share * max(x, y) for x, y, share in sizes)
    return same and bool(np.abs(one.colour - two.colour).max() <= _SAME_COLOUR)


def _moved(new: ChangeCluster, gone: ChangeCluster) -> ChangeCluster:
    was = gone.change
    return replace(new, change=replace(new.change, kind="moved", from_x=was.x, from_y=was.y, from_z=was.z))


@dataclass(frozen=True)
class Over:
    """Points over the cells of the ground, those over none left out."""

    cells: Int64s
    """(n,)"""
    levels: Float64s
    """(n,) heights, world lengths."""


def over_ground(grid: GroundGrid, points: Float64s) -> Over:
    """Points (n, 3) over the ground."""
    cells = cells_of(grid, points)
    inside = cells >= 0
    return Over(cells[inside], points[inside] @ grid.axes[2])


def _footprint(
    side: Evidence, rows: Int64s, around: Bools, same: Bools, grid: GroundGrid, other: Over, spacing: float, *, trimmed: bool
) -> Footprint | None:
    """The ground that changed points cover; None where nothing is known of what was below, or they hardly stand above it.

    rows: of the side; around, same: (rows, columns) the cells over which they are, and those that are as they were; trimmed:
    without points that too few cameras see through.
    """
    points, count = side.core[rows], grid.rows * grid.columns
    levels, cells = points @ grid.axes[2], cells_of(grid, points)
    near = ndimage.binary_dilation(around, iterations=4)
    below = np.flatnonzero(near.ravel()[other.cells])
    below = below[other.levels[below] <= levels.max() + 2 * spacing]
    if not len(below):
        return None
    base = _filled(quantile_by_cell(other.cells[below], other.levels[below], count, _TOP).reshape(near.shape), near)
    top = quantile_by_cell(cells, levels, count, _TOP).reshape(near.shape)
    noise, typical = float(np.median(side.sigma[rows])), float(np.nanquantile(top - base, 0.9))
    if typical <= _CLEAR * noise:  # a wall whose upper edge wavers
        return None
    highest = ndimage.maximum_filter(np.nan_to_num(top, nan=-np.inf), 3).ravel()[cells]
    upper = levels >= highest - max(_UPPER * typical, _CLEAR * noise)
    cleared = upper & ~(side.cleared[rows] < _CLEARED) if trimmed else upper
    if not cleared.any():
        return None

    def over(chosen: Bools) -> tuple[Int64s, Float64s, Float64s, Float64s]:
        """Cells that these points cover, shares, heights, and the volume that none of them shows."""
        share, unseen = (part.ravel() for part in covered(grid, points[chosen], same, CORE * spacing))
        surface = _filled(quantile_by_cell(cells[chosen], levels[chosen], count, _TOP).reshape(near.shape), near)
        height = (surface - base).ravel()
        found = np.flatnonzero((share > 0) & (height > _FOOT * typical))
        return found, share[found], height[found], unseen[found] * height[found] * grid.cell**2

    found, share, height, unseen = over(cleared)
    if not len(found):
        return None
    most_share, most_height = share, height
    if np.any(upper & ~cleared):
        _, most_share, most_height, unseen = over(upper)
    left_out = abs(float(most_share @ most_height - share @ height)) * grid.cell**2
    doubt = OPEN * float(np.hypot(unseen.sum(), left_out))
    return Footprint(found, share, base.ravel()[found], height, doubt)


def _described(
    side: Evidence, rows: Int64s, footprint: Footprint, grid: GroundGrid, spacing: float, swept_volume: float
) -> Change | None:
    """Place, size and volume of what changed points make; None where the volume is hardly more than its error.

    swept_volume: between both nights' surfaces, along the normals: for a strip of wall less than heights over the footprint give.
    """
    covers = np.zeros((grid.rows, grid.columns), bool)
    covers.ravel()[footprint.cells] = True
    noise = float(np.median(side.sigma[rows]))
    volume = float((footprint.share * footprint.height).sum() * grid.cell**2)
    edge = float((covers & ~ndimage.binary_erosion(covers)).sum() * grid.cell)
    tall = float(np.quantile(footprint.height, 0.9))
    area = float(footprint.share.sum() * grid.cell**2)
    rim, surface = spacing * edge * tall, area * noise
    if min(volume, swept_volume) < _CERTAIN * np.hypot(_EDGE * rim, surface):
        return None
    row, column = np.divmod(footprint.cells, grid.columns)
    middle, sides, _ = cv2.minAreaRect(np.column_stack([column, row]).astype(np.float32))
    level = float(np.median(footprint.base)) + 0.5 * tall
    place = np.array([grid.left + (middle[0] + 0.5) * grid.cell, grid.top - (middle[1] + 0.5) * grid.cell, level]) @ grid.axes
    sides = sorted(float(max(v, 1) * grid.cell) for v in sides)  # cells at the rim are covered by half
    return Change(
        kind="new",
        x=float(place[0]),
        y=float(place[1]),
        z=float(place[2]),
        length=sides[1],
        width=sides[0],
        height=tall,
        area=area,
        volume=volume,
        volume_sigma=float(np.linalg.norm([rim, surface, footprint.doubt])),
        significance=float(np.median(side.significance[rows])),
        likeness=-2.0,
        points=len(rows),
        cameras="",
    )


def _filled(values: Float64s, within: Bools) -> Float64s:
    """Values (rows, columns) where cells within have none: the nearest one's."""
    known = np.isfinite(values) & within
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)], dtype=np.float64)

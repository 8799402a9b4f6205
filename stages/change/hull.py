"""Space in which unseen parts of a change may be: what no camera saw through, above the ground that was known before.

Cameras see the sides that face them.  What lies behind these is unknown, not empty: it may be filled up to the visual hull, the
space that remains when all that cameras saw through is carved away (Kutulakos, Seitz, A theory of shape by space carving,
International Journal of Computer Vision 38, 2000).  Carved space stays carved while the change stands: each night and each camera
that sees more of its surroundings makes the hull smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..core.ground_grid import cells_of
from ..types import Bools, Float64s, GroundGrid, Hull, Int64s
from .evidence import Epoch
from .footprint import Footprint
from .free_space import look_at
from .ncc import ncc

_MOST_VOXELS = 60_000
"""Number of voxels of a hull, from which their edge follows.  With more, borders are finer and cost grows: 300,000 change no
interval of the demo by more than 5 %."""
_REACH = 1.5
"""Unseen parts are nearer to the seen surface than this many times its height: cameras that look down on a thing
cannot see such a length behind it.  With more, intervals grow with open space that no camera shows."""
_TOP_QUANTILE = 0.98
"""Quantile of the seen heights up to which unseen parts may reach: what stood higher would show above what is seen."""
_LOW_SHARE = 0.25
"""Space lower than this share of the change's height above the ground does not count: no camera can tell it from the ground."""
_RESHAPED_SHARE = 0.3
"""If more than this share of tonight's points on a change lies in carved voxels, it has another shape now."""


@dataclass(frozen=True)
class UnseenParts:
    """Volume that unseen parts of a change have at most, by cells of the ground, (m,) each."""

    cells: Int64s
    volume: Float64s
    """World units cubed."""


NOTHING_UNSEEN = UnseenParts(np.zeros(0, np.int64), np.zeros(0))


def hull_around(footprint: Footprint, grid: GroundGrid, spacing: float, earlier: Hull | None = None) -> Hull:
    """The hull around a change, in which nothing is carved but what an earlier hull of the same change has carved.

    Parameters
    ----------
    footprint, grid : the ground that the seen surface covers, and its cells.
    spacing : of the points: the smallest edge of a voxel.
    earlier : a hull whose carved voxels stay carved; None for none.
    """
    # 1. The box around what is seen, widened by the parts that may be unseen.
    row, column = np.divmod(footprint.cells, grid.columns)
    east = grid.left + (column + 0.5) * grid.cell
    north = grid.top - (row + 0.5) * grid.cell
    lowest = np.array([east.min(), north.min(), footprint.base.min()])
    highest = np.array([east.max(), north.max(), float(np.quantile(footprint.base + footprint.height, _TOP_QUANTILE))])
    reach = _REACH * float(highest[2] - lowest[2])
    lowest[:2] -= reach
    highest[:2] += reach

    # 2. Its voxels, counted from the world's origin, so that those of all nights coincide.
    edge = max(spacing, float(np.prod(highest - lowest) / _MOST_VOXELS) ** (1 / 3))
    if earlier is not None and (0.5 * edge > earlier.edge or not np.array_equal(earlier.axes, grid.axes)):
        earlier = None  # the change has grown so much that voxels of this size would be too many
    if earlier is None:
        first = np.floor(lowest / edge).astype(int)
        last = np.floor(highest / edge).astype(int)
        return Hull(grid.axes, edge, (int(first[0]), int(first[1]), int(first[2])), np.zeros(last - first + 1, bool))

    # 3. Those of an earlier hull keep their places.
    edge = earlier.edge
    earlier_first = np.array(earlier.first)
    first = np.minimum(np.floor(lowest / edge).astype(int), earlier_first)
    last = np.maximum(np.floor(highest / edge).astype(int), earlier_first + earlier.carved.shape - 1)
    carved = np.zeros(last - first + 1, bool)
    i, j, k = earlier_first - first
    nx, ny, nz = earlier.carved.shape
    carved[i : i + nx, j : j + ny, k : k + nz] = earlier.carved
    return Hull(earlier.axes, edge, (int(first[0]), int(first[1]), int(first[2])), carved)


def is_reshaped(hull: Hull, points: Float64s, blur: float) -> bool:
    """Do so many of tonight's points (n, 3) lie in space that was free that the change must have another shape now?

    Free is carved space, and all beyond the hull, which reaches up to the top of what was seen.

    blur: distance by which borders may be off.
    """
    voxels, _ = _voxels_of(hull, points)
    nearest = np.clip(voxels, 0, np.array(hull.carved.shape) - 1)
    is_beyond = np.abs(voxels - nearest).max(axis=1, initial=0) * hull.edge > blur
    width = 2 * int(np.ceil(blur / hull.edge)) + 1
    carved_around = ndimage.minimum_filter(hull.carved, width, mode="nearest")
    is_free = is_beyond | carved_around[tuple(nearest.T)]
    return float(is_free.sum()) > _RESHAPED_SHARE * len(points)


def carved_by(hull: Hull, night: Epoch, other: Epoch, grid: GroundGrid, known_ground: Bools, similar: float) -> Hull:
    """The hull after a night on which the change stood.

    Parameters
    ----------
    hull : the hull before.
    night, other : that night, and the one without the change.
    grid, known_ground : cells of the ground, and those (rows, columns) that showed the ground that is there without the change.
    similar : correlation above which images show the same surface.
    """
    carved = hull.carved.copy()
    # 1. Nothing stands over ground that was seen.
    cells = _cells_of_columns(hull, grid)
    over_known_ground = (cells >= 0) & known_ground.ravel()[cells]
    carved[over_known_ground] = True

    # 2. Cameras saw through.  A depth is compared with all pixels around it, so no single wrong pixel carves.
    open_voxels = np.argwhere(~carved)
    centres = ((open_voxels + hull.first + 0.5) * hull.edge) @ hull.axes
    exact = np.zeros(len(centres))
    sight = look_at(centres, exact, night.cameras, night.seeing, night.depth)
    free = sight.is_free

    # 3. Or what they show behind it looks as on the other night, when they saw through: whatever the depths, nothing is in front.
    for name in other.seeing:
        if name not in night.cameras or name not in night.frames or name not in other.frames:
            continue
        before = look_at(centres, exact, other.cameras, [name], other.depth)
        asked = (before.through > 0) & ~free
        correlation = ncc(centres, asked, night.cameras[name], night.frames[name], other.cameras[name], other.frames[name])
        with np.errstate(invalid="ignore"):  # nan: the images show nothing there
            free |= correlation > similar
    carved[tuple(open_voxels[free].T)] = True
    return replace(hull, carved=carved)


def possible_columns(hull: Hull, points: Float64s, base: Float64s) -> Float64s:
    """(nx, ny) level of the top of the space that may be filled, over each column of voxels; nan if there is none.

    Only space that is connected to the seen points counts, and only above the ground.

    Parameters
    ----------
    hull, points : the hull, and the seen points (n, 3).
    base : (nx, ny) heights of the ground below each column, world units.
    """
    nz = hull.carved.shape[2]
    levels = (hull.first[2] + np.arange(nz) + 0.5) * hull.edge
    is_open = ~hull.carved & (levels > base[..., None])
    voxels, inside = _voxels_of(hull, points)
    seen = np.zeros(hull.carved.shape, bool)
    seen[tuple(voxels[inside].T)] = True
    labels, count = ndimage.label(is_open | seen, np.ones((3, 3, 3)))
    is_connected = np.zeros(count + 1, bool)
    is_connected[labels[seen]] = True
    filled = is_connected[labels] & is_open
    highest = nz - 1 - np.argmax(filled[..., ::-1], axis=2)
    return np.where(filled.any(axis=2), (hull.first[2] + highest + 1) * hull.edge, np.nan)


def possible_cells(hull: Hull, points: Float64s, grid: GroundGrid, base: Float64s) -> Bools:
    """(rows, columns) cells over which a change may be.

    Parameters
    ----------
    hull, points : its hull, and its seen points (n, 3).
    grid, base : cells of the ground, and (rows, columns) heights of the ground without the change.
    """
    below = ground_below(hull, grid, base)
    cells = _cells_of_columns(hull, grid)
    is_possible = (possible_columns(hull, points, below) > below) & (cells >= 0)
    possible = np.zeros((grid.rows, grid.columns), bool)
    possible.ravel()[cells[is_possible]] = True
    return possible


def cells_under(hull: Hull, grid: GroundGrid) -> Bools:
    """(rows, columns) cells of the ground below a hull."""
    cells = _cells_of_columns(hull, grid)
    under = np.zeros((grid.rows, grid.columns), bool)
    under.ravel()[cells[cells >= 0]] = True
    return under


def ground_below(hull: Hull, grid: GroundGrid, base: Float64s) -> Float64s:
    """(nx, ny) heights of the ground below each column of voxels; base: (rows, columns) by cell, the nearest one beyond them."""
    x, y = _column_centres(hull, grid)
    column = np.clip(np.floor((x - grid.left) / grid.cell), 0, grid.columns - 1).astype(int)
    row = np.clip(np.floor((grid.top - y) / grid.cell), 0, grid.rows - 1).astype(int)
    return np.asarray(base[row, column], dtype=np.float64)


def unseen_parts(
    hull: Hull, points: Float64s, footprint: Footprint, grid: GroundGrid, base: Float64s, left_out: Bools
) -> UnseenParts:
    """What unseen parts of a change may fill.

    Parameters
    ----------
    hull, points : the hull after tonight, and the seen points (n, 3).
    footprint : the ground that the seen surface covers, whose volume is known.
    grid, base : cells of the ground, and (rows, columns) heights of the ground without the change.
    left_out : (rows, columns) cells that do not count: they are nearer to another change, or their ground was not known before.
    """
    below = ground_below(hull, grid, base)
    height = possible_columns(hull, points, below) - below
    cells = _cells_of_columns(hull, grid)

    # 1. What is known: all up to the seen surface in cells of the footprint, nothing in others.
    seen_height = np.zeros(grid.rows * grid.columns)
    seen_height[footprint.cells] = footprint.height
    over_seen = np.where(cells >= 0, seen_height[cells], 0.0)
    unseen_height = height - over_seen

    # 2. What may be filled, without gaps between it and what is seen.
    lowest = max(_LOW_SHARE * float(np.quantile(footprint.height, 0.9)), hull.edge)
    is_seen = over_seen > 0
    is_possible = (unseen_height > lowest) & ~is_seen
    is_possible = _in_sight(is_possible, is_seen)
    counts = (cells >= 0) & (is_possible | (is_seen & (unseen_height > lowest))) & ~left_out.ravel()[cells]
    total = np.bincount(cells[counts], unseen_height[counts] * hull.edge**2, minlength=grid.rows * grid.columns)
    occupied = np.flatnonzero(total).astype(np.int64)
    return UnseenParts(occupied, np.asarray(total[occupied], dtype=np.float64))


def _in_sight(possible: Bools, seen: Bools) -> Bools:
    """(nx, ny) possible columns from which a straight line to the nearest seen one crosses no column that is neither."""
    if not seen.any():
        return possible
    # Closed, because single columns may have been carved by mistake.
    open_columns = ndimage.binary_closing(np.pad(possible | seen, 1), np.ones((3, 3)))[1:-1, 1:-1] | possible | seen
    start = np.argwhere(possible)
    nearest = ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    end = nearest[:, possible].T
    steps = int(np.abs(end - start).max(initial=0))
    is_clear = np.ones(len(start), bool)
    for step in range(1, steps):
        between = np.rint(start + (end - start) * (step / steps)).astype(int)
        is_clear &= open_columns[tuple(between.T)]
    clear = np.zeros(possible.shape, bool)
    clear[tuple(start[is_clear].T)] = True
    return clear


def nearer_to_others(grid: GroundGrid, footprints: Sequence[Int64s], own: int) -> Bools:
    """(rows, columns) cells that are nearer to another change than to number `own`; footprints: the cells that each covers."""
    to_own = _distance_to(grid, footprints[own])
    nearer = np.zeros((grid.rows, grid.columns), bool)
    for other, cells in enumerate(footprints):
        if other != own:
            nearer |= _distance_to(grid, cells) < to_own
    return nearer


def _distance_to(grid: GroundGrid, cells: Int64s) -> Float64s:
    """(rows, columns) distance to the nearest of some cells, in cells."""
    away = np.ones((grid.rows, grid.columns), bool)
    away.ravel()[cells] = False
    return np.asarray(ndimage.distance_transform_edt(away), dtype=np.float64)


def _voxels_of(hull: Hull, points: Float64s) -> tuple[Int64s, Bools]:
    """(n, 3) indices of the voxels in which points (n, 3) lie, and (n,) which of them lie in the hull."""
    voxels = np.floor((points @ hull.axes.T) / hull.edge).astype(np.int64) - hull.first
    inside = np.all((voxels >= 0) & (voxels < hull.carved.shape), axis=1)
    return voxels, np.asarray(inside, dtype=np.bool_)


def _column_centres(hull: Hull, grid: GroundGrid) -> tuple[Float64s, Float64s]:
    """(nx, ny) coordinates on the ground, east and north, of the centres of all columns of voxels."""
    nx, ny, _ = hull.carved.shape
    east = (hull.first[0] + np.arange(nx) + 0.5) * hull.edge
    north = (hull.first[1] + np.arange(ny) + 0.5) * hull.edge
    x, y = np.meshgrid(east, north, indexing="ij")
    if np.array_equal(hull.axes, grid.axes):
        return x, y
    world = np.stack([x, y, np.full(x.shape, hull.first[2] * hull.edge)], axis=-1) @ hull.axes
    on_ground = world @ grid.axes[:2].T
    return on_ground[..., 0], on_ground[..., 1]


def _cells_of_columns(hull: Hull, grid: GroundGrid) -> Int64s:
    """(nx, ny) the cell of the ground below each column of voxels, -1 outside the grid."""
    x, y = _column_centres(hull, grid)
    flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) @ grid.axes
    return cells_of(grid, flat).reshape(x.shape)

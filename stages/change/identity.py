"""Recognises the changes of earlier nights: which of them still stand, which are gone, and what tonight shows of each.

A change is a thing with a place, to which nights add evidence.  Tonight's changed points are assigned to the known places first;
only what is left can be new.  Known places are neither joined nor divided by what one night shows: things side by side look like
one on some nights, and a thing of which little is seen like two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ..core.ground_grid import cells_of
from ..types import Bools, GroundGrid, Int64s, KnownPlace
from .clusters import Surface, groups_of_points, surface_of, unchanged_cells
from .evidence import Epoch, Evidence
from .free_space import look_at

_GONE_SHARE = 0.5
"""A change is gone if at least this share of its points lies where tonight is as the reference."""
_GONE_RATIO = 3.0
"""And if these are more than this many times the points at which it still shows."""
_STANDING_SHARE = 0.1
"""A change was seen tonight if it shows at at least this share of its points."""
_SAME_SPACINGS = 3.0
"""Points of earlier nights are left out if one of tonight's is nearer than this many spacings: both show the same surface."""
_APART_SHARE = 0.5
"""Changed cells where a known change cannot be, as earlier nights saw, are a new one if they cover at least this share of its
area; fewer are its growth."""


@dataclass(frozen=True)
class Recognised:
    """A known place, and what tonight shows of it."""

    place: KnownPlace
    seen: bool
    """False if tonight knows nothing of it."""
    rows: Int64s
    """Rows of tonight's evidence that belong to it."""
    surface: Surface
    """Points of tonight, and of earlier nights where tonight shows none."""


@dataclass(frozen=True)
class Recognition:
    """The known places of one kind that still stand, and the groups of changed cells that belong to none."""

    places: list[Recognised]
    groups: Int64s
    """(rows, columns) number of the group that each changed cell belongs to; 0 for none, and for those of known places."""


def recognise(
    places: Sequence[KnownPlace],
    side: Evidence,
    groups: Int64s,
    grid: GroundGrid,
    tonight: Epoch,
    can_be: Callable[[KnownPlace], Bools],
    *,
    spacing: float,
    least_area: float,
) -> Recognition:
    """Assign tonight's changed points to known places, all of one kind; places that are gone are left out.

    Parameters
    ----------
    places, side : the known places, and the evidence on the night on which they stand: tonight, or the reference if they have
        vanished.
    groups, grid : (rows, columns) number of the connected group of cells with changed points, 0 for none; the cells.
    tonight : tonight's cameras and depths.
    can_be : the cells (rows, columns) over which a place's unseen parts may be, as earlier nights have it.
    spacing, least_area : of the points; and the smallest surface area of a change.
    """
    changed = groups > 0
    unchanged = unchanged_cells(side, grid)
    standing = []
    for place in places:
        view = _view_of(place, tonight, grid, changed, unchanged)
        if not view.is_gone:
            standing.append((place, view))

    # Each group that covers cells of known places belongs to these, every cell to the nearest of them.
    owner = np.zeros(groups.shape, np.int64)  # number of the place from 1
    for k, (place, _) in enumerate(standing, 1):
        cells = cells_of(grid, place.points)
        owner.ravel()[cells[cells >= 0]] = k
    claimed = _claimed(groups, owner)
    left = np.where(claimed > 0, 0, groups)
    for k, (place, _) in enumerate(standing, 1):
        apart = _groups_apart(claimed == k, owner == k, can_be(place), grid, least_area)
        left = np.where(apart > 0, apart + left.max(), left)
        claimed = np.where(apart > 0, 0, claimed)

    place_of_point = groups_of_points(side, grid, claimed)
    recognised = []
    for k, (place, view) in enumerate(standing, 1):
        rows = np.flatnonzero(place_of_point == k)
        surface = _joined(place, surface_of(side, rows), ~view.as_reference, spacing)
        recognised.append(Recognised(place, view.is_seen or len(rows) > 0, rows, surface))
    return Recognition(recognised, left)


@dataclass(frozen=True)
class _View:
    """What tonight shows at the points of a known place, (n,) each."""

    stands: Bools
    """The change shows."""
    as_reference: Bools
    """All is as on the reference's night."""

    @property
    def is_gone(self) -> bool:
        back = float(self.as_reference.mean())
        return back >= _GONE_SHARE and back > _GONE_RATIO * float(self.stands.mean())

    @property
    def is_seen(self) -> bool:
        return float(self.stands.mean()) >= _STANDING_SHARE


def _view_of(place: KnownPlace, tonight: Epoch, grid: GroundGrid, changed: Bools, unchanged: Bools) -> _View:
    """What tonight shows of a place; changed, unchanged: (rows, columns) cells of the night on which it stands."""
    sight = look_at(place.points, place.sigma.astype(np.float64), tonight.cameras, tonight.seeing, tonight.depth)
    is_free = sight.is_free
    is_surface = ~is_free & (sight.agreeing > 0)
    cells = cells_of(grid, place.points)
    on_changed = (cells >= 0) & changed.ravel()[cells]
    on_unchanged = (cells >= 0) & unchanged.ravel()[cells] & ~on_changed
    if place.vanished:  # its points are of the reference: a surface at them is the thing that is back
        stands = is_free | (on_changed & ~is_surface)
        return _View(stands, ~stands & (is_surface | on_unchanged))
    stands = is_surface | (on_changed & ~is_free)
    return _View(stands, ~stands & (is_free | on_unchanged))


def _claimed(groups: Int64s, owner: Int64s) -> Int64s:
    """(rows, columns) number of the place that each changed cell belongs to; 0 for none.

    groups, owner: (rows, columns) numbers of the groups of changed cells, and of the places that cover cells.
    """
    claimed = np.zeros(groups.shape, np.int64)
    boxes = ndimage.find_objects(groups)
    for number in np.unique(groups[(groups > 0) & (owner > 0)]):
        box = boxes[number - 1]
        in_group = groups[box] == number
        owned = np.where(in_group, owner[box], 0)
        nearest = ndimage.distance_transform_edt(owned == 0, return_distances=False, return_indices=True)
        claimed[box] = np.where(in_group, owned[tuple(nearest)], claimed[box])
    return claimed


def _groups_apart(claimed: Bools, own: Bools, can_be: Bools, grid: GroundGrid, least_area: float) -> Int64s:
    """(rows, columns) numbers of groups of claimed cells that cannot belong to a place: something new stands beside it."""
    possible = ndimage.binary_dilation(own | can_be, np.ones((3, 3)), iterations=2)
    outside = ndimage.binary_opening(claimed & ~possible)
    labels, count = ndimage.label(outside, np.ones((3, 3)))
    least_cells = max(_APART_SHARE * float(own.sum()), least_area / grid.cell**2)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    is_large = sizes >= least_cells
    is_large[0] = False
    return np.where(is_large[labels], labels, 0)


def _joined(place: KnownPlace, seen: Surface, still: Bools, spacing: float) -> Surface:
    """Tonight's surface of a place, and points of earlier nights, those of `still` (n,), where tonight shows none."""
    kept = still.copy()
    if len(seen.points) and kept.any():
        distance, _ = cKDTree(seen.points).query(place.points[kept], distance_upper_bound=_SAME_SPACINGS * spacing)
        kept[kept] = ~np.isfinite(distance)
    return Surface(
        points=np.vstack([seen.points, place.points[kept]]),
        sigma=np.concatenate([seen.sigma, place.sigma[kept]]),
        cleared=np.concatenate([seen.cleared, place.cleared[kept]]),
    )

"""The changes that stand tonight, known from earlier nights or new, each with its surface, its interval and its hull."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..core.ground_grid import cells_of
from ..types import Bools, Change, Float64s, GroundGrid, Hull, Int64s, KnownPlace
from .cloud_distance import CONFIDENCE
from .clusters import (
    ChangeCluster,
    Side,
    Surface,
    changed_groups,
    colour_of,
    describe,
    footprint_of,
    likeness_of,
    paired,
    unchanged_cells,
    with_unseen,
)
from .evidence import CORE, Epoch
from .ground_points import GroundPoints, seen_cells, surface_below, tops
from .hull import (
    NOTHING_UNSEEN,
    UnseenParts,
    carved_by,
    cells_under,
    hull_around,
    is_reshaped,
    nearer_to_others,
    possible_cells,
    unseen_parts,
)
from .identity import Recognised, recognise


@dataclass(frozen=True)
class Standing:
    """A change that stands tonight, at one place."""

    id: str
    vanished: bool
    cluster: ChangeCluster | None
    """None if its place lies outside tonight's ground, or if nothing is known of that: its last description counts."""
    earlier: KnownPlace | None
    """What earlier nights know of it; None if it is new tonight."""
    seen: bool = True
    """False if tonight knows nothing of it."""
    hull: Hull | None = None
    """Space in which unseen parts of it may be; None until `with_hulls`, and without a cluster."""

    @property
    def place(self) -> KnownPlace:
        """What later nights need to know of it."""
        if self.cluster is None or self.hull is None:
            assert self.earlier is not None
            return replace(self.earlier, change=self.change)
        surface = self.cluster.surface
        return KnownPlace(
            id=self.id,
            vanished=self.vanished,
            change=self.change,
            points=surface.points,
            sigma=surface.sigma.astype(np.float32),
            cleared=surface.cleared.astype(np.float32),
            hull=self.hull,
        )

    @property
    def change(self) -> Change:
        """Its description, with its id and its nights."""
        if self.earlier is None:
            assert self.cluster is not None
            return replace(self.cluster.change, id=self.id)
        nights = self.earlier.change.nights + int(self.seen)
        described = self.cluster.change if self.cluster is not None else self.earlier.change
        return replace(described, id=self.id, zone="", nights=nights, seen=self.seen)


def known_standing(
    places: Sequence[KnownPlace], own: Side, other: Side, tonight: Epoch, grid: GroundGrid, *, spacing: float, least_area: float,
    vanished: bool,
) -> tuple[list[Standing], Int64s]:  # fmt: skip
    """The known changes that still stand, and the groups of changed cells (rows, columns) that belong to none of them.

    Parameters
    ----------
    places : what earlier nights know, of both kinds.
    own, other : the night on which the changes stand, compared with the other one.
    tonight : tonight's cameras and depths.
    grid : cells of the ground.
    spacing, least_area : of the points; and the smallest surface area of a change.
    vanished : True if the own night is the reference's.
    """
    of_kind = [place for place in places if place.vanished == vanished]

    def can_be(place: KnownPlace) -> Bools:
        base = surface_below(cells_under(place.hull, grid), other.ground, _highest(place.points, grid) + 2 * spacing)
        if base is None:
            return np.zeros((grid.rows, grid.columns), bool)
        return possible_cells(place.hull, place.points, grid, base)

    groups = changed_groups(own.evidence, grid)
    found = recognise(of_kind, own.evidence, groups, grid, tonight, can_be, spacing=spacing, least_area=least_area)
    standing = []
    for each in found.places:
        cluster = _measured(each, own, other.ground, grid, spacing)
        standing.append(Standing(each.place.id, vanished, cluster, each.place, each.seen))
    return standing, found.groups


def _measured(each: Recognised, own: Side, other: GroundPoints, grid: GroundGrid, spacing: float) -> ChangeCluster | None:
    """A known change with tonight's evidence; None if nothing is known of the ground below it."""
    # 1. The ground that it covers, as far as it lies on tonight's grid.
    cells = cells_of(grid, each.surface.points)
    inside = cells >= 0
    if not inside.any():
        return None
    surface = Surface(each.surface.points[inside], each.surface.sigma[inside], each.surface.cleared[inside])
    area = np.zeros((grid.rows, grid.columns), bool)
    area.ravel()[cells[inside]] = True
    footprint = footprint_of(surface, area, unchanged_cells(own.evidence, grid), grid, other, spacing, trimmed=True)
    if footprint is None:
        return None

    # 2. What describes it; where tonight shows none of its points, earlier nights do.
    earlier = each.place.change
    likeness = earlier.likeness
    significance = earlier.significance
    colour = np.zeros(2)
    if len(each.rows):
        likeness = likeness_of(own.evidence, each.rows)
        significance = float(np.median(own.evidence.significance[each.rows]))
        colour = colour_of(own.colors[each.rows])
    kind = "vanished" if each.place.vanished else "new"
    change = replace(describe(surface, footprint, grid, spacing), kind=kind, likeness=likeness, significance=significance)
    return ChangeCluster(change, footprint, surface, each.rows, each.place.vanished, True, colour, seen=each.seen)


def with_hulls(
    standing: Sequence[Standing], own: Side, other: Side, grid: GroundGrid, *, spacing: float, similar: float
) -> list[Standing]:
    """All changes of one kind with their hulls, and with the intervals of their volumes.

    Parameters
    ----------
    standing : the changes.
    own, other : the night on which they stand, compared with the other one.
    grid : cells of the ground.
    spacing : of the points.
    similar : correlation above which images show the same surface.
    """
    footprints = [each.cluster.footprint.cells for each in standing if each.cluster is not None]
    known_ground = unchanged_cells(own.evidence, grid)
    done = []
    number = 0
    for each in standing:
        cluster = each.cluster
        if cluster is None:
            done.append(each)
            continue
        # 1. Carve what tonight's cameras saw through.
        earlier = each.earlier.hull if each.earlier is not None else None
        if earlier is not None and is_reshaped(earlier, own.evidence.core[cluster.rows], 2 * grid.cell):
            earlier = None
        hull = hull_around(cluster.footprint, grid, spacing, earlier)
        hull = carved_by(hull, own.night, other.night, grid, known_ground, similar)

        # 2. What is left may be filled, as far as it is nearer to this change than to others.
        left_out = nearer_to_others(grid, footprints, number)
        parts = _unseen_in(hull, cluster, other, grid, spacing, left_out)
        done.append(replace(each, cluster=with_unseen(cluster, parts, grid, spacing), hull=hull))
        number += 1
    return done


def doubts(
    unconfirmed: Sequence[ChangeCluster], standing: Sequence[Standing], own: Side, other: Side, grid: GroundGrid, *,
    spacing: float, similar: float,
) -> list[ChangeCluster]:  # fmt: skip
    """The unconfirmed changes of one kind with the most that each may be, if it is real.

    Where distances to the other night's surface are known, that is the volume between the surfaces: a wall that seems to have
    moved a little hides nothing.  Where cameras saw through instead, it is a thing of which perhaps one side is seen, and what
    they cannot exclude behind it counts.

    Parameters
    ----------
    unconfirmed, standing : these changes, and those of the same kind that are confirmed, with their unseen parts.
    own, other : the night on which they stand, compared with the other one.
    grid : cells of the ground.
    spacing : of the points.
    similar : correlation above which images show the same surface.
    """
    # Space that a confirmed change may fill counts there already.
    taken = np.zeros((grid.rows, grid.columns), bool)
    for each in standing:
        if each.cluster is not None:
            taken.ravel()[each.cluster.footprint.cells] = True
            taken.ravel()[each.cluster.unseen.cells] = True
    things = [cluster for cluster in unconfirmed if np.isinf(cluster.swept_volume)]
    footprints = [thing.footprint.cells for thing in things]
    known_ground = unchanged_cells(own.evidence, grid)
    done = []
    for number, thing in enumerate(things):
        hull = hull_around(thing.footprint, grid, spacing)
        hull = carved_by(hull, own.night, other.night, grid, known_ground, similar)
        left_out = nearer_to_others(grid, footprints, number) | taken
        done.append(with_unseen(thing, _unseen_in(hull, thing, other, grid, spacing, left_out), grid, spacing))
    for cluster in unconfirmed:
        if np.isfinite(cluster.swept_volume):
            area = len(cluster.rows) * (CORE * spacing) ** 2
            sigma = area * float(np.median(own.evidence.sigma[cluster.rows]))
            most = max(0.0, cluster.swept_volume) + CONFIDENCE * sigma
            done.append(replace(cluster, change=replace(cluster.change, volume_most=most)))
    return done


def _unseen_in(hull: Hull, cluster: ChangeCluster, other: Side, grid: GroundGrid, spacing: float, left_out: Bools) -> UnseenParts:
    """What unseen parts of a change may fill of its hull, above ground that was known on the other night.

    left_out: (rows, columns) cells that do not count, besides those of unknown ground.
    """
    points = cluster.surface.points
    base = surface_below(cells_under(hull, grid), other.ground, _highest(points, grid) + 2 * spacing)
    if base is None:
        return NOTHING_UNSEEN
    known_before = seen_cells(tops(other.ground.cells, other.ground.levels, left_out.shape))
    not_known_before = ~ndimage.binary_fill_holes(known_before)  # what known ground surrounds is ground, too
    return unseen_parts(hull, points, cluster.footprint, grid, base, left_out | not_known_before)


def with_ids(standing: Sequence[Standing], highest: int) -> tuple[list[Standing], int]:
    """All changes of both kinds with ids, new ones counted on from number `highest`, the largest first; and the highest number.

    A thing that was moved has one id at both places.  Only changes that are both new tonight can be one thing: what was two stays
    two.
    """
    done = [each for each in standing if each.earlier is not None]
    new = {id(each.cluster): each for each in standing if each.earlier is None}
    pairs = paired([each.cluster for each in new.values() if each.cluster is not None])
    pairs.sort(key=lambda pair: -pair[0].change.volume)
    for number, pair in enumerate(pairs, highest + 1):
        for cluster in pair:
            if cluster is not None:
                done.append(replace(new[id(cluster)], id=f"C{number}"))
    return done, highest + len(pairs)


def _highest(points: Float64s, grid: GroundGrid) -> float:
    """Height of the highest of some points (n, 3)."""
    return float((points @ grid.axes[2]).max())

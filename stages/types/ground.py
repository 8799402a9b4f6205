"""Data for each place on the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..contracts.ground_figures import Change, ChangesFigures, CoverageFigures, CutFill
from ..contracts.short_repr import Record
from .arrays import Float32s, Float64s, Uint8s, Uint16s
from .places import KnownPlace


@dataclass(frozen=True)
class GroundGrid(Record):
    """Square cells seen from above; the first row has the largest second coordinate (north, if the world has one)."""

    axes: Float64s
    """(3, 3) rows east, north, up in the world, of unit length; a world point X has the coordinates `axes` X."""
    left: float
    """East coordinate of the outer corner of the first cell, world lengths."""
    top: float
    """North coordinate of that corner; like `left` a multiple of `cell`, so that the cells of different nights coincide."""
    cell: float
    """Edge of a cell."""
    rows: int
    columns: int


@dataclass(frozen=True)
class Coverage(Record):
    """How well cameras see the ground, and what stands on it, seen from above.

    Cells outside the area that the night's surface covers have 0 views, and nan in all other maps.
    """

    grid: GroundGrid
    heights: Float32s
    """(rows, columns) height of the surface in each cell along `grid.axes[2]`, world lengths; nan outside the area."""
    views: Uint8s
    """(rows, columns) number of cameras that see the cell (255: that or more)."""
    angle_deg: Float32s
    """(rows, columns) angle between the rays of the pair of cameras that measures the cell best; nan without a pair."""
    error: Float32s
    """(rows, columns) expected error of a point by that pair: standard deviation along its worst direction, world lengths."""
    area: float
    """Area of the covered ground, square world lengths."""
    seen_by_one: float
    """Share of the area that at least one camera sees."""
    seen_by_two: float
    """Share of the area that at least two cameras see."""
    median_angle_deg: float
    """Median of `angle_deg` over the cells that have a pair; -1 if none has."""
    median_error: float
    """Median of `error` over the cells that have a pair; -1 if none has."""
    lost_without: Mapping[str, float] = field(default_factory=dict)
    """By camera: share of the area that it and only one other camera see: without it, fewer than two would."""
    metric: bool = True
    crs: str = ""
    """`metric` and `crs`: see `Poses`."""

    @property
    def figures(self) -> CoverageFigures:
        """What the engine reports of it."""
        return CoverageFigures(
            area_m2=self.area,
            seen_by_one=self.seen_by_one,
            seen_by_two=self.seen_by_two,
            angle_deg=self.median_angle_deg,
            error_m=self.median_error,
            lost_without=self.lost_without,
        )


@dataclass(frozen=True)
class Changes(Record):
    """What differs from the pinned reference."""

    compared: bool
    """False if there is nothing to compare with."""
    changes: Mapping[str, Change]
    """Changes by id ("C17"), the largest first."""
    points: Float64s
    """(n, 3) points of tonight, and those of the reference that have vanished or are unknown, thinned."""
    colors: Uint8s
    """(n, 3) RGB."""
    distance: Float32s
    """(n,) distance from one night's surface to the other's: along the normal, or along the ray of a camera that saw through;
    nan where neither is known."""
    sigma: Float32s
    """(n,) standard deviation of the distance."""
    significance: Float32s
    """(n,) distance over sigma, positive if nearer to the cameras than on the other night; 0 where nothing is known."""
    label: Uint8s
    """(n,) `SAME`, `NEW`, `VANISHED` or `UNKNOWN`."""
    blob: Uint16s
    """(n,) number of the change that the point belongs to (17 for C17), 0: none."""
    grid: GroundGrid
    difference: Float32s
    """(rows, columns) height of tonight's surface minus the reference's; nan where one is unknown."""
    before: Mapping[str, Uint8s] = field(default_factory=dict)
    """By id of the change: (h, w, 3) its surroundings on the reference's night, by the camera that sees it best."""
    after: Mapping[str, Uint8s] = field(default_factory=dict)
    """The same tonight, by the same camera; of the same height."""
    count: int = 0
    """Number of changes."""
    changed_share: float = 0.0
    """Share of the comparable surface that belongs to changes."""
    unknown_share: float = 0.0
    """Share of the reference's surface about which tonight nothing is known."""
    cut_fill: CutFill | None = None
    """Volumes of the whole site, or of all zones together if there are any; None if nothing was compared."""
    zones: Mapping[str, CutFill] = field(default_factory=dict)
    """Volumes of each zone, by name."""
    noise: float = 1.0
    """Factor by which distances without a change exceed the points' own standard deviations."""
    places: tuple[KnownPlace, ...] = field(default=(), metadata={"figure": False})
    """What later nights need to recognise these changes, also those that no zone counts."""
    highest_id: int = 0
    """Number of the highest id that was given up to this night (17 for C17): ids are never given again."""
    metric: bool = True
    crs: str = ""
    """`metric` and `crs`: see `Poses`."""

    @property
    def figures(self) -> ChangesFigures:
        """What the engine reports of it."""
        return ChangesFigures(
            compared=self.compared,
            count=self.count,
            changed_share=self.changed_share,
            unknown_share=self.unknown_share,
            noise=self.noise,
            cut_fill=self.cut_fill,
            zones=self.zones,
            changes=self.changes,
            highest_id=self.highest_id,
        )


# Values of `Changes.label`
SAME = 0
"""A point of tonight that belongs to no change."""
NEW = 1
"""A point of tonight that belongs to a change."""
VANISHED = 2
"""A point of the reference that belongs to a change."""
UNKNOWN = 3
"""A point of either night of which the other night's cameras cannot tell."""

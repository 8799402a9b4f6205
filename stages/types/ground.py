"""What is known of each place on the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..core.short_repr import Record
from .arrays import Float32s, Float64s, Uint8s, Uint16s


@dataclass(frozen=True)
class GroundGrid(Record):
    """Square cells as seen from above; the first row has the largest second coordinate (north, where the world has one)."""

    axes: Float64s
    """(3, 3) rows east, north, up in the world, of unit length; a world point X has the coordinates `axes` X."""
    left: float
    """East of the outer corner of the first cell..."""
    top: float
    """...and its north, world lengths; multiples of `cell`, so that grids of different nights lie on each other."""
    cell: float
    """Edge of a cell."""
    rows: int
    columns: int


@dataclass(frozen=True)
class Coverage(Record):
    """How well cameras see the ground, and what stands on it, seen from above.

    Cells outside of the area that the night's surface covers have 0 views and nan elsewhere.
    """

    grid: GroundGrid
    heights: Float32s
    """(rows, columns) of the surface in each cell along `grid.axes[2]`, world lengths; nan outside of the area."""
    views: Uint8s
    """(rows, columns) cameras that see it (255: that or more)."""
    angle_deg: Float32s
    """(rows, columns) between the rays of the pair of cameras that tells its depth best; nan where there is no pair."""
    error: Float32s
    """(rows, columns) expected error of a point by that pair, standard deviation along its worst direction, world lengths."""
    area: float
    """Of the ground that counts, square world lengths."""
    seen_by_one: float
    """Share of it that at least one camera sees..."""
    seen_by_two: float
    """...and at least two."""
    median_angle_deg: float
    """Over the cells that have a pair; -1 where none has."""
    median_error: float
    """The same of the expected error; -1 where no cell has a pair."""
    lost_without: Mapping[str, float] = field(default_factory=dict)
    """By camera: share of the area that would fall below two cameras without it."""
    metric: bool = True
    crs: str = ""
    """As of `Poses`."""


@dataclass(frozen=True)
class Change(Record):
    """One thing that has appeared, vanished or moved."""

    kind: str
    """"new", "vanished" or "moved"."""
    x: float
    """Middle of the box around it, in the world."""
    y: float
    z: float
    length: float
    """Of the rectangle around it on the ground, the longer side..."""
    width: float
    """...and the shorter one."""
    height: float
    """Of most of it above what was below it."""
    area: float
    """Of the ground that it covers."""
    volume: float
    """Between its surface and what was, or is now, below it."""
    volume_sigma: float
    """Standard deviation of that."""
    significance: float
    """Median over its points of distance over standard deviation."""
    likeness: float
    """Median correlation of the photographs of it and of what was there, -1 to 1; -2 where they show nothing."""
    points: int
    cameras: str
    """Ids of those that see it, or saw it, joined by commas."""
    zone: str = ""
    """The zone that it lies in."""
    from_x: float = 0.0
    """Of what has moved: where it was..."""
    from_y: float = 0.0
    from_z: float = 0.0


@dataclass(frozen=True)
class CutFill(Record):
    """What was gained and lost on a part of the ground since the reference, world lengths."""

    gained: float
    """Volume by which changes stand higher..."""
    gained_sigma: float
    lost: float
    """...and that by which they stand lower."""
    lost_sigma: float
    level: float
    """Level of detection: surfaces that lie less apart do not count, median."""
    common_sigma: float
    """Standard deviation of one night's heights against the other's that all places share; `gained_sigma` and `lost_sigma` hold
    it, too."""
    area: float
    """Of the ground that both nights saw..."""
    unseen: float
    """...and that one of them, or of a zone neither, did not see: nothing of it counts."""


@dataclass(frozen=True)
class Changes(Record):
    """What is not as it was when the reference was pinned."""

    compared: bool
    """False where there is nothing to compare with."""
    changes: Mapping[str, Change]
    """By number, "1" and so on, the largest first."""
    points: Float64s
    """(n, 3) of tonight, and of then what has vanished or is unknown, thinned."""
    colors: Uint8s
    """(n, 3) RGB."""
    distance: Float32s
    """(n,) from one night's surface to the other's: along the normal, or along the ray of a camera that saw through; nan where
    neither is known."""
    sigma: Float32s
    """(n,) its standard deviation."""
    significance: Float32s
    """(n,) distance over sigma, positive: nearer to the cameras than on the other night; 0 where nothing is known."""
    label: Uint8s
    """(n,) `SAME`, `NEW`, `VANISHED` or `UNKNOWN`."""
    blob: Uint16s
    """(n,) number of the change that a point belongs to, 0: none."""
    grid: GroundGrid
    difference: Float32s
    """(rows, columns) height of tonight's surface less that of then; nan where one is unknown."""
    crops: Mapping[str, Uint8s] = field(default_factory=dict)
    """By number of the change: (h, w, 3) then and tonight, side by side, by the camera that sees it best."""
    count: int = 0
    """Of changes."""
    changed_share: float = 0.0
    """Of the surface that could be compared, how much belongs to changes."""
    unknown_share: float = 0.0
    """Share of the surface of then of which tonight nothing is known."""
    cut_fill: CutFill | None = None
    """Of the whole site, or of all zones together where there are any; None where nothing was compared."""
    zones: Mapping[str, CutFill] = field(default_factory=dict)
    """The same of each zone, by name."""
    noise: float = 1.0
    """By how much distances where nothing has changed exceed what the points' own standard deviations say."""
    metric: bool = True
    crs: str = ""
    """As of `Poses`."""


SAME, NEW, VANISHED, UNKNOWN = 0, 1, 2, 3
"""Values of `Changes.label`."""

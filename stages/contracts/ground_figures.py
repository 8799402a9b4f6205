"""What the vision reports of a cloud and of the ground: its points, what the cameras see of it, and what has changed on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .short_repr import Record


@dataclass(frozen=True)
class CloudSize(Record):
    """How large and how good a point cloud is."""

    points: int = 0
    bounds: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    """Two opposite corners of its bounding box."""
    correct_share: float | None = None
    """Share of the points that is expected to be right; None for a cloud that was read from its file."""


@dataclass(frozen=True)
class CloudFigures(CloudSize):
    """A point cloud."""

    sample_counts: Mapping[str, int] = field(default_factory=dict)
    """Number of samples from each camera's view before merging; empty for a cloud that was read from its file."""
    misfits: Mapping[str, float] = field(default_factory=dict)
    """By view, the median over its samples of their standard deviation, as other views and neighbouring pixels show it,
    divided by the one expected from `noise_px`."""


@dataclass(frozen=True)
class CoverageFigures(Record):
    """How much of the ground the cameras see."""

    area_m2: float | None = None
    """Area of the covered ground."""
    seen_by_one: float | None = None
    """Share of the area that at least one camera sees."""
    seen_by_two: float | None = None
    """Share of the area that at least two cameras see."""
    angle_deg: float | None = None
    """Median angle between the rays of the best pair, over the cells that have one; -1 if none has."""
    error_m: float | None = None
    """Median expected error of a point, over the cells that have a pair; -1 if none has."""
    lost_without: Mapping[str, float] | None = None
    """By camera: share of the area that it and only one other camera see: without it, fewer than two would."""


@dataclass(frozen=True)
class Change(Record):
    """A single thing that has appeared, vanished or moved."""

    kind: str = ""
    """"new", "vanished" or "moved"."""
    x: float = 0.0
    """Centre of the box around it (x, y, z), in the world."""
    y: float = 0.0
    z: float = 0.0
    length: float = 0.0
    """Longer side of the rectangle around it on the ground."""
    width: float = 0.0
    """Shorter side of the rectangle around it on the ground."""
    height: float = 0.0
    """Height above what was below it, 90th percentile over the cells that it covers."""
    area: float = 0.0
    """Ground area that it covers."""
    volume: float = 0.0
    """Volume between its seen surface and what was, or is now, below it."""
    volume_sigma: float = 0.0
    """Standard deviation of this volume; what nobody sees is not in it: see `volume_most`."""
    significance: float = 0.0
    """Median over its points of distance over standard deviation."""
    likeness: float = -2.0
    """Median correlation of the photographs of it and of what was there, -1 to 1; -2 if they show nothing."""
    points: int = 0
    cameras: str = ""
    """Ids of the cameras that see it, or saw it, joined by commas."""
    zone: str = ""
    """Name of the zone that contains it."""
    from_x: float = 0.0
    """Where a moved thing was (from_x, from_y, from_z)."""
    from_y: float = 0.0
    from_z: float = 0.0
    id: str = ""
    """Its name for life, "C17"; no other thing of the site has or had it."""
    nights: int = 1
    """Number of nights on which it was measured, tonight's included."""
    seen: bool = True
    """False: tonight knows nothing of its place, and it is carried on from earlier nights."""
    volume_least: float = 0.0
    """Volume that it has at least (with 97.5 % certainty)."""
    volume_most: float = 0.0
    """Volume that it has at most: with what the cameras do not see but cannot exclude either."""


@dataclass(frozen=True)
class CutFill(Record):
    """Volumes gained and lost on a part of the ground since the reference, world lengths."""

    gained: float = 0.0
    """Volume added by changes."""
    gained_sigma: float = 0.0
    lost: float = 0.0
    """Volume removed by changes."""
    lost_sigma: float = 0.0
    gained_least: float = 0.0
    """Volume that was added at least, and at most (95 %), as for `Change.volume_least`; areas that nobody saw are not in it."""
    gained_most: float = 0.0
    lost_least: float = 0.0
    lost_most: float = 0.0
    level: float = 0.0
    """Level of detection, median: surfaces closer to each other than this count as the same."""
    common_sigma: float = 0.0
    """Standard deviation of the height offset between both nights that all places share; `gained_sigma` and `lost_sigma`
    include it."""
    area: float = 0.0
    """Area of the ground that both nights saw."""
    unseen: float = 0.0
    """Area that one of the nights (for a zone, one or both) did not see: nothing in it counts."""


@dataclass(frozen=True)
class ChangesFigures(Record):
    """What differs from the reference; None where nothing was compared."""

    compared: bool | None = None
    """False if there is nothing to compare with."""
    count: int | None = None
    """Number of changes."""
    changed_share: float | None = None
    """Share of the comparable surface that belongs to changes."""
    unknown_share: float | None = None
    """Share of the reference's surface about which tonight nothing is known."""
    noise: float | None = None
    """Factor by which distances without a change exceed the points' own standard deviations."""
    cut_fill: CutFill | None = None
    """Volumes of the whole site, or of all zones together if there are any; None if nothing was compared."""
    zones: Mapping[str, CutFill] = field(default_factory=dict)
    """Volumes of each zone, by name."""
    changes: Mapping[str, Change] | None = None
    """Changes by id ("C17"), the largest first."""
    highest_id: int = 0
    """Number of the highest id that was given up to this night (17 for C17)."""


@dataclass(frozen=True)
class UsedIds(Record):
    """Ids of changes that must not be given again."""

    highest: int = 0
    """Number of the highest id that any earlier night has (17 for C17), whatever its reference; 0 for none."""

"""What is known of each place on the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..core.short_repr import short_repr
from .arrays import Float32s, Float64s, Uint8s


@short_repr
@dataclass(frozen=True)
class GroundGrid:
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


@short_repr
@dataclass(frozen=True)
class Coverage:
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
    """Lengths are metres."""
    crs: str = ""
    """Coordinate system of the world, "" for a local one."""

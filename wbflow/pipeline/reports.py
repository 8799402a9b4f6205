"""What run.json says of the results of stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Entry:
    """An entry of a figure that maps cameras, or pairs as "left--right"."""

    figure: str
    field: str = ""
    """One field of the entry; "" for all of it."""


@dataclass(frozen=True)
class Expects:
    """A figure of the whole night that is compared with what is usual."""

    factors: tuple[str, ...]
    """Figures that run.json tells of the stage; the product of them is compared."""
    unit: str
    words: str
    """What it measures."""


@dataclass(frozen=True)
class Reports:
    """What run.json says of a stage's results: of a site-wide one under its name.  A camera or pair whose task has no result is
    not ok."""

    fields: Mapping[str, str] = field(default_factory=dict)
    """Figure by field of the camera's or pair's record."""
    rejected: Mapping[str, str] = field(default_factory=dict)
    """The same, of a rejection."""
    notes: str = ""
    """Figure that holds notes for the operator."""
    sums: tuple[str, ...] = ()
    """Fields that add up over the views of a camera; of others it has the mean."""
    expects: Expects | None = None
    """Of a site-wide stage: what should be as much as is usual; `expect` in the site file has it under the stage's name."""


@dataclass(frozen=True)
class WorldReports:
    """What run.json says of the cameras and pairs from the result of a site-wide stage."""

    cameras: Mapping[str, Entry] = field(default_factory=dict)
    """Entry by field of a camera's record."""
    pairs: Mapping[str, Entry] = field(default_factory=dict)
    """Entry by field of a pair's record."""
    camera_notes: str = ""
    """Figure that maps cameras to a note."""
    lost_cameras: str = ""
    """Figure that maps cameras that could not be used to the reason."""

    def told_elsewhere(self) -> set[str]:
        """Figures that are told of each camera or pair, and not again of the whole."""
        return {entry.figure for entry in (*self.cameras.values(), *self.pairs.values())}

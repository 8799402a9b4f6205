"""Captured files, and what the site states about its cameras."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..contracts import stated
from ..contracts.short_repr import Record
from .arrays import Float64s, Uint8s


@dataclass(frozen=True)
class Capture(Record):
    """One captured file, image or video, as it is on disk."""

    name: str
    data: Uint8s
    """(n,) uint8, the encoded bytes."""


@dataclass(frozen=True)
class Lens(stated.Lens[Float64s, Float64s]):
    """Intrinsics as the site states them, as arrays."""

    distortion: Float64s = field(default_factory=lambda: np.array(stated.NO_DISTORTION))


Placement = stated.Placement[Float64s, Float64s]
"""The pose of a camera as the site states it, as arrays."""


@dataclass(frozen=True)
class Privacy(Record):
    """Polygons of a capture whose content must not be seen."""

    corners: Float64s = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) corners of all polygons, one polygon after the other, in pixels of the upright capture; or as shares of width and
    height, if all corners of a polygon lie between 0 and 1."""
    counts: Float64s = field(default_factory=lambda: np.zeros(0))
    """(polygons,) number of corners of each polygon."""

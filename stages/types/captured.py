"""Captured files, and what the site states about its cameras."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..core.short_repr import Record
from .arrays import Float64s, Uint8s


@dataclass(frozen=True)
class Capture(Record):
    """One captured file, image or video, as it is on disk."""

    name: str
    data: Uint8s
    """(n,) uint8, the encoded bytes."""


@dataclass(frozen=True)
class Lens(Record):
    """Intrinsics as the site states them, for an image of `width` x `height` pixels (both 0: any size)."""

    K: Float64s | None = None
    """(3, 3) pixels, or None when unknown."""
    distortion: Float64s = field(default_factory=lambda: np.zeros(5))
    """(n,) coefficients of `model`, zeros for none; for "brown" k1 k2 p1 p2 k3 in OpenCV's order and meaning, followed by
    OpenCV's further ones if there are any."""
    hfov_deg: float | None = None
    """Horizontal field of view in degrees, used where K is None."""
    width: int = 0
    height: int = 0
    model: str = "brown"
    """Name of the lens model, see `core.lenses`."""
    camera: str = ""
    """Id of the camera if this is one of several views of it, which share its place and its captures; else ""."""
    turn: Float64s | None = None
    """(3, 3) rotation from the camera's axes to those of this view; None if the view is the camera's own."""
    window: Float64s | None = None
    """(4,) extent of this view to the left, right, up and down: x / z and y / z in its axes."""


@dataclass(frozen=True)
class Privacy(Record):
    """Polygons of a capture whose content must not be seen."""

    corners: Float64s = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) corners of all polygons, one polygon after the other, in pixels of the upright capture; or as shares of width and
    height, if all corners of a polygon lie between 0 and 1."""
    counts: Float64s = field(default_factory=lambda: np.zeros(0))
    """(polygons,) number of corners of each polygon."""


@dataclass(frozen=True)
class Placement(Record):
    """The pose of a camera as the site states it."""

    R: Float64s | None = None
    """(3, 3) world axes to camera axes, None if unknown."""
    C: Float64s | None = None
    """(3,) the centre in the world, None if unknown."""
    sigma_m: float = 0.0
    """Standard deviation of C in metres; 0: C is held fixed."""
    sigma_deg: float = 0.0
    """Standard deviation of R in degrees; 0: R is held fixed."""
    metric: bool = True
    """Whether C is in metres."""


@dataclass(frozen=True)
class Survey(Record):
    """What was measured on a site besides its cameras' poses.  Cameras are given by their position in the site file."""

    cameras: tuple[str, ...] = ()
    """Ids in the order of the site file."""
    distances: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    """(n, 3) rows of camera, camera, distance between their centres in metres."""
    points: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    """(p, 3) control points, metres."""
    observations: Float64s = field(default_factory=lambda: np.zeros((0, 4)))
    """(m, 4) rows of control point, camera, x, y in pixels of the image as captured (upright)."""
    crs: str = ""
    """The coordinate system of the world, "" if it is local."""

"""What is captured, and what the site knows of its cameras."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..core.short_repr import Record
from .arrays import Float64s, Uint8s


@dataclass(frozen=True)
class Capture(Record):
    """One image file as it lies on disk."""

    name: str
    data: Uint8s
    """(n,) uint8, the encoded bytes."""


@dataclass(frozen=True)
class Lens(Record):
    """Intrinsics as the site states them, for an image of `width` x `height` pixels (both 0: any size)."""

    K: Float64s | None = None
    """(3, 3) pixels, or None when unknown."""
    distortion: Float64s = field(default_factory=lambda: np.zeros(5))
    """(n,) coefficients of `model`; of "brown" k1 k2 p1 p2 k3 (OpenCV's order and meaning, and further ones as OpenCV has them),
    zeros for none."""
    hfov_deg: float | None = None
    """The horizontal field of view, used where K is None."""
    width: int = 0
    height: int = 0
    model: str = "brown"
    """How the lens bends light: a name of `core.lenses`."""
    camera: str = ""
    """Of one view among several of a camera: the id of the camera; views of one camera share its place and its captures."""
    turn: Float64s | None = None
    """(3, 3), from the camera's axes to those of this view; None where the view is the camera's own."""
    window: Float64s | None = None
    """(4,) how far this view reaches to the left, right, up and down: x / z and y / z in its axes."""


@dataclass(frozen=True)
class Privacy(Record):
    """Polygons of a capture that nobody may see."""

    corners: Float64s = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) of all polygons one after the other: pixels of a capture as it is (upright); or, where all of a polygon's are from 0
    to 1, shares of width and height."""
    counts: Float64s = field(default_factory=lambda: np.zeros(0))
    """(polygons,) how many corners each has."""


@dataclass(frozen=True)
class Placement(Record):
    """Where the site says that a camera is."""

    R: Float64s | None = None
    """(3, 3), None where unknown."""
    C: Float64s | None = None
    """(3,), None where unknown."""
    sigma_m: float = 0.0
    """Standard deviation of C in metres, 0 where it is to be held."""
    sigma_deg: float = 0.0
    """Standard deviation of R in degrees, 0 where it is to be held."""
    metric: bool = True
    """C is in metres."""


@dataclass(frozen=True)
class Survey(Record):
    """What is known of a site besides its cameras' poses.  Cameras count by their position in the site file."""

    cameras: tuple[str, ...] = ()
    """Ids in the order of the site file."""
    distances: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    """(n, 3) rows of camera, camera, metres between their centres."""
    points: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    """(p, 3) control points, metres."""
    observations: Float64s = field(default_factory=lambda: np.zeros((0, 4)))
    """(m, 4) rows of control point, camera, x, y in pixels of the image as captured (upright)."""
    crs: str = ""
    """The coordinate system of the world, "" where it is local."""

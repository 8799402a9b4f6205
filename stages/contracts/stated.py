"""What the site file states about cameras and ground: lenses, poses, distances, control points, observations of things.

The engine reads these from YAML as lists of numbers; the vision works with them as arrays (`types.captured`).  Both are the same
dataclasses, with the type of their vectors and matrices as parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

from .short_repr import Record

Matrix = TypeVar("Matrix")
"""Lists of rows in the engine, float64 arrays in the vision."""
Vector = TypeVar("Vector")
"""A list of numbers in the engine, a float64 array in the vision."""

Integers = TypeVar("Integers")
"""`array("i")` in the engine, int32 arrays in the vision."""
Numbers = TypeVar("Numbers")
"""`array("d")` in the engine (tables row by row), float64 arrays in the vision."""

NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
"""The coefficients of a lens without distortion."""


class LensModel(StrEnum):
    """The lens models by their names in a site file; `core.lenses` has their projections."""

    counts: tuple[int, ...]
    """Numbers of distortion coefficients that can be stated; further ones are 0."""
    order: str
    """Names of the coefficients, in order; "" if there are none."""

    def __new__(cls, name: str, counts: tuple[int, ...] = (), order: str = "") -> LensModel:
        member = str.__new__(cls, name)
        member._value_ = name
        member.counts = counts
        member.order = order
        return member

    PINHOLE = "pinhole", (0,)
    BROWN = "brown", (0, 1, 2, 3, 4, 5, 8, 12, 14), "k1 k2 p1 p2 k3, and further ones as OpenCV orders them"
    RATIONAL = "rational", (8, 12, 14), "k1 k2 p1 p2 k3 k4 k5 k6"
    FISHEYE = "fisheye", (1, 2, 3, 4), "k1 k2 k3 k4"
    DIVISION = "division", (1,), "k"
    FOV = "fov", (1,), "omega"
    EUCM = "eucm", (2,), "alpha beta"
    OMNI = "omni", (1, 3, 5, 6), "xi k1 k2 p1 p2"
    DOUBLE_SPHERE = "double-sphere", (2,), "xi alpha"
    THIN_PRISM_FISHEYE = "thin-prism-fisheye", (8,), "k1 k2 p1 p2 k3 k4 sx1 sy1"
    RAD_TAN_THIN_PRISM_FISHEYE = "rad-tan-thin-prism-fisheye", (12,), "k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3"
    EQUIRECTANGULAR = "equirectangular", (0,)


@dataclass(frozen=True)
class Lens(Record, Generic[Matrix, Vector]):
    """Intrinsics as the site states them, for an image of `width` x `height` pixels (both 0: any size)."""

    K: Matrix | None = None
    """(3, 3) pixels, or None when unknown."""
    distortion: Vector | tuple[float, ...] = NO_DISTORTION
    """(n,) coefficients of `model`, zeros for none; for "brown" k1 k2 p1 p2 k3 in OpenCV's order and meaning, followed by
    OpenCV's further ones if there are any."""
    hfov_deg: float | None = None
    """Horizontal field of view in degrees, used where K is None."""
    width: int = 0
    height: int = 0
    model: str = "brown"
    """The name of a `LensModel`."""
    camera: str = ""
    """Id of the camera if this is one of several views of it, which share its place and its captures; else ""."""
    turn: Matrix | None = None
    """(3, 3) rotation from the camera's axes to those of this view; None if the view is the camera's own."""
    window: Vector | None = None
    """(4,) extent of this view to the left, right, up and down: x / z and y / z in its axes."""


@dataclass(frozen=True)
class Placement(Record, Generic[Matrix, Vector]):
    """The pose of a camera as the site states it: x ~ K R (X - C)."""

    R: Matrix | None = None
    """(3, 3) world axes to camera axes, None if unknown."""
    C: Vector | None = None
    """(3,) the centre in the world, None if unknown."""
    sigma_m: float = 0.0
    """Standard deviation of C in metres; 0: C is held fixed."""
    sigma_deg: float = 0.0
    """Standard deviation of R in degrees; 0: R is held fixed."""
    metric: bool = True
    """Whether C is in metres; otherwise its scale is unknown."""


@dataclass(frozen=True)
class Survey(Record):
    """What was measured on a site besides its cameras' poses.  Cameras are given by their position in the site file."""

    cameras: tuple[str, ...] = ()
    """Ids in the order of the site file."""
    distances: tuple[tuple[int, int, float], ...] = ()
    """Rows of camera, camera, distance between their centres in metres."""
    points: tuple[tuple[float, float, float], ...] = ()
    """Control points: x, y, z in metres."""
    observations: tuple[tuple[int, int, float, float], ...] = ()
    """Rows of control point, camera, x, y in pixels of the image as captured (upright)."""
    crs: str = ""
    """The coordinate system of the world, "" if it is local."""


@dataclass(frozen=True)
class Observations(Record, Generic[Integers, Numbers]):
    """Rows of camera, time, thing, x, y, sigma: a lamp, the corners of a board, a drone, a point that somebody clicked."""

    cameras: tuple[str, ...]
    """Ids of the cameras that `camera` counts."""
    things: tuple[str, ...]
    """Ids of the things that `thing` counts; a file without ids has one thing."""
    camera: Integers
    """(n,)"""
    thing: Integers
    """(n,)"""
    time: Numbers
    """(n,) by the camera's own clock; nan: the thing does not move."""
    xy: Numbers
    """(n, 2) pixels of the picture as captured, with its distortion."""
    sigma_px: Numbers
    """(n,) standard deviation of a coordinate, nan where none is stated."""
    time_unit: str = "s"
    """"s", or "frames" where the file counts frames."""


@dataclass(frozen=True)
class ThingSurvey(Record, Generic[Integers, Numbers]):
    """What is known of the things themselves: their places, or lengths between them."""

    things: tuple[str, ...]
    """Ids of the things that the rows count."""
    thing: Integers
    """(n,) of each known place."""
    time: Numbers
    """(n,) in the unit of the observations, by the clock of the first camera up to an offset; nan: it does not move."""
    position: Numbers
    """(n, 3) metres, world."""
    sigma_m: Numbers
    """(n,) standard deviation of a coordinate, nan where none is stated."""
    lengths: tuple[tuple[int, int, float], ...] = ()
    """Rows of thing, thing, distance between them at any one time in metres."""
    crs: str = ""
    """The coordinate system of the positions, "" if it is local."""
    time_unit: str = "s"

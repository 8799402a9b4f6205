"""A valid site description, in plain values."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..cache.keep import Keep
from ..cache.layout import WorkFolder
from ..task import camera_of
from .locations import Document, Location, SiteProblem

if TYPE_CHECKING:
    from ..cache.functions import FunctionReader

Matrix = list[list[float]]


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a camera as the site states them."""

    K: Matrix | None = None
    """3x3, pixels; None where unknown."""
    distortion: list[float] = field(default_factory=lambda: [0.0] * 5)
    """Coefficients of `model`; of "brown" k1 k2 p1 p2 k3."""
    hfov_deg: float | None = None
    """Horizontal field of view, used where K is None."""
    width: int = 0
    """Of the image that this is for, pixels; 0: unstated."""
    height: int = 0
    model: str = "brown"
    """How the lens bends light: a key of `calibrated.COEFFICIENTS`."""
    camera: str = ""
    """Of one view among several: the id of the camera that has them."""
    turn: Matrix | None = None
    """3x3, from the camera's axes to those of this view; None where it has the one view."""
    window: list[float] | None = None
    """How far this view reaches: slopes to the left, right, up and down, as the vision defines them."""


@dataclass(frozen=True)
class Privacy:
    """Polygons of a capture that nobody may see."""

    corners: Matrix = field(default_factory=list)
    """x and y of the corners of all polygons one after the other: pixels of a capture, or shares of width and height."""
    counts: list[float] = field(default_factory=list)
    """How many corners each has."""


@dataclass(frozen=True)
class Placement:
    """Where a camera is said to be: x ~ K R (X - C)."""

    R: Matrix | None = None
    """3x3; None where unknown."""
    C: list[float] | None = None
    """Metres."""
    sigma_m: float = 0.0
    """Standard deviation of C; 0 where it is to be held."""
    sigma_deg: float = 0.0
    """Standard deviation of R, degrees; 0 where it is to be held."""
    metric: bool = True
    """C is in metres."""


@dataclass(frozen=True)
class Survey:
    """What is known of the ground besides the cameras.  Cameras count by their position in the site file."""

    cameras: tuple[str, ...] = ()
    distances: Matrix = field(default_factory=list)
    """Rows of camera, camera, metres."""
    points: Matrix = field(default_factory=list)
    """Control points, metres."""
    observations: Matrix = field(default_factory=list)
    """Rows of control point, camera, x, y in pixels of the capture."""
    crs: str = ""
    """Coordinate system of the world; "" where it is local."""


def plain(stated: Lens | Privacy | Placement | Survey) -> dict[str, Any]:
    """The fields that say something, by name."""
    nothing = type(stated)()
    values = {f.name: getattr(stated, f.name) for f in dataclasses.fields(stated)}
    return {name: value for name, value in values.items() if value != getattr(nothing, name)}


@dataclass(frozen=True)
class Camera:
    """One camera of a site."""

    id: str
    lens: Lens
    placement: Placement
    mask: Path | None = None
    privacy: Privacy = field(default_factory=Privacy)
    """What nobody may see of its picture."""
    images: tuple[str, ...] | None = None
    """File names below the captures' root, where the site file lists them."""
    location: Location = ()
    """Where it stands in the site file."""

    @property
    def camera(self) -> str:
        """The id of the camera, where this is a view of one that has several."""
        return camera_of(self.id)

    @property
    def posed(self) -> bool:
        """Are intrinsics and the whole pose given, exactly or with a standard deviation of each part that is not exact?"""
        return self.stated and (not self.placement.sigma_m or self.placement.sigma_deg > 0)

    @property
    def stated(self) -> bool:
        """Are intrinsics and pose both given, exactly or not?"""
        return self.lens.K is not None and self.placement.R is not None and self.placement.C is not None


class Measure(StrEnum):
    """A figure of a night that is compared with what is usual."""

    POINTS = "points"
    PAIRS = "pairs"
    COVERAGE = "coverage"
    CAMERAS = "cameras"
    BRIGHTNESS = "brightness"


_LIMITS: Mapping[str, float] = {
    Measure.POINTS: 0.7,
    Measure.PAIRS: 0.7,
    Measure.COVERAGE: 0.7,
    Measure.CAMERAS: 1.0,
    Measure.BRIGHTNESS: 0.35,
}


@dataclass(frozen=True)
class Expected:
    """What a good night gives: shares of what is usual, or, above 1, least counts."""

    stated: Mapping[str, float] = field(default_factory=dict)
    """As the site file says, by name."""
    since: str = ""
    """Earlier nights (ISO 8601) don't say what is usual; "" where all do."""

    def limit(self, name: str) -> float:
        """The least share, or count, of a figure that a good night has."""
        return self.stated.get(name, _LIMITS.get(name, 0.0))


@dataclass(frozen=True)
class Notify:
    """Who is told of a night: a command."""

    command: str | tuple[str, ...]
    """For the shell, or program and arguments."""
    folder: Path
    """Where it runs: that of the site file."""
    heartbeat: bool = False
    """Told of every night."""
    seconds: float = 60.0
    """How long it may take."""


@dataclass(frozen=True)
class StageSettings:
    """What the site file says of one stage: another function for it (`use`), parameters, or that it is off."""

    use: str | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    enabled: bool = True
    files: dict[str, Path] = field(default_factory=dict)
    """By the name that each has in its section."""


@dataclass(frozen=True)
class Site:
    """A valid site description."""

    name: str
    document: Document
    root: Path
    pattern: str
    cameras: tuple[Camera, ...]
    views: tuple[Camera, ...]
    """What the stages work on: the cameras, but each that is too wide for one pinhole as several views."""
    resolution: int | None
    bounds: list[list[float]] | None
    """Two corners of the box that holds all that matters; None where nobody says."""
    pairs: dict[str, Any]
    stages: dict[str, StageSettings]
    work: Path
    reader: FunctionReader
    survey: Survey = field(default_factory=Survey)
    expected: Expected = Expected()
    notify: Notify | None = None
    keep: Keep = field(default_factory=Keep)
    """What stays on disk after a run."""
    notes: tuple[SiteProblem, ...] = ()
    """What still works, but should be written otherwise."""
    pin: str = "auto"
    """"auto": the first good run is what later ones are compared with; "none": nothing is."""
    health: dict[str, Any] = field(default_factory=dict)
    """Limits of what a camera may differ by, by name."""
    zones: list[dict[str, Any]] | None = None
    """Where changes count: name, polygon (corners x, y on the ground), least_m; None: everywhere."""
    store: str = ""
    """URL of the object store that the work folder mirrors; "" where it is an ordinary one."""
    captures_store: str = ""
    """The same of the captures' root."""

    @property
    def work_folder(self) -> WorkFolder:
        """Where its work lies."""
        return WorkFolder(self.work, self.store)

    @property
    def file(self) -> Path:
        """The site file."""
        return self.document.path

    @property
    def posed(self) -> bool:
        """Are the intrinsics and poses of all cameras given?"""
        return all(camera.posed for camera in self.cameras)

    @property
    def rough(self) -> bool:
        """Is the whole pose of some camera stated with standard deviations?"""
        return any(camera.stated and camera.placement.sigma_deg > 0 for camera in self.cameras)

    @property
    def some_stated(self) -> bool:
        """Are the intrinsics and poses of two cameras or more stated, exactly or not?"""
        return sum(camera.stated for camera in self.cameras) > 1

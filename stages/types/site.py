"""Data of all cameras together: their poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..contracts.pose_figures import PosesFigures
from ..contracts.short_repr import Record
from .arrays import Float64s
from .views import Camera


@dataclass(frozen=True)
class LensSigma(Record):
    """Standard deviations of a solved lens."""

    focal: float
    """Standard deviation of the focal length, relative to it."""
    border_px: float
    """Standard deviation of pixels at the border of the frame, apart from what a turn of the camera compensates."""


@dataclass(frozen=True)
class Scene(Record):
    """Expected position of the things that the cameras look at, in the cameras' world."""

    box: Float64s | None = None
    """(2, 3) lowest and highest corner of the box that holds all that matters, world lengths."""
    ground: Float64s | None = None
    """(4,) plane (n, d) with n X + d = 0, n of unit length and pointing up, on which most of the scene stands."""


@dataclass(frozen=True)
class Poses(PosesFigures):
    """The cameras, in one world for each component."""

    cameras: Mapping[str, Camera]
    """Cameras with a pose, stated or solved, by id."""

    def main_cameras(self) -> dict[str, Camera]:
        """The cameras of the main component, by id."""
        return {name: camera for name, camera in self.cameras.items() if camera.component == 0}

"""What the vision reports of cameras that were placed by observations of things: moving lamps, boards, drones, clicked points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .short_repr import Record


@dataclass(frozen=True)
class ObservedCamera(Record):
    """How the observations of one camera agree with its pose."""

    observations: int = 0
    """Number of its observations."""
    used: int = 0
    """Those that agree with the poses, and determine them."""
    reprojection_px: float | None = None
    """Median distance of the used ones from where the thing is projected to, pixels of the captured picture."""
    offset: float = 0.0
    """What is added to the camera's times to get the times of the first camera, in the unit of the times."""
    offset_sigma: float = 0.0
    """Its standard deviation; 0 if it was not estimated."""
    sigma_m: float | None = None
    """Standard deviation of the position: the largest of any direction, world lengths."""
    sigma_deg: float | None = None
    """Standard deviation of the rotation, about the axis about which it is largest, degrees."""
    focal_change: float | None = None
    """Relative difference between the solved and the stated focal length; None if it was not solved or not stated."""
    reason: str = ""
    """Why it could not be placed; "" if it was."""


@dataclass(frozen=True, kw_only=True)
class ObservedFigures(Record):
    """How cameras were placed by observations; the poses are in `types.ObservedPoses`."""

    cameras: Mapping[str, ObservedCamera] = field(default_factory=dict)
    """By id, all cameras that have observations."""
    things: int = 0
    """Number of moments of things that two cameras or more place."""
    reprojection_px: float | None = None
    """Median over all used observations."""
    survey_m: float | None = None
    """Median distance between where the survey and the cameras place the thing, metres; None without positions of it."""
    halves_m: float | None = None
    """Largest distance between the positions of a camera from two disjoint halves of the observations, world lengths."""
    halves_deg: float | None = None
    """Largest angle between the rotations of a camera from the two halves, degrees."""
    metric: bool = False
    """Lengths are metres."""
    scale: str = ""
    """Source of the scale, in words."""
    time_unit: str = "s"
    """"s" or "frames"."""
    notes: tuple[str, ...] = ()
    """What a surveyor should know: cameras that are badly tied, where the thing should be moved next, a lens that disagrees."""

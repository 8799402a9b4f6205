"""What the vision reports of one camera: its picture, its keypoints, and its state compared with the reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar

from .short_repr import Record


@dataclass(frozen=True, kw_only=True)
class Notes(Record):
    """The notes of any camera stage."""

    notes: tuple[str, ...] = ()
    """What the operator should know: captures left out, exposure."""


@dataclass(frozen=True, kw_only=True)
class FrameFigures(Record):
    """The quality of a camera's clean frame; None where a figure was not measured."""

    brightness: float | None = None
    """Mean grey level of the usable pixels, 0 to 255."""
    contrast: float | None = None
    """Standard deviation of the grey levels of the usable pixels."""
    saturated: float | None = None
    """Share of the usable pixels that is saturated."""
    sharpness: float | None = None
    """Standard deviation of the Laplacian as a share of the contrast: lowered by defocus, drops and dirt, not by darkness."""
    combing: float | None = None
    """Share of the captures' structured parts in which every second row is from another moment, or shifted (median)."""
    blocking: float | None = None
    """Ratio of the strength of edges at the borders of the captures' coded blocks to that within blocks."""
    blur_px: float | None = None
    """Standard deviation of the blur of the sharper edges in the frame's softest part, pixels; None if it has no edges."""
    detail_px: float | None = None
    """Spacing in pixels of the details that the frame resolves, in the coarser direction."""
    coarseness: float | None = None
    """`blocking` as far as it remains at working resolution."""
    cast: float | None = None
    """Mean of the strongest of red, green and blue over that of the weakest, in the captures."""
    colour: float | None = None
    """Median saturation of the captures with their cast removed, 0 (grey, infrared) to 1."""
    noise: float | None = None
    """Standard deviation of the captures' noise, grey levels (median)."""
    noise_left: float | None = None
    """`noise` as far as it remains after the median of the captures, at working resolution."""
    frames_used: int | None = None
    """Number of captures with full weight."""
    doubtful: float | None = None
    """Share of pixels where no majority of the captures agrees: something stood or moved there."""
    unchanged: float | None = None
    """Share of pixels with exactly equal grey levels in all captures; 0 for a single capture."""
    taken_first: str | None = None
    taken_last: str | None = None
    """Times of the first and the last capture, ISO 8601, as the camera recorded them; "" if it did not."""
    taken_in_order: bool | None = None
    """False where the cameras' times contradict the order of the captures."""
    picture_digest: str | None = None
    """Digest of the last capture's pixels: it differs between any two cameras."""


@dataclass(frozen=True)
class FeaturesFigures(Record):
    """Keypoints of a camera."""

    keypoints: int | None = None


@dataclass(frozen=True)
class CameraStagesFigures(FeaturesFigures, FrameFigures):
    """The figures of all camera stages, as run.json has them of each camera."""


@dataclass(frozen=True)
class DepthFigures(Record):
    """The depth map of one view, from its pairs."""

    offset_px: Mapping[str, float] = field(default_factory=dict)
    """Overall difference in pixels between the depths that two partners give, by "left--right" of the partners."""


HealthState = Literal["ok", "shifted", "moved", "obscured", "stale", "wrong-scene"]
"""State of a camera.  shifted: turned slightly, still in use; obscured: too dark, covered, dirty or out of focus; stale: its
pictures are not from tonight; wrong-scene: it shows another place."""


@dataclass(frozen=True)
class Health(Record):
    """State of a camera, compared with the reference or with earlier nights."""

    state: HealthState = "ok"
    text: str = ""
    """The finding, in one line."""
    figures: Mapping[str, Any] = field(default_factory=dict)
    """Measured values by name: finite numbers and texts."""
    expected: Mapping[str, Any] = field(default_factory=dict)
    """Limits of figures of the same names, if there are any."""
    remedy: str = ""
    """What to do about it, "" if nothing."""

    @property
    def ok(self) -> bool:
        """Is the camera in its usual condition?"""
        return self.state == "ok"


@dataclass(frozen=True)
class ExaminedHealth(Health):
    """State of a camera, as its picture shows it."""

    corrected: bool = False
    """The camera has shifted, and its pose is that of the reference, turned by the measured rotation."""


Vector = TypeVar("Vector")
"""A list of numbers in the engine, a float64 array in the vision."""


@dataclass(frozen=True)
class ShiftHistory(Record, Generic[Vector]):
    """Shifts of a camera on earlier nights against the same reference, oldest first.

    The figures of a camera's health have the same names.
    """

    shift_x_px: Vector
    shift_y_px: Vector
    """(n,) shift of the picture in x and in y, pixels."""
    roll_deg: Vector
    """(n,) turn about the optical axis, degrees."""

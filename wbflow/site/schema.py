"""What may stand in a site file: its sections as validation models."""

from __future__ import annotations

import datetime
import re
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from ..cache.keep import Keep
from ..cache.sizes import bytes_of
from .calibrated import lens_fault
from .geodesy import ControlPoint, Distance, Position
from .rotations import cross, look_at, yaw_pitch_roll

GEODETIC_SIGMA_M = 3.0
"""Standard deviation of a position that is given by latitude and longitude without one: a plain satellite receiver's, metres."""
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Matrix3 = Annotated[list[Vector3], Field(min_length=3, max_length=3)]


class Section(BaseModel):
    """A mapping of a site file: unknown keys are refused, and nothing is converted."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class CapturesSection(Section):
    """Where captures are, and what they are called."""

    root: str = "."
    pattern: str

    @field_validator("pattern")
    @classmethod
    def _known_fields(cls, pattern: str) -> str:
        unknown = [f for f in re.findall(r"\{(\w*)", pattern) if f not in {"camera", "date", "time"}]
        if unknown:
            use = "use {camera}, {date:%Y-%m-%d}, {time:%H%M%S}, * and **"
            raise PydanticCustomError("pattern", f"{{{unknown[0]}}} is not known; {use}")
        return pattern


class IntrinsicsSection(Section):
    """Intrinsics of a camera, or its field of view."""

    fx: float | None = Field(None, gt=0)
    fy: float | None = Field(None, gt=0)
    cx: float | None = None
    cy: float | None = None
    width: int | None = Field(None, gt=0)
    height: int | None = Field(None, gt=0)
    hfov: float | None = Field(None, gt=1, lt=179)

    @model_validator(mode="after")
    def _complete(self) -> IntrinsicsSection:
        if self.hfov is not None:
            if self.fx is not None or self.fy is not None:
                raise PydanticCustomError("intrinsics", "'hfov' and 'fx', 'fy' say the same thing twice")
            return self
        missing = [name for name in ("fx", "fy", "cx", "cy", "width", "height") if getattr(self, name) is None]
        if missing:
            names = ", ".join(f"'{name}'" for name in missing)
            raise PydanticCustomError("intrinsics", f"{names} {'is' if len(missing) == 1 else 'are'} missing")
        return self


class PoseSection(Position):
    """Where a camera is, and which way it looks."""

    position_sigma_m: float | None = Field(None, ge=0)
    rotation_sigma_deg: float | None = Field(None, ge=0)
    rotation: Matrix3 | None = None
    look_at: Vector3 | None = None
    yaw_pitch_roll: Vector3 | None = None

    @model_validator(mode="after")
    def _one_direction(self) -> PoseSection:
        given = [n for n in ("rotation", "look_at", "yaw_pitch_roll") if getattr(self, n) is not None]
        if len(given) > 1:
            raise PydanticCustomError("pose", f"{' and '.join(given)} are both given")
        if self.look_at is not None and self.position is None:
            raise PydanticCustomError("pose", "'look_at' needs 'position' in the same coordinates")
        if self.rotation_sigma_deg is not None and not given:
            raise PydanticCustomError("pose", "'rotation_sigma_deg' says how well a rotation is known that is not given")
        self.matrix()
        return self

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the position: as stated, else what a satellite receiver gives, else exact."""
        if self.position_sigma_m is not None:
            return self.position_sigma_m
        return GEODETIC_SIGMA_M if self.geodetic else 0.0

    @property
    def sigma_deg(self) -> float:
        """Standard deviation of the rotation, degrees: as stated, else exact."""
        return self.rotation_sigma_deg or 0.0

    def matrix(self) -> list[list[float]] | None:
        """R, whichever way it is stated; None where only the position is."""
        try:
            if self.look_at is not None and self.position is not None:
                return look_at(self.position, self.look_at)
            if self.yaw_pitch_roll is not None:
                return yaw_pitch_roll(*self.yaw_pitch_roll)
        except ValueError as error:
            raise PydanticCustomError("pose", str(error)) from None
        R = self.rotation
        if R is not None and any(
            abs(sum(a * b for a, b in zip(R[i], R[j], strict=True)) - (i == j)) > 1e-3 for i in range(3) for j in range(3)
        ):
            raise PydanticCustomError("pose", "'rotation' is not a rotation matrix (rows of unit length, at right angles)")
        if R is not None and sum(a * b for a, b in zip(cross(R[0], R[1]), R[2], strict=True)) < 0:
            raise PydanticCustomError("pose", "'rotation' is a mirror, not a rotation (its determinant is -1)")
        return R


class CameraSection(Section):
    """One camera."""

    id: str
    intrinsics: IntrinsicsSection | None = None
    model: str | None = None
    distortion: Annotated[list[float], Field(min_length=1, max_length=14)] | None = None
    calibration: str | None = None
    pose: PoseSection | None = None
    mask: str | None = None
    privacy: list[list[Annotated[list[float], Field(min_length=2, max_length=2)]]] = Field(default_factory=list)
    images: list[str] | None = None

    @model_validator(mode="after")
    def _lens(self) -> CameraSection:
        if self.distortion is None and self.model is None:
            return self
        what, remedy = lens_fault(self.model or "brown", self.distortion)
        if what:
            raise PydanticCustomError("lens", f"{what}; {remedy}")
        bends = self.model not in {None, "pinhole", "brown"}
        if bends and self.calibration is None and (self.intrinsics is None or self.intrinsics.fx is None):
            raise PydanticCustomError("lens", f"a {self.model} lens needs 'intrinsics' with fx, fy, cx, cy, width, height")
        return self

    @field_validator("privacy")
    @classmethod
    def _areas(cls, polygons: list[list[list[float]]]) -> list[list[list[float]]]:
        for polygon in polygons:
            if len(polygon) < 3:
                raise PydanticCustomError("privacy", "a polygon has three corners or more: [[x, y], [x, y], [x, y]]")
            if min(value for corner in polygon for value in corner) < 0:
                raise PydanticCustomError("privacy", "corners are pixels of a capture, or shares of its width and height, from 0")
        return polygons


class PairsSection(Section):
    """Which pairs are worth matching."""

    degree: int = Field(6, ge=1, le=100)
    min_angle: float = Field(4.0, ge=0, lt=180)
    max_angle: float = Field(60.0, gt=0, le=180)
    include: list[Annotated[list[str], Field(min_length=2, max_length=2)]] = Field(default_factory=list)
    exclude: list[Annotated[list[str], Field(min_length=2, max_length=2)]] = Field(default_factory=list)


class KeepSection(Section):
    """What stays on disk after a run."""

    nights: int | None = None
    bytes: int | None = None
    clouds: int | None = None
    reports: int | None = None

    @field_validator("nights", "clouds", "reports", mode="before")
    @classmethod
    def _count(cls, value: Any) -> int | None:
        if value is None or value == "all":
            return None
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise PydanticCustomError("keep", f"give a count of nights, or all, not {value!r}")
        return value

    @field_validator("bytes", mode="before")
    @classmethod
    def _size(cls, value: Any) -> int | None:
        try:
            return None if value is None or value == "all" else bytes_of(str(value))
        except ValueError as error:
            raise PydanticCustomError("keep", str(error)) from None

    def kept(self) -> Keep:
        """The same for who cleans: of what is not said to stay longer, so many `nights` stay."""
        told = self.model_fields_set
        clouds = self.clouds if "clouds" in told else self.nights
        reports = self.reports if "reports" in told else self.nights
        return Keep(nights=self.nights, bytes=self.bytes, clouds=clouds, reports=reports)


class ExpectSection(Section):
    """What a good night gives: shares of what is usual, or, above 1, least counts."""

    points: float | None = Field(None, ge=0)
    pairs: float | None = Field(None, ge=0)
    coverage: float | None = Field(None, ge=0)
    cameras: float | None = Field(None, ge=0)
    brightness: float | None = Field(None, ge=0, le=1)
    since: datetime.date | None = None

    @property
    def stated(self) -> dict[str, float]:
        """The limits that are given, by name."""
        return {name: value for name, value in self.model_dump(exclude={"since"}).items() if value is not None}


class NotifySection(Section):
    """Who is told of a night."""

    command: str | list[str]
    heartbeat: bool = False
    seconds: float = Field(60.0, gt=0, le=3600)

    @field_validator("command", mode="before")
    @classmethod
    def _command(cls, command: object) -> object:
        words = [command] if isinstance(command, str) else command
        if not isinstance(words, list) or not words or not all(isinstance(word, str) and word for word in words):
            raise PydanticCustomError("notify", "a command is a text for the shell, or a list of program and arguments")
        return command


class HealthSection(Section):
    """When a camera is no longer what it was when the reference was pinned (see `wbflow_stages.health`)."""

    nudged_px: float = Field(1.5, gt=0)
    moved_deg: float = Field(0.4, gt=0)
    flat: float = Field(0.9, gt=0, le=1)
    dark: float = Field(6.0, ge=0, le=255)


class ZoneSection(Section):
    """A part of the ground where changes count."""

    name: str
    polygon: Annotated[list[Annotated[list[float], Field(min_length=2, max_length=2)]], Field(min_length=3)]
    least_m: float = Field(0.0, ge=0)


class SiteSection(Section):
    """The whole file."""

    site: str
    captures: CapturesSection
    cameras: Annotated[list[CameraSection], Field(min_length=1)]
    calibration: str | None = None
    distances: list[Distance] = Field(default_factory=list)
    control_points: list[ControlPoint] = Field(default_factory=list)
    resolution: int | None = Field(1600, ge=64)
    bounds: Annotated[list[Vector3], Field(min_length=2, max_length=2)] | None = None
    pairs: PairsSection = PairsSection.model_validate({})
    pin: Literal["auto", "none"] = "auto"
    health: HealthSection = HealthSection.model_validate({})
    zones: list[ZoneSection] = Field(default_factory=list)
    stages: dict[str, Any] = Field(default_factory=dict)
    expect: ExpectSection = ExpectSection.model_validate({})
    notify: NotifySection | None = None
    keep: KeepSection = KeepSection.model_validate({})
    work: str | None = None

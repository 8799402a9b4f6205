"""Data models of a site: `SiteFile` and its sections validate the YAML; `Site` adds resolved paths, calibrations and stages."""

from __future__ import annotations

import dataclasses
import datetime
import re
import time
import zoneinfo
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property, reduce
from operator import getitem
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from wbflow_stages.contracts import defaults
from wbflow_stages.contracts.stated import Survey

from ..cache.layout import WorkFolder
from ..pipeline.binding import Bindings
from ..pipeline.stages import STAGES, Stage, ancestors
from ..records.keep import Keep
from ..task import camera_of
from ..words import bytes_of
from .calibration.calibrated import Lens, Matrix, Placement, lens_fault, look_at, rotation_fault, yaw_pitch_roll
from .observation_tables import ObservationTable, SurveyTable
from .pattern import Pattern, pattern_fault
from .yaml_document import Document, Problem, suggest

Vector2 = Annotated[list[float], Field(min_length=2, max_length=2)]
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Matrix3 = Annotated[list[Vector3], Field(min_length=3, max_length=3)]
CameraPair = Annotated[list[str], Field(min_length=2, max_length=2)]

GEODETIC_SIGMA_M = 3.0
"""Standard deviation, in metres, of a geodetic position that is given without one: that of a plain satellite receiver."""
_GEODETIC_FIELDS = ("latitude", "longitude", "height")
"""Fields of a geodetic position, in the order of `Position.geodetic`."""

CUSTOM = "site"
"""Type of validation errors whose message is shown as it is, without the input value appended."""


def _error(what: str) -> PydanticCustomError:
    return PydanticCustomError(CUSTOM, "{what}", {"what": what})


class Section(BaseModel):
    """A mapping in a site file: unknown keys are refused, and values are not converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Captures(Section):
    """Where captures are, and the pattern of their file names."""

    root: str = "."
    pattern: str
    frames: int = Field(default=7, ge=1, le=500)
    seconds: float = Field(default=60.0, ge=0, le=3600)
    """`wbflow capture` takes `frames` pictures with each camera, spread over `seconds`."""
    credentials: str | None = None
    """File with the user and password of each camera, for `wbflow capture`."""

    @field_validator("pattern")
    @classmethod
    def _check_fields(cls, pattern: str) -> str:
        fault = pattern_fault(pattern)
        if fault:
            raise _error(fault)
        return pattern


class Intrinsics(Section):
    """Intrinsics of a camera, or its field of view."""

    fx: float | None = Field(default=None, gt=0)
    fy: float | None = Field(default=None, gt=0)
    cx: float | None = None
    cy: float | None = None
    width: int | None = Field(default=None, gt=0)
    height: int | None = Field(default=None, gt=0)
    hfov: float | None = Field(default=None, gt=1, lt=179)

    @model_validator(mode="after")
    def _check_complete(self) -> Intrinsics:
        if self.hfov is not None:
            if self.fx is not None or self.fy is not None:
                raise _error("'hfov' and 'fx', 'fy' are both given: keep one of them")
            return self
        missing = [f"'{name}'" for name in ("fx", "fy", "cx", "cy", "width", "height") if getattr(self, name) is None]
        if missing:
            raise _error(f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing")
        return self

    @property
    def K(self) -> Matrix | None:
        """3x3; None if only the field of view is given."""
        if self.fx is None or self.fy is None or self.cx is None or self.cy is None:
            return None
        return [[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]]


class Position(Section):
    """x, y, z in metres, or latitude, longitude, height."""

    position: Vector3 | None = None
    latitude: float | None = Field(default=None, ge=-90, le=90)
    longitude: float | None = Field(default=None, ge=-180, le=360)
    height: float | None = None

    @model_validator(mode="after")
    def _check_position(self) -> Position:
        stated = []
        missing = []
        for name in _GEODETIC_FIELDS:
            if getattr(self, name) is not None:
                stated.append(name)
            else:
                missing.append(name)
        if self.position is not None and stated:
            raise _error(f"'position' and '{stated[0]}' are both given: keep one of them")
        if self.position is None and not stated:
            raise _error("'position' is missing")
        if stated and missing:
            raise _error(f"'{missing[0]}' is missing")
        return self

    @property
    def geodetic(self) -> tuple[float, float, float] | None:
        """(latitude, longitude, height); None if x, y, z are given."""
        if self.latitude is None or self.longitude is None or self.height is None:
            return None
        return self.latitude, self.longitude, self.height


class ControlPoint(Position):
    """A point of the scene with known coordinates, and its pixel position in the (distorted) captures, by camera."""

    id: str | None = None
    pixels: dict[str, Vector2]


class Pose(Position):
    """Position and viewing direction of a camera."""

    position_sigma_m: float | None = Field(default=None, ge=0)
    rotation_sigma_deg: float | None = Field(default=None, ge=0)
    rotation: Matrix3 | None = None
    look_at: Vector3 | None = None
    yaw_pitch_roll: Vector3 | None = None

    @model_validator(mode="after")
    def _check_direction(self) -> Pose:
        stated = [name for name in ("rotation", "look_at", "yaw_pitch_roll") if getattr(self, name) is not None]
        if len(stated) > 1:
            raise _error(f"{' and '.join(stated)} are both given")
        if self.look_at is not None and self.position is None:
            raise _error("'look_at' needs 'position' in the same coordinates")
        if self.rotation_sigma_deg is not None and not stated:
            raise _error("'rotation_sigma_deg' is given without a rotation")
        fault = rotation_fault(self.rotation) if self.rotation else ""
        if fault:
            raise _error(f"'rotation' {fault}")
        try:
            _ = self.R  # a direction may be impossible: straight up, or at its own position
        except ValueError as error:
            raise _error(str(error)) from None
        return self

    @property
    def R(self) -> Matrix | None:
        """3x3, world axes to camera axes, from whichever form is given; None if only the position is given."""
        if self.look_at is not None and self.position is not None:
            return look_at(self.position, self.look_at)
        if self.yaw_pitch_roll is not None:
            return yaw_pitch_roll(*self.yaw_pitch_roll)
        return self.rotation

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the position: as given, else `GEODETIC_SIGMA_M` for a geodetic position, else 0 (exact)."""
        if self.position_sigma_m is not None:
            return self.position_sigma_m
        return GEODETIC_SIGMA_M if self.geodetic else 0.0

    @property
    def sigma_deg(self) -> float:
        """Standard deviation of the rotation, degrees: as given, else 0 (exact)."""
        return self.rotation_sigma_deg or 0.0


class CameraEntry(Section):
    """One camera, as the site file describes it."""

    id: str
    intrinsics: Intrinsics | None = None
    model: str | None = None
    distortion: Annotated[list[float], Field(min_length=1, max_length=14)] | None = None
    calibration: str | None = None
    pose: Pose | None = None
    mask: str | None = None
    privacy: list[list[Vector2]] = []
    images: list[str] | None = None
    url: str | None = None
    tls: bool | str = True

    @field_validator("url")
    @classmethod
    def _check_url(cls, url: str | None) -> str | None:
        if url is None:
            return None
        if not re.match("(https?|rtsps?|file)://.", url):
            raise _error("a url begins with http://, https://, rtsp://, rtsps://, or file:// for a folder that is written to")
        # site files are shared and versioned, so they must not hold passwords
        if "@" in url.split("://", 1)[1].split("/", 1)[0]:
            raise _error("user and password belong in the file named by captures.credentials, not in the url")
        return url

    @field_validator("tls", mode="before")
    @classmethod
    def _check_tls(cls, tls: Any) -> Any:
        if isinstance(tls, str) and re.fullmatch(r"(?i)sha-?256:.*", tls):
            digits = tls.split(":", 1)[1].replace(":", "")
            if not re.fullmatch("[0-9a-fA-F]{64}", digits):
                raise _error("a fingerprint is sha256: and 64 hexadecimal digits, with or without colons between them")
        return tls

    @model_validator(mode="after")
    def _check_lens(self) -> CameraEntry:
        if self.distortion is None and self.model is None:
            return self
        fault = lens_fault(self.model or "brown", self.distortion)
        if fault:
            raise _error(fault)
        # a field of view alone says nothing about the rays of a wide lens
        needs_matrix = self.model not in {None, "pinhole", "brown"}
        if needs_matrix and self.calibration is None and (self.intrinsics is None or self.intrinsics.K is None):
            raise _error(f"a {self.model} lens needs 'intrinsics' with fx, fy, cx, cy, width, height")
        return self

    @field_validator("privacy")
    @classmethod
    def _check_polygons(cls, polygons: list[Matrix]) -> list[Matrix]:
        for polygon in polygons:
            if len(polygon) < 3:
                raise _error("a polygon has three corners or more: [[x, y], [x, y], [x, y]]")
            if min(min(corner) for corner in polygon) < 0:
                raise _error("corners are pixels of a capture, or shares of its width and height, from 0")
        return polygons


def _parse_camera(entry: Any) -> Any:
    if isinstance(entry, str):
        return {"id": entry}
    return entry


CameraOrId = Annotated[CameraEntry, BeforeValidator(_parse_camera, json_schema_input_type=str | CameraEntry)]
"""A camera; written as its id alone if nothing else is known of it."""


class Pairs(Section):
    """How the pairs of cameras to match are chosen."""

    degree: int = Field(default=defaults.PAIR_DEGREE, ge=1, le=100)
    min_angle: float = Field(default=defaults.PAIR_MIN_ANGLE_DEG, ge=0, lt=180)
    max_angle: float = Field(default=defaults.PAIR_MAX_ANGLE_DEG, gt=0, le=180)
    include: list[CameraPair] = []
    exclude: list[CameraPair] = []


def _parse_nights(value: Any) -> int | None:
    if value is None or value == "all":
        return None
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise _error(f"give a count of nights, or all, not {value!r}")
    return value


def _parse_bytes(value: Any) -> int | None:
    if value is None or value == "all":
        return None
    try:
        return bytes_of(str(value))
    except ValueError as error:
        raise _error(str(error)) from None


Nights = Annotated[int | None, BeforeValidator(_parse_nights, json_schema_input_type=int | Literal["all"] | None)]


class KeepEntry(Section):
    """What is kept on disk after a run; None: everything."""

    nights: Nights = None
    bytes: Annotated[int | None, BeforeValidator(_parse_bytes, json_schema_input_type=int | str | None)] = None
    clouds: Nights = None
    reports: Nights = None

    def limits(self) -> Keep:
        """The limits to apply: clouds and reports are kept for `nights` nights unless they have a limit of their own."""
        stated = self.model_fields_set  # `clouds: all` is None, too, and is a limit of its own
        clouds = self.clouds if "clouds" in stated else self.nights
        reports = self.reports if "reports" in stated else self.nights
        return Keep(nights=self.nights, bytes=self.bytes, clouds=clouds, reports=reports)


class Measure(StrEnum):
    """A figure of a night that is compared with its usual value."""

    POINTS = "points"
    PAIRS = "pairs"
    COVERAGE = "coverage"
    CAMERAS = "cameras"
    BRIGHTNESS = "brightness"


def _parse_date(value: Any) -> str:
    if isinstance(value, datetime.date):
        return value.isoformat()
    if not value:
        return ""
    try:
        return datetime.date.fromisoformat(value).isoformat()
    except (TypeError, ValueError):
        raise _error(f"{value!r} is not a date such as 2026-11-20") from None


class Expected(Section):
    """Limits that a good night must reach: shares of the usual value or, above 1, minimum counts."""

    points: float = Field(default=0.7, ge=0)
    pairs: float = Field(default=0.7, ge=0)
    coverage: float = Field(default=0.7, ge=0)
    cameras: float = Field(default=1.0, ge=0)
    brightness: float = Field(default=0.35, ge=0, le=1)
    changes: Literal["none"] | None = None
    """"none": each change that nobody has acknowledged degrades the night."""
    since: Annotated[str, BeforeValidator(_parse_date)] = ""
    """Nights before this date (ISO 8601) do not contribute to the usual values; "": all nights do."""

    @model_validator(mode="before")
    @classmethod
    def _drop_empty(cls, data: Any) -> Any:
        """Drop keys without a value, so that their defaults apply."""
        if not isinstance(data, dict):
            return data
        return {key: value for key, value in data.items() if value is not None}

    def limit(self, name: str) -> float:
        """The minimum share, or count, of a figure on a good night; 0 if there is no limit."""
        return float(getattr(self, name, 0.0))


def _parse_duration(value: Any) -> float:
    seconds_of = {"min": 60.0, "h": 3600.0, "d": 86400.0}
    match = None
    if isinstance(value, str):
        match = re.fullmatch(r"(\d+(?:\.\d+)?) ?(min|h|d)", value)
    if not match or not float(match[1]):
        raise _error(f"{value!r} is not a duration; write for example 30min, 1h or 1d")
    return float(match[1]) * seconds_of[match[2]]


Duration = Annotated[float, BeforeValidator(_parse_duration, json_schema_input_type=str)]
"""Seconds; written 30min, 1h or 1d in the file."""


class NotifyChanges(Section):
    """Which changes the command is called for."""

    min_volume: float = Field(default=0.0, ge=0)
    """Those that may have at least this volume, cubic metres: the upper end of the interval counts."""
    zones: Annotated[list[str], Field(min_length=1)] | None = None
    """Those in the zones of these names; null: all."""


class Notify(Section):
    """The command that is called after a night."""

    command: str | list[str]
    """Text for the shell, or a list of program and arguments."""
    changes: NotifyChanges | Literal[False] = NotifyChanges()
    """Which changes it is called for, once they are new or have grown; false: none."""
    heartbeat: bool = False
    """Whether the command is called after every night, even if nothing has changed."""
    remind: list[Duration] = []
    """Once a state has lasted for one of these durations, the next run calls the command again."""
    seconds: float = Field(default=60.0, gt=0, le=3600)
    """Time limit of the command, seconds."""

    @field_validator("command", mode="before")
    @classmethod
    def _check_command(cls, command: object) -> object:
        words = [command] if isinstance(command, str) else command
        if not isinstance(words, list) or not words or not all(isinstance(word, str) and word for word in words):
            raise _error("a command is a text for the shell, or a list of program and arguments")
        return command


class Health(Section):
    """Thresholds of the check of each camera against the reference (see `wbflow_stages.health`)."""

    nudged_px: float = Field(default=defaults.NUDGED_PX, gt=0)
    moved_deg: float = Field(default=defaults.MOVED_DEG, gt=0)
    flat: float = Field(default=defaults.FLAT_SHARE, gt=0, le=1)
    dark: float = Field(default=defaults.DARK_LEVELS, ge=0, le=255)


class Zone(Section):
    """A part of the ground where changes are reported."""

    name: str
    polygon: Annotated[list[Vector2], Field(min_length=3)]
    least_m: float = Field(default=0.0, ge=0)
    expect: Literal["none"] | None = None
    """"none": each change in it that nobody has acknowledged degrades the night."""


def _check_timezone(name: Any) -> Any:
    try:
        if isinstance(name, str) and zoneinfo.ZoneInfo(name):
            return name
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):  # OSError: the name of a folder of zones, such as "Europe"
        pass
    suggestion = suggest(str(name), zoneinfo.available_timezones(), "write one such as Europe/Berlin")
    raise _error(f"{name!r} is not a time zone; {suggestion}")


class SiteFile(Section):
    """The whole site file."""

    site: str
    timezone: Annotated[str | None, BeforeValidator(lambda name: name and _check_timezone(name))] = None
    captures: Captures
    cameras: Annotated[list[CameraOrId], Field(min_length=1)]
    calibration: str | None = None
    observations: str | None = None
    survey: str | None = None
    distances: list[Annotated[list[Any], Field(min_length=3, max_length=3)]] = []
    control_points: list[ControlPoint] = []
    resolution: int | None = Field(default=defaults.RESOLUTION, ge=64)
    bounds: Annotated[list[Vector3], Field(min_length=2, max_length=2)] | None = None
    pairs: Pairs = Pairs()
    pin: Literal["auto", "none"] = "auto"
    health: Health = Health()
    zones: Annotated[list[Zone] | None, AfterValidator(lambda zones: zones or None)] = None
    stages: dict[str, Any] = {}
    expect: Expected = Expected()
    notify: Notify | None = None
    keep: KeepEntry = KeepEntry()
    work: str | None = None


def site_schema() -> dict[str, Any]:
    """Return the JSON schema of a site file."""
    schema = SiteFile.model_json_schema()
    schema["properties"]["stages"]["properties"] = {stage.name: {"type": ["object", "boolean"]} for stage in STAGES}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "A site of wbflow", **schema}


def stated_fields(value: Lens | Placement | Survey) -> dict[str, Any]:
    """The fields that differ from their defaults, by name."""
    # only these, so that a new field with a default does not change the digest of what a site file states
    default = type(value)()
    stated = {}
    for declared in dataclasses.fields(value):
        own = getattr(value, declared.name)
        if own != getattr(default, declared.name):
            stated[declared.name] = own
    return stated


@dataclass(frozen=True)
class Camera:
    """One camera of a site, or one of the views of a wide camera."""

    id: str
    lens: Lens
    placement: Placement
    mask: Path | None = None
    privacy: list[Matrix] = field(default_factory=list)
    """Polygons of a capture to be blanked for privacy: in pixels, or as shares of its width and height."""
    images: list[str] | None = None
    """File names below the captures' root, if the site file lists them."""

    @property
    def camera(self) -> str:
        """The id of the camera; differs from `id` if this is one of several views."""
        return camera_of(self.id)

    @property
    def posed(self) -> bool:
        """Are intrinsics and the whole pose stated, including the rotation's standard deviation if the position has one?"""
        return self.stated and (not self.placement.sigma_m or self.placement.sigma_deg > 0)

    @property
    def stated(self) -> bool:
        """Are intrinsics and pose both stated, exactly or not?"""
        return self.lens.K is not None and self.placement.R is not None and self.placement.C is not None


@dataclass(frozen=True)
class StageSettings:
    """Settings of one stage in the site file: a function that replaces its own (`use`), parameters, and whether it is enabled."""

    use: str | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    enabled: bool = True
    files: dict[str, Path] = field(default_factory=dict)
    """Files that the section names, by their key in it."""


@dataclass(frozen=True)
class Site:
    """A valid site: the site file with paths resolved, calibrations read and stages checked."""

    settings: SiteFile
    document: Document
    captures: Pattern
    cameras: tuple[Camera, ...]
    views: tuple[Camera, ...]
    """What the stages work on: the cameras, with several views instead of each camera that is too wide for one pinhole."""
    survey: Survey
    observations: ObservationTable | None
    """Where cameras saw things that move or have an identity; None if the file names no observations."""
    thing_survey: SurveyTable | None
    """What was surveyed of these things, in metres."""
    stages: dict[str, StageSettings]
    """The settings of every stage; defaults if the file has none."""
    work_folder: WorkFolder
    bindings: Bindings
    notes: tuple[Problem, ...]
    """Remarks about entries that still work but should be written differently."""
    doubts: tuple[Problem, ...] = ()
    """Values that are hardly meant (`plausibility.py`)."""

    @property
    def name(self) -> str:
        return self.settings.site

    @cached_property
    def _plain_settings(self) -> dict[str, Any]:
        # what a zone expects is for the verdict: it enters no cache key
        return self.settings.model_dump(
            include={"resolution", "bounds", "pairs", "health", "zones"}, exclude={"zones": {"__all__": {"expect"}}}
        )

    def setting(self, key: str) -> Any:
        """The value of a key outside `stages` that sets a parameter of a stage, such as "resolution" or "pairs.degree"."""
        return reduce(getitem, key.split("."), self._plain_settings)

    def stated(self, stage: Stage) -> dict[str, Any]:
        """The parameters of a stage that the site file sets, in the stage's section or elsewhere."""
        accepted = self.bindings.of(stage).parameters
        elsewhere = {name: self.setting(key) for name, key in stage.set_by_site().items() if name in accepted}
        return elsewhere | self.stages[stage.name].parameters

    def active_stages(self, until: str | None = None) -> tuple[Stage, ...]:
        """The stages that take part in a night, in order.  until: the last stage; None: all of them."""
        requested = ancestors(until) if until else {stage.name for stage in STAGES}
        disabled = {name for name, settings in self.stages.items() if not settings.enabled}
        for stage in STAGES:
            if callable(stage.optional) and not stage.optional(self):
                disabled.add(stage.name)
        # in order, so that an optional stage is disabled whenever one that it needs is, directly or not
        for stage in STAGES:
            if stage.optional and disabled & stage.needed():
                disabled.add(stage.name)
        return tuple(stage for stage in STAGES if stage.name in requested - disabled)

    def local(self, seconds: float) -> datetime.datetime:
        """Local time at the site at a moment (seconds since 1970), in `timezone` or else in this machine's time zone."""
        return datetime.datetime.fromtimestamp(seconds, datetime.UTC).astimezone(self.zone)

    @property
    def zone(self) -> zoneinfo.ZoneInfo | None:
        """The time zone of the site; None if the file names none: that of this machine."""
        if not self.settings.timezone:
            return None
        return zoneinfo.ZoneInfo(self.settings.timezone)

    def today(self) -> datetime.date:
        """The present date at the site."""
        return self.local(time.time()).date()

    @property
    def file(self) -> Path:
        return self.document.path

    @cached_property
    def folder(self) -> Path:
        """The folder of the site file, to which its paths are relative."""
        return self.file.resolve().parent

    @property
    def posed(self) -> bool:
        """Is `Camera.posed` true for all cameras?"""
        return all(camera.posed for camera in self.cameras)

    @property
    def has_rough_pose(self) -> bool:
        """Is the whole pose of some camera stated with standard deviations?"""
        return any(camera.stated and camera.placement.sigma_deg > 0 for camera in self.cameras)

    @property
    def has_stated_poses(self) -> bool:
        """Are the intrinsics and poses of two cameras or more stated, exactly or not?"""
        return sum(camera.stated for camera in self.cameras) > 1

"""The parts of results that the engine reads and run.json contains: a typed summary for each stage that has one.

A receipt stores all plain fields of a result; a summary has those that are used.  Fields that are missing, as in a receipt of
another version, are None or empty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Self

from pydantic import AliasChoices, Field, ValidationError, model_serializer, model_validator

from ..json_dataclass import JsonDataclass
from ..records.findings import Health, HealthState


class Summary(JsonDataclass):
    """The fields of a result that are used; each has a default."""

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, data: Any, read: Any) -> Self:
        try:
            summary: Self = read(data)
        except ValidationError:  # the result of another version, or of a function of the site's own
            return cls()
        return summary


def _read_from(*names: str) -> Any:
    """Alternative names of a field, in results and in run.json; the first that is present is read."""
    return Field(validation_alias=AliasChoices(*names))


@dataclass(frozen=True)
class Notes(Summary):
    """The notes of any camera stage."""

    notes: tuple[str, ...] = ()
    """What the operator should know."""


@dataclass(frozen=True)
class FrameSummary(Summary):
    """Quality figures of a camera's clean frame (`stages.types.Frame`)."""

    brightness: float | None = None
    contrast: float | None = None
    saturated: float | None = None
    sharpness: float | None = None
    combing: float | None = None
    blocking: float | None = None
    blur_px: float | None = None
    detail_px: float | None = None
    coarseness: float | None = None
    cast: float | None = None
    colour: float | None = None
    noise: float | None = None
    noise_left: float | None = None
    frames_used: int | None = None
    doubtful: float | None = None
    unchanged: float | None = None
    taken_first: str | None = None
    taken_last: str | None = None
    taken_in_order: bool | None = None
    picture_digest: str | None = None


@dataclass(frozen=True)
class FeaturesSummary(Summary):
    """Keypoints of a camera."""

    keypoints: Annotated[int | None, _read_from("xy_count", "keypoints")] = None


@dataclass(frozen=True)
class CameraFigures(FeaturesSummary, FrameSummary):
    """The figures of a camera in run.json: the summaries of its stages, and its entries in site-wide summaries."""

    pose: Mapping[str, Any] | None = None
    """How well the images agree with its known pose (`stages.types.PoseCheck`)."""
    verified: bool | None = None
    pose_from: str | None = None
    """stated, refined, corrected or solved."""
    points: int | None = None
    misfit: float | None = None
    offset_px: Mapping[str, float] | None = None
    """By two of its dense partners, as `first--second`: overall difference of the depths from its pairs with them, pixels."""


@dataclass(frozen=True)
class HealthSummary(Health, Summary):
    """State of a camera compared with the reference (`stages.types.CameraHealth`)."""

    state: HealthState = "ok"
    corrected: bool = False
    """The camera has shifted, and its pose is that of the reference, turned by the measured rotation."""


@dataclass(frozen=True)
class PairsSummary(Summary):
    """The pair graph, or the dense pairs."""

    pairs: tuple[tuple[str, str], ...] = ()
    crowded: Mapping[str, str] = field(default_factory=dict)
    """Notes by camera."""


@dataclass(frozen=True)
class MatchesSummary(Summary):
    """Matches of a pair."""

    matches: Annotated[int | None, _read_from("x1_count", "matches")] = None


@dataclass(frozen=True)
class GeometrySummary(Summary):
    """The epipolar geometry of a pair; for a rejected pair, the figures behind the rejection."""

    inliers: Annotated[int | None, _read_from("x1_count", "inliers")] = None
    angle_deg: float | None = None
    epipolar_px: float | None = None
    probability: Annotated[float | None, _read_from("good_probability", "probability")] = None


@dataclass(frozen=True)
class RectifySummary(Summary):
    """The rectification of a pair."""

    angle_deg: float | None = None
    vertical_px: float | None = None
    method: str | None = None
    verified: str | None = None
    row_share: float | None = None
    row_chance: float | None = None
    row_error_px: float | None = None


@dataclass(frozen=True)
class DisparitySummary(Summary):
    """Dense matches of a pair."""

    density: float | None = None


@dataclass(frozen=True)
class PairFigures(DisparitySummary, RectifySummary, GeometrySummary, MatchesSummary):
    """The figures of a pair in run.json: the summaries of its stages, and its entry in the summary of the poses."""

    poses_px: float | None = None
    known: str | None = None


@dataclass(frozen=True)
class PairCheck(Summary):
    """How one pair agrees with the cameras of the whole site (`stages.types.PairCheck`)."""

    adjusted_px: float | None = None
    known: str | None = None


@dataclass(frozen=True)
class CalibrationCheck(Summary):
    """How the stated calibration as a whole agrees with the matches (`stages.types.CalibrationCheck`)."""

    matches: int = 0
    pairs: int = 0
    confirmed: bool = False
    misfit: float = 0.0
    contradicted: bool = False
    cause: str = ""
    cameras: tuple[str, ...] = ()
    amount: tuple[float, ...] = ()
    better: float = 1.0
    off_px: float = 0.0
    sigmas: float = 0.0


@dataclass(frozen=True)
class PoseIssue(Summary):
    """A doubt about the pose or the lens of a camera (`stages.types.PoseIssue`)."""

    kind: str = ""
    camera: str = ""
    text: str = ""
    triplets: bool = False
    row_px: float | None = None
    strain: float | None = None
    excess_px: float | None = None
    focal: float | None = None
    border_px: float | None = None


_MOST_ROW_SIGMAS = 3.5
"""Rows agree with the cameras up to this many `CalibrationCheck.sigmas` (140 unharmed nights: 3.2 at most)."""

_FORMER_ISSUES = {
    "suspects": ("moved", "text"),
    "doubtful": ("unverified", "text"),
    "uncertain": ("uncertain", "row_px"),
    "strained": ("inconsistent", "strain"),
}
"""By key of run.json before version 0.2: the kind of the issues, and the field that was written for each camera."""


@dataclass(frozen=True)
class PosesSummary(Summary):
    """How the poses of the cameras were found (`stages.types.Poses`); the cameras themselves are in cameras.json."""

    unsolved: Mapping[str, str] = field(default_factory=dict)
    """Reason by camera."""
    dropped: Mapping[str, str] = field(default_factory=dict)
    metric: bool = True
    """Lengths are metres."""
    source: str = ""
    issues: tuple[PoseIssue, ...] = ()
    distances_off: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    points_off: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    units_off: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    focals: tuple[str, ...] = ()
    components: tuple[tuple[str, ...], ...] = ()
    joins: tuple[str, ...] = ()
    """For each component but the main one: the pair that would best join it to the others."""
    scale: str = ""
    crs: str = ""
    """Coordinate system of the world, in a form that PROJ reads; "" for a local one."""
    notes: tuple[str, ...] = ()
    """What the operator should know."""
    points: int = 0
    reprojection_px: float | None = None
    calibration: CalibrationCheck | None = None
    rows: CalibrationCheck | None = None
    """The check of the calibration by the row offsets that dense matching measures (stage `calibration`)."""
    pair_checks: Annotated[Mapping[str, PairCheck], Field(exclude=True)] = field(default_factory=dict)
    """In run.json, this field and the next two are entries of the pairs and cameras."""
    pose_checks: Annotated[Mapping[str, Mapping[str, Any]], Field(exclude=True)] = field(default_factory=dict)
    sources: Annotated[Mapping[str, str], Field(exclude=True)] = field(default_factory=dict)

    @property
    def unverified(self) -> bool:
        """Are lenses and poses stated, but were there too few matches to check them?"""
        was_checked = self.calibration is not None or (self.rows is not None and self.rows.pairs > 0)
        return self.source in {"calibration", "mixed"} and not was_checked

    @property
    def rows_agree(self) -> bool:
        """Do the row offsets that dense matching measures agree with the stated cameras?"""
        return self.rows is not None and self.rows.pairs > 0 and self.rows.sigmas <= _MOST_ROW_SIGMAS

    @property
    def rows_confirm(self) -> bool:
        """Do the rows of enough pairs agree to overrule keypoints?  Third cameras confirm look-alikes, too, if they see some."""
        return self.rows is not None and self.rows.confirmed and self.rows_agree

    @property
    def contradiction(self) -> CalibrationCheck | None:
        """The check that contradicts the stated calibration.  Rows, which are more exact, overrule keypoints that blame no single
        camera; and they are preferred if they alone name a cause, and all cameras share it."""
        by_keypoints, by_rows = (check if check and check.contradicted else None for check in (self.calibration, self.rows))
        if by_keypoints and self.rows_confirm and not by_keypoints.cameras:
            return None
        if by_rows and not by_rows.cameras and not (by_keypoints and by_keypoints.cause):
            return by_rows
        return by_keypoints or by_rows

    def issues_of(self, kind: str) -> dict[str, PoseIssue]:
        """Return the issues of one kind by camera."""
        return {issue.camera: issue for issue in self.issues if issue.kind == kind}

    @model_serializer(mode="wrap")
    def _with_former_keys(self, write: Any) -> dict[str, Any]:
        """Also write the issues under the keys of versions before 0.2, for one more version."""
        former: dict[str, dict[str, Any]] = {
            key: {camera: getattr(issue, field) for camera, issue in self.issues_of(kind).items()}
            for key, (kind, field) in _FORMER_ISSUES.items()
        }
        lenses = self.issues_of("lens-undetermined").items()
        former["unsure_lenses"] = {camera: {"focal": lens.focal, "border_px": lens.border_px} for camera, lens in lenses}
        return {**write(self), **former}


@dataclass(frozen=True)
class DepthSummary(Summary):
    """The depth map of one view (`stages.types.DepthMap`)."""

    offset_px: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FuseSummary(Summary):
    """A point cloud."""

    points: Annotated[int, _read_from("points_count")] = 0
    bounds: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    """Two opposite corners of its bounding box."""
    sample_counts: Mapping[str, int] = field(default_factory=dict)
    """Number of samples that each camera contributed."""
    misfits: Mapping[str, float] = field(default_factory=dict)
    """By camera: median ratio of the samples' standard deviation to the expected one."""
    correct_share: float | None = None
    """Share of the points that is expected to be right."""


@dataclass(frozen=True)
class SiteSummary(Summary):
    """Summary of a site-wide stage that has a section in run.json and in the report, under its name."""

    AMOUNT: ClassVar[tuple[str, str]] = ("", "")
    """Unit and meaning of `amount`, if there is one; `expect` in the site file limits it under the name of the stage."""

    files: tuple[str, ...] = ()
    """Names of the published files."""
    reason: str | None = None
    """Why there is no result."""

    @property
    def amount(self) -> float | None:
        """The quantity that is compared with its usual value."""
        return None

    @property
    def objects(self) -> Mapping[str, Change]:
        """Things with a place, by name."""
        return {}

    @property
    def volumes(self) -> Mapping[str, CutFill]:
        """Volumes gained and lost, by zone."""
        return {}


@dataclass(frozen=True)
class CoverageSummary(SiteSummary):
    """How much of the ground the cameras see."""

    AMOUNT = ("m²", "seen by two cameras")

    area_m2: Annotated[float | None, _read_from("area", "area_m2")] = None
    seen_by_one: float | None = None
    seen_by_two: float | None = None
    angle_deg: Annotated[float | None, _read_from("median_angle_deg", "angle_deg")] = None
    error_m: Annotated[float | None, _read_from("median_error", "error_m")] = None
    lost_without: Mapping[str, float] | None = None

    @property
    def amount(self) -> float | None:
        return None if self.area_m2 is None or self.seen_by_two is None else self.area_m2 * self.seen_by_two


_SAME_PLACE_SHARE = 0.5
"""Two changes of one kind are the same thing if their centres are nearer than this share of the larger one's length."""


@dataclass(frozen=True)
class Change(Summary):
    """One thing that has appeared, vanished or moved (`stages.types.Change`)."""

    kind: str = ""
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    length: float | None = None
    width: float | None = None
    height: float | None = None
    area: float | None = None
    volume: float | None = None
    volume_sigma: float | None = None
    significance: float | None = None
    likeness: float | None = None
    points: int | None = None
    cameras: str = ""
    zone: str = ""
    from_x: float | None = None
    from_y: float | None = None
    from_z: float | None = None
    acknowledged: str = ""
    """Who has acknowledged the change, until when, and why; "" if it is not acknowledged."""

    @model_serializer(mode="wrap")
    def _without_empty(self, write: Any) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value or name != "acknowledged"}

    def is_same(self, other: Change) -> bool:
        """Is it the same thing on another night, compared with the same reference?"""
        distance = math.dist((self.x, self.y, self.z), (other.x, other.y, other.z))
        return self.kind == other.kind and distance <= _SAME_PLACE_SHARE * max(self.length or 0.0, other.length or 0.0)


@dataclass(frozen=True)
class CutFill(Summary):
    """Volumes that changes have gained and lost on a part of the ground (`stages.types.CutFill`)."""

    gained: float = 0.0
    gained_sigma: float = 0.0
    lost: float = 0.0
    lost_sigma: float = 0.0
    level: float = 0.0
    common_sigma: float = 0.0
    area: float = 0.0
    unseen: float = 0.0


@dataclass(frozen=True)
class ChangesSummary(SiteSummary):
    """The changes since the night of the reference."""

    compared: bool | None = None
    count: int | None = None
    changed_share: float | None = None
    unknown_share: float | None = None
    noise: float | None = None
    cut_fill: CutFill | None = None
    zones: Mapping[str, CutFill] = field(default_factory=dict)
    changes: Mapping[str, Change] | None = None

    @property
    def objects(self) -> Mapping[str, Change]:
        return self.changes or {}

    @property
    def volumes(self) -> Mapping[str, CutFill]:
        """Volumes by zone; "" is the whole site, or all zones together."""
        return {"": self.cut_fill, **self.zones} if self.cut_fill else {}

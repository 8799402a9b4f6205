"""What the engine reads of results: a typed summary beside each stage, and what run.json has of it.

A receipt keeps the plain fields of a result; a summary is built from those that somebody reads.  What is missing, as in a receipt
of another version, is None or empty.
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
    """Fields of a result that somebody reads; each has a default."""

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, data: Any, read: Any) -> Self:
        try:
            made: Self = read(data)
        except ValidationError:  # of another version, or of a function that is not ours
            return cls()
        return made


def _named(*names: str) -> Any:
    """The names of a field in a result, the first that is there, and in run.json."""
    return Field(validation_alias=AliasChoices(*names))


@dataclass(frozen=True)
class Notes(Summary):
    """Of any stage of a camera."""

    notes: tuple[str, ...] = ()
    """What the operator should know."""


@dataclass(frozen=True)
class FrameSummary(Summary):
    """How the clean picture of a camera is (`stages.types.Frame`)."""

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

    keypoints: Annotated[int | None, _named("xy_count", "keypoints")] = None


@dataclass(frozen=True)
class CameraFigures(FeaturesSummary, FrameSummary):
    """What run.json has of a camera: the summaries of its stages, and its part in those of the site."""

    pose: Mapping[str, Any] | None = None
    """How the pictures agree with its known pose (`stages.types.PoseCheck`)."""
    verified: bool | None = None
    pose_from: str | None = None
    """stated, refined, corrected or solved."""
    points: int | None = None
    misfit: float | None = None
    apart_px: Mapping[str, float] | None = None
    """For each two partners whose pairs make it dense: by how many pixels their depths differ as a whole."""


@dataclass(frozen=True)
class HealthSummary(Health, Summary):
    """How a camera is, compared with the reference (`stages.types.CameraHealth`)."""

    state: HealthState = "ok"
    corrected: bool = False
    """It has shifted, and its pose is known from the reference."""


@dataclass(frozen=True)
class PairsSummary(Summary):
    """The pair graph, or the dense pairs."""

    pairs: tuple[tuple[str, str], ...] = ()
    crowded: Mapping[str, str] = field(default_factory=dict)
    """Notes by camera."""


@dataclass(frozen=True)
class MatchesSummary(Summary):
    """Matches of a pair."""

    matches: Annotated[int | None, _named("x1_count", "matches")] = None


@dataclass(frozen=True)
class GeometrySummary(Summary):
    """The epipolar geometry of a pair; of a rejected one what was found too little."""

    inliers: Annotated[int | None, _named("x1_count", "inliers")] = None
    angle_deg: float | None = None
    epipolar_px: float | None = None
    probability: Annotated[float | None, _named("good_probability", "probability")] = None


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
    """What run.json has of a pair: the summaries of its stages, and its part in that of the poses."""

    poses_px: float | None = None
    known: str | None = None


@dataclass(frozen=True)
class PairCheck(Summary):
    """What the cameras of a whole site say of one pair (`stages.types.PairCheck`)."""

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
    focal: float | None = None
    border_px: float | None = None


_ROWS_AGREE, _LOOK_ALIKES = 3.5, 3.0
"""Rows want a change of the cameras by no more standard deviations (140 unharmed nights: 3.2 at most); misfits by which
look-alikes contradict right cameras (a workshop: 1.9 to 2.8; wrong poses there 3.2 and more)."""

_FORMER_ISSUES = {
    "suspects": ("moved", "text"),
    "doubtful": ("unverified", "text"),
    "uncertain": ("uncertain", "row_px"),
    "strained": ("inconsistent", "strain"),
}
"""By key that run.json had before 0.2: kind and field of an issue."""


@dataclass(frozen=True)
class PosesSummary(Summary):
    """How the cameras came to stand where they do (`stages.types.Poses`); the cameras themselves are in cameras.json."""

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
    """What would join the worlds that share no pair."""
    scale: str = ""
    crs: str = ""
    """Coordinate system of the world as PROJ reads it; "" for a local one."""
    notes: tuple[str, ...] = ()
    """What the operator should know."""
    points: int = 0
    reprojection_px: float | None = None
    calibration: CalibrationCheck | None = None
    rows: CalibrationCheck | None = None
    """The same by what dense matching finds beside the rows of pairs (stage `calibration`)."""
    pair_checks: Annotated[Mapping[str, PairCheck], Field(exclude=True)] = field(default_factory=dict)
    """This and the next two stand with the pairs and cameras in run.json."""
    pose_checks: Annotated[Mapping[str, Mapping[str, Any]], Field(exclude=True)] = field(default_factory=dict)
    sources: Annotated[Mapping[str, str], Field(exclude=True)] = field(default_factory=dict)

    @property
    def unverified(self) -> bool:
        """Are lenses and poses stated, and were there too few matches to check them?"""
        told = self.calibration is not None or (self.rows is not None and self.rows.pairs > 0)
        return self.source in {"calibration", "mixed"} and not told

    @property
    def rows_agree(self) -> bool:
        """Does dense matching find what it should on the rows of the stated cameras?"""
        return self.rows is not None and self.rows.pairs > 0 and self.rows.sigmas <= _ROWS_AGREE

    @property
    def contradiction(self) -> CalibrationCheck | None:
        """What contradicts the stated calibration: a little, and without a simple cause, look-alikes do where the rows agree."""
        by_keypoints, by_rows = (check if check and check.contradicted else None for check in (self.calibration, self.rows))
        if by_keypoints and self.rows_agree and not by_keypoints.cause and by_keypoints.misfit < _LOOK_ALIKES:
            return None
        return by_keypoints or by_rows

    def issues_of(self, kind: str) -> dict[str, PoseIssue]:
        """Return the issues of one kind by camera."""
        return {issue.camera: issue for issue in self.issues if issue.kind == kind}

    @model_serializer(mode="wrap")
    def _with_former_keys(self, write: Any) -> dict[str, Any]:
        """Add the issues as versions before 0.2 wrote them, for one more version."""
        former: dict[str, dict[str, Any]] = {
            key: {camera: getattr(issue, field) for camera, issue in self.issues_of(kind).items()}
            for key, (kind, field) in _FORMER_ISSUES.items()
        }
        lenses = self.issues_of("lens-undetermined").items()
        former["unsure_lenses"] = {camera: {"focal": lens.focal, "border_px": lens.border_px} for camera, lens in lenses}
        return {**write(self), **former}


@dataclass(frozen=True)
class DepthSummary(Summary):
    """Depth of one view (`stages.types.DepthMap`)."""

    apart_px: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FuseSummary(Summary):
    """A cloud."""

    points: Annotated[int, _named("points_count")] = 0
    bounds: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    """Two opposite corners of the box around it."""
    given: Mapping[str, int] = field(default_factory=dict)
    """Samples by camera."""
    misfits: Mapping[str, float] = field(default_factory=dict)
    """Of each camera's samples: their standard deviation over the expected one, median."""
    right: float | None = None
    """Share of the points that is expected to be right."""


@dataclass(frozen=True)
class SiteSummary(Summary):
    """Of a site-wide stage that has a part of run.json and of the report, under its name."""

    AMOUNT: ClassVar[tuple[str, str]] = ("", "")
    """Unit and meaning of `amount`, where there is one; `expect` in the site file has it under the name of the stage."""

    files: tuple[str, ...] = ()
    """Names of what was published."""
    reason: str | None = None
    """Why there is no result."""

    @property
    def amount(self) -> float | None:
        """What should be as much as is usual."""
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
    """What the cameras see of the ground."""

    AMOUNT = ("m²", "seen by two cameras")

    area_m2: Annotated[float | None, _named("area", "area_m2")] = None
    seen_by_one: float | None = None
    seen_by_two: float | None = None
    angle_deg: Annotated[float | None, _named("median_angle_deg", "angle_deg")] = None
    error_m: Annotated[float | None, _named("median_error", "error_m")] = None
    lost_without: Mapping[str, float] | None = None

    @property
    def amount(self) -> float | None:
        return None if self.area_m2 is None or self.seen_by_two is None else self.area_m2 * self.seen_by_two


_SAME_PLACE = 0.5
"""Two things of one kind are the same where their middles are nearer than this share of the larger one's length."""


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
    """Who knows of it, until when, and why; "" where nobody does."""

    @model_serializer(mode="wrap")
    def _named_where_known(self, write: Any) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value or name != "acknowledged"}

    def is_same(self, other: Change) -> bool:
        """Is it the same thing on another night, compared with the same reference?"""
        apart = math.dist((self.x, self.y, self.z), (other.x, other.y, other.z))
        return self.kind == other.kind and apart <= _SAME_PLACE * max(self.length or 0.0, other.length or 0.0)


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
    """What is not as it was when the reference was made."""

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
        """By zone; "" is the whole site, or all zones together."""
        return {"": self.cut_fill, **self.zones} if self.cut_fill else {}

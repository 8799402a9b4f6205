"""run.json as dataclasses.  Its keys are a stable interface: existing keys stay, and keys of later versions are ignored."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Self

from pydantic import Field, PlainSerializer

from wbflow_stages.contracts.camera_figures import Health
from wbflow_stages.contracts.ground_figures import CloudSize

from ..json_dataclass import FlatJsonDataclass, JsonDataclass
from ..pipeline.stages import CHANGES, STAGES
from ..pipeline.summaries import CameraFigures, ChangesSummary, PairFigures, PosesSummary, RecordedChange, SiteSummary
from ..task import camera_of
from .findings import Baseline, Down, Verdict

_STAMP = "%Y-%m-%dT%H:%M:%SZ"


def stamp(at: datetime.datetime) -> str:
    """Return a time (UTC) in the format of run.json."""
    return at.strftime(_STAMP)


def moment(text: str) -> datetime.datetime:
    """Parse a time (UTC) from run.json.  Raises ValueError."""
    return datetime.datetime.strptime(text, _STAMP).replace(tzinfo=datetime.UTC)


Time = Annotated[float, PlainSerializer(lambda seconds: round(seconds, 2))]
"""Seconds, written with two decimals."""


@dataclass(frozen=True)
class TaskCounts(JsonDataclass):
    """Number of tasks by outcome."""

    cached: int = 0
    ran: int = 0
    rejected: int = 0
    failed: int = 0
    skipped: int = 0


@dataclass(frozen=True)
class StageSeconds(JsonDataclass):
    """Total time of the tasks of one stage that ran, and their number."""

    wall: Time
    cpu: Time
    tasks: int


@dataclass(frozen=True)
class Seconds(JsonDataclass):
    """Time that a run took, as a whole and by stage."""

    wall: Time
    cpu: Time
    stages: Mapping[str, StageSeconds] = field(default_factory=dict)


@dataclass(frozen=True)
class CameraRecord(FlatJsonDataclass):
    """The outcome of one camera."""

    id: str
    outcome: str
    """ok, failed, rejected, skipped or unsolved."""
    reason: str | None = None
    code: str | None = None
    notes: tuple[str, ...] = ()
    """Remarks for the operator."""
    captures: Mapping[str, str] = field(default_factory=dict)
    """Digests of the captures that were used, by file name."""
    captures_in_motion: tuple[str, ...] = ()
    """Names of captures that changed during the run although they should not have."""
    figures: CameraFigures = field(default_factory=CameraFigures)
    """Figures that the stages report about the camera."""
    health: Health | None = None
    """The camera's condition compared with earlier nights; None if unknown."""
    down: Down | None = None
    """Since when the camera has given no results or had a fault; None while it is well."""

    @property
    def ok(self) -> bool:
        """Was the camera used?"""
        return self.outcome == "ok"

    def __repr__(self) -> str:
        reason = f": {self.reason}" if self.reason else ""
        return f"CameraRecord({self.id!r}, {self.outcome}{reason})"


@dataclass(frozen=True)
class PairRecord(FlatJsonDataclass):
    """The outcome of one pair of cameras, or of one pair of views."""

    left: str
    right: str
    outcome: str
    """ok, failed, rejected or skipped."""
    reason: str | None = None
    code: str | None = None
    stage: str | None = None
    """The stage that gave no result, if any."""
    matched: bool | None = None
    """Did its matches give a geometry (F)?  None if that stage has no task for the pair."""
    dense: bool | None = None
    """Is it one of the pairs for dense matching?  None if these are not chosen separately."""
    figures: PairFigures = field(default_factory=PairFigures)
    """Figures that the stages report about the pair."""

    @property
    def cameras(self) -> tuple[str, str]:
        """The cameras of the two views."""
        return camera_of(self.left), camera_of(self.right)

    @property
    def name(self) -> str:
        """The pair's name, as it is written everywhere: left--right."""
        return f"{self.left}--{self.right}"

    @property
    def ok(self) -> bool:
        """Did dense matching give a result, or every other stage if the run had no dense matching for this pair?"""
        return self.outcome == "ok"

    def __repr__(self) -> str:
        reason = f": {self.reason}" if self.reason else ""
        return f"PairRecord({self.name!r}, {self.outcome}{reason})"


NO_SCALE = "lengths are arbitrary"
"""What is said of a cloud whose lengths are not metres."""
STATE_SCALE = "state one measured distance between two cameras in metres, `distances: [[LEFT, RIGHT, 12.3]]`, or their positions"
"""How a cloud gets metres."""


@dataclass(frozen=True)
class CloudRecord(CloudSize, JsonDataclass):
    """A cloud of a run."""

    path: str = field(kw_only=True)
    """File of the cloud, relative to the run's folder."""
    metric: bool = field(default=True, kw_only=True)
    """Are lengths known to be metres?"""


@dataclass(frozen=True)
class RunRecord(JsonDataclass):
    """The content of run.json: one run."""

    run: str
    site: str
    version: str
    date: str
    """The night of the captures, ISO 8601."""
    started: str
    finished: str
    exit_code: int
    tasks: TaskCounts
    seconds: Seconds
    peak_rss_mb: int
    """Largest peak memory of a worker, without shared memory, in MB of 2^20 bytes."""
    cameras: tuple[CameraRecord, ...]
    pairs: tuple[PairRecord, ...]
    cloud: CloudRecord | None = None
    other_clouds: tuple[CloudRecord, ...] = ()
    """Clouds of components whose cameras are not connected to the main ones."""
    poses: PosesSummary | None = None
    reason: str | None = None
    """Why there is no cloud."""
    code: str | None = None
    verdict: Verdict | None = None
    """The verdict on the night; None in runs of earlier versions."""
    usual: Baseline | None = None
    """The usual figures that the night was compared with; None if there were none."""
    settings: str = ""
    """Digest of the site file's settings and the stages' code: usual figures come only from nights with the same digest."""
    repaired: tuple[str, ...] = ()
    """Damage on disk that the run found and repaired, in words."""
    files: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the products in its folder, by name."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Versions of Python and of the stages' libraries, by name; empty in runs of earlier versions."""
    reference: str | None = None
    """Id of the reference's run, if the run was compared with a reference (see `records.reference`)."""
    recovered: tuple[str, ...] = ()
    """Kind and subject of the findings that the night before had and this good one has no more ("camera-lost roof")."""
    dated: bool = True
    """Do the names of the captures tell their night?  If not, each run is of the newest pictures, whatever their date."""
    results: Annotated[Mapping[str, SiteSummary], Field(exclude=True)] = field(default_factory=dict)
    """Summaries of site-wide stages, by stage; in run.json each one is a top-level entry under its stage's name."""

    @property
    def unscaled(self) -> bool:
        """Is there a cloud whose lengths are not metres?"""
        return self.cloud is not None and not self.cloud.metric

    @property
    def compared(self) -> ChangesSummary | None:
        """What has changed since the reference; None if the night was compared with none."""
        result = self.results.get(CHANGES)
        return result if isinstance(result, ChangesSummary) and result.compared else None

    @property
    def changes(self) -> Mapping[str, RecordedChange]:
        """What has changed since the reference, by id."""
        return self.compared.objects if self.compared else {}

    @property
    def unit(self) -> str:
        """The unit of lengths: m, or "" if the scale is unknown."""
        return "m" if self.poses is None or self.poses.metric else ""

    def pairs_of(self, camera: str) -> list[PairRecord]:
        """Return the pairs that a camera is part of."""
        return self._pairs_of.get(camera, [])

    @cached_property
    def stated(self) -> frozenset[str]:
        """The cameras whose poses are stated, or known from observations."""
        return frozenset(camera.id for camera in self.cameras if camera.figures.pose_from in {"stated", "observed"})

    @cached_property
    def _pairs_of(self) -> dict[str, list[PairRecord]]:
        by_camera: dict[str, list[PairRecord]] = {}
        for pair in self.pairs:
            for camera in pair.cameras:
                by_camera.setdefault(camera, []).append(pair)
        return by_camera

    def __repr__(self) -> str:
        points = f"{self.cloud.points:,} points" if self.cloud else f"no cloud ({self.reason or 'not requested'})"
        return f"RunRecord({self.run!r}, site {self.site!r}, exit {self.exit_code}, {points})"

    def to_json(self) -> dict[str, Any]:
        return super().to_json() | {stage: result.to_json() for stage, result in self.results.items()}

    @classmethod
    def from_json(cls, data: Any) -> Self:
        results = {}
        for stage in STAGES:
            entry = data.get(stage.name)
            if stage.summary and issubclass(stage.summary, SiteSummary) and isinstance(entry, Mapping):
                results[stage.name] = stage.summary.from_json(entry)
        return super().from_json({**data, "results": results})

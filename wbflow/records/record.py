"""run.json as dataclasses.  Its keys are a contract: those that exist stay; what a later version adds is ignored."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Self

from pydantic import Field, PlainSerializer

from ..json_dataclass import FlatJsonDataclass, JsonDataclass
from ..pipeline.stages import STAGES
from ..pipeline.summaries import CameraFigures, PairFigures, PosesSummary, SiteSummary
from ..task import camera_of
from .findings import Down, Health, Usual, Verdict

_STAMP = "%Y-%m-%dT%H:%M:%SZ"


def stamp(at: datetime.datetime) -> str:
    """A time as run.json writes it (UTC)."""
    return at.strftime(_STAMP)


def moment(text: str) -> datetime.datetime:
    """A time that run.json has (UTC).  Raises ValueError."""
    return datetime.datetime.strptime(text, _STAMP).replace(tzinfo=datetime.UTC)


Time = Annotated[float, PlainSerializer(lambda seconds: round(seconds, 2))]
"""Seconds."""


@dataclass(frozen=True)
class TaskCounts(JsonDataclass):
    """How many tasks ended how."""

    cached: int = 0
    ran: int = 0
    rejected: int = 0
    failed: int = 0
    skipped: int = 0


@dataclass(frozen=True)
class StageSeconds(JsonDataclass):
    """What the tasks of one stage that ran have cost together."""

    wall: Time
    cpu: Time
    tasks: int


@dataclass(frozen=True)
class Seconds(JsonDataclass):
    """What a run has cost."""

    wall: Time
    cpu: Time
    stages: Mapping[str, StageSeconds] = field(default_factory=dict)


@dataclass(frozen=True)
class CameraRecord(FlatJsonDataclass):
    """What became of one camera."""

    id: str
    outcome: str
    """ok, failed, rejected, skipped or unsolved."""
    reason: str | None = None
    code: str | None = None
    notes: tuple[str, ...] = ()
    """What the operator should know of it."""
    captures: Mapping[str, str] = field(default_factory=dict)
    """Digests of the files that were used, by name."""
    captures_in_motion: tuple[str, ...] = ()
    """Those that changed during the run."""
    figures: CameraFigures = field(default_factory=CameraFigures)
    """What the stages report of it."""
    health: Health | None = None
    """How it is, compared with what it has been; None where nobody knows."""
    down: Down | None = None
    """Since when it gives nothing or is not as it should be; None while all is well."""

    @property
    def ok(self) -> bool:
        """Did it do its part?"""
        return self.outcome == "ok"

    def __repr__(self) -> str:
        return f"CameraRecord({self.id!r}, {self.outcome}{f': {self.reason}' if self.reason else ''})"


@dataclass(frozen=True)
class PairRecord(FlatJsonDataclass):
    """What became of one pair of cameras, or of their views."""

    left: str
    right: str
    outcome: str
    """ok, failed, rejected or skipped."""
    reason: str | None = None
    code: str | None = None
    stage: str | None = None
    """The stage that gave nothing, where one did."""
    matched: bool | None = None
    """Has it a geometry of its own?"""
    dense: bool | None = None
    """Is it among the pairs that are made dense, where these are chosen apart?"""
    figures: PairFigures = field(default_factory=PairFigures)
    """What the stages report of it."""

    @property
    def cameras(self) -> tuple[str, str]:
        """The cameras whose views these are."""
        return camera_of(self.left), camera_of(self.right)

    @property
    def name(self) -> str:
        """As it is written everywhere: left--right."""
        return f"{self.left}--{self.right}"

    @property
    def ok(self) -> bool:
        """Has it been matched densely, as far as was wanted?"""
        return self.outcome == "ok"

    def __repr__(self) -> str:
        return f"PairRecord({self.name!r}, {self.outcome}{f': {self.reason}' if self.reason else ''})"


@dataclass(frozen=True)
class CloudRecord(JsonDataclass):
    """A cloud of a run."""

    path: str
    """Its file, relative to the run's folder."""
    points: int
    bounds: tuple[tuple[float, ...], tuple[float, ...]]
    """Two opposite corners of the box around it."""
    right: float | None = None
    """Share of its points that is expected to be right."""


@dataclass(frozen=True)
class RunRecord(JsonDataclass):
    """A run: run.json."""

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
    """What the fullest worker held for itself, without what it shares; MB of 2^20 bytes."""
    cameras: tuple[CameraRecord, ...]
    pairs: tuple[PairRecord, ...]
    cloud: CloudRecord | None = None
    other_clouds: tuple[CloudRecord, ...] = ()
    """Of cameras that share no world with the main ones."""
    poses: PosesSummary | None = None
    reason: str | None = None
    """Why there is no cloud."""
    code: str | None = None
    verdict: Verdict | None = None
    """What the night came to; None of a run of an earlier version."""
    usual: Usual | None = None
    """What it was compared with; None where there was nothing."""
    settings: str = ""
    """Digest of all that the site file and the version decide: only nights with the same are compared."""
    repaired: tuple[str, ...] = ()
    """Damage on disk that the run found and put right, in words."""
    files: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the products in its folder, by name."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Of Python and of the libraries behind the stages, by name; empty of a run of an earlier version."""
    reference: str | None = None
    """Id of the run that it was compared with, if any (see `records.reference_folder`)."""
    results: Annotated[Mapping[str, SiteSummary], Field(exclude=True)] = field(default_factory=dict)
    """What site-wide stages report, by stage; in run.json each stands under its own name."""

    def pairs_of(self, camera: str) -> list[PairRecord]:
        """The pairs that a camera is one of."""
        return self._pairs_of.get(camera, [])

    @cached_property
    def _pairs_of(self) -> dict[str, list[PairRecord]]:
        found: dict[str, list[PairRecord]] = {}
        for pair in self.pairs:
            for camera in pair.cameras:
                found.setdefault(camera, []).append(pair)
        return found

    def __repr__(self) -> str:
        points = f"{self.cloud.points:,} points" if self.cloud else f"no cloud ({self.reason or 'not asked for'})"
        return f"RunRecord({self.run!r}, site {self.site!r}, exit {self.exit_code}, {points})"

    def to_json(self) -> dict[str, Any]:
        return super().to_json() | {stage: result.to_json() for stage, result in self.results.items()}

    @classmethod
    def from_json(cls, data: Any) -> Self:
        made = {s.name: s.summary.from_json(data[s.name]) for s in STAGES if s.summary and isinstance(data.get(s.name), Mapping)}
        results = {stage: result for stage, result in made.items() if isinstance(result, SiteSummary)}
        return super().from_json({**data, "results": results})

"""run.json as dataclasses.  Its keys are a contract: those that exist stay; what a later version adds is carried along unread."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from ..task import camera_of
from .findings import Down as Down
from .findings import Figures as Figures
from .findings import Finding as Finding
from .findings import Health as Health
from .findings import Usual as Usual
from .findings import Verdict as Verdict
from .findings import rounded

_STAMP = "%Y-%m-%dT%H:%M:%SZ"


def stamp(at: datetime.datetime) -> str:
    """A time as run.json writes it (UTC)."""
    return at.strftime(_STAMP)


def moment(text: str) -> datetime.datetime:
    """A time that run.json has (UTC).  Raises ValueError."""
    if len(text) != len("2026-11-22T03:15:00Z") or text[10] + text[-1] != "TZ":
        raise ValueError(f"{text!r} is no time of a run")
    return datetime.datetime.fromisoformat(text)


@dataclass(frozen=True)
class TaskCounts:
    """How many tasks ended how."""

    cached: int = 0
    ran: int = 0
    rejected: int = 0
    failed: int = 0
    skipped: int = 0

    def to_json(self) -> dict[str, int]:
        return dict(vars(self))


@dataclass(frozen=True)
class StageSeconds:
    """What the tasks of one stage that ran have cost together."""

    wall: float
    cpu: float
    tasks: int

    def to_json(self) -> dict[str, float]:
        return {"wall": round(self.wall, 2), "cpu": round(self.cpu, 2), "tasks": self.tasks}


@dataclass(frozen=True)
class Seconds:
    """What a run has cost."""

    wall: float
    cpu: float
    stages: Mapping[str, StageSeconds] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        stages = {name: row.to_json() for name, row in self.stages.items()}
        return {"wall": round(self.wall, 2), "cpu": round(self.cpu, 2), "stages": stages}


@dataclass(frozen=True)
class CameraRecord:
    """What became of one camera."""

    id: str
    outcome: str
    """ok, failed, rejected, skipped or unsolved."""
    reason: str | None = None
    code: str | None = None
    notes: tuple[str, ...] = ()
    """What the operator should know of it."""
    figures: Figures = field(default_factory=dict)
    """What the stages report of it; None where they did not come so far."""
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

    def to_json(self) -> dict[str, Any]:
        reason = {"reason": self.reason, "code": self.code, "notes": list(self.notes)}
        state = {"health": self.health and self.health.to_json(), "down": self.down and self.down.to_json()}
        return {"id": self.id, "outcome": self.outcome, **rounded(self.figures), **reason, **state}


@dataclass(frozen=True)
class PairRecord:
    """What became of one pair of cameras, or of their views."""

    left: str
    right: str
    outcome: str
    """ok, failed, rejected or skipped."""
    reason: str | None = None
    code: str | None = None
    stage: str | None = None
    """The stage that gave nothing, where one did."""
    figures: Figures = field(default_factory=dict)
    """What the stages report of it; None where they did not come so far."""

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
        """Has it been matched densely, as far as was asked for?"""
        return self.outcome == "ok"

    def __repr__(self) -> str:
        return f"PairRecord({self.name!r}, {self.outcome}{f': {self.reason}' if self.reason else ''})"

    def to_json(self) -> dict[str, Any]:
        head = {"left": self.left, "right": self.right, "outcome": self.outcome}
        stage = {"stage": self.stage} if self.stage else {}
        return {**head, **rounded(self.figures), "reason": self.reason, "code": self.code, **stage}


@dataclass(frozen=True)
class CloudRecord:
    """A cloud of a run."""

    path: str
    """Its file, relative to the run's folder."""
    points: int
    bounds: tuple[tuple[float, ...], tuple[float, ...]]
    """Two opposite corners of the box around it."""

    def to_json(self) -> dict[str, Any]:
        return {"path": self.path, "points": self.points, "bounds": self.bounds}


@dataclass(frozen=True)
class WorldRecord:
    """How the cameras came to stand where they do (the cameras themselves are in cameras.json)."""

    figures: Figures

    @property
    def metric(self) -> bool:
        """Are lengths metres?"""
        return bool(self.figures.get("metric", True))

    @property
    def crs(self) -> str:
        """Coordinate system of the world as PROJ reads it; "" for a local one."""
        return str(self.figures.get("crs") or "")

    @property
    def suspects(self) -> Mapping[str, str]:
        """Cameras that the images say have changed, and how."""
        suspects: Mapping[str, str] = self.figures.get("suspects") or {}
        return suspects

    @property
    def doubtful(self) -> Mapping[str, str]:
        """Cameras in use whose known poses are likely to be wrong, and what says so."""
        doubtful: Mapping[str, str] = self.figures.get("doubtful") or {}
        return doubtful

    @property
    def uncertain(self) -> Mapping[str, float]:
        """Cameras whose known poses tonight's pictures tell no better, though that would be needed; pixels by which rows may be
        off."""
        uncertain: Mapping[str, float] = self.figures.get("uncertain") or {}
        return uncertain

    @property
    def unsure_lenses(self) -> Mapping[str, Mapping[str, float]]:
        """Cameras whose lens was solved, though the pictures don't tell it well enough; standard deviations."""
        unsure: Mapping[str, Mapping[str, float]] = self.figures.get("unsure_lenses") or {}
        return unsure

    @property
    def strained(self) -> Mapping[str, float]:
        """Solved cameras that matches of look-alikes have a say in, and how much of one (see `stages.types.Poses`)."""
        strained: Mapping[str, float] = self.figures.get("strained") or {}
        return strained

    @property
    def calibration(self) -> Figures:
        """How the stated calibration as a whole agrees with the matches (`stages.types.CalibrationCheck`); {} where nothing can
        tell."""
        return self.figures.get("calibration") or {}

    @property
    def joins(self) -> tuple[str, ...]:
        """What would join the worlds that share no pair."""
        return tuple(self.figures.get("joins") or ())

    @property
    def notes(self) -> tuple[str, ...]:
        """What the operator should know."""
        return tuple(self.figures.get("notes") or ())

    def to_json(self) -> dict[str, Any]:
        data: dict[str, Any] = rounded(self.figures)
        return data


@dataclass(frozen=True)
class RunRecord:
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
    poses: WorldRecord | None = None
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
    later: Figures = field(default_factory=dict)
    """What site-wide stages report, by stage; and keys of a later version."""

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
        return {
            "run": self.run,
            "site": self.site,
            "version": self.version,
            "date": self.date,
            "started": self.started,
            "finished": self.finished,
            "exit_code": int(self.exit_code),
            "tasks": self.tasks.to_json(),
            "seconds": self.seconds.to_json(),
            "peak_rss_mb": self.peak_rss_mb,
            "cameras": [camera.to_json() for camera in self.cameras],
            "pairs": [pair.to_json() for pair in self.pairs],
            "cloud": self.cloud and self.cloud.to_json(),
            "other_clouds": [cloud.to_json() for cloud in self.other_clouds],
            "poses": self.poses and self.poses.to_json(),
            "reason": self.reason,
            "code": self.code,
            "verdict": self.verdict and self.verdict.to_json(),
            "usual": self.usual and self.usual.to_json(),
            "settings": self.settings,
            "repaired": list(self.repaired),
            "files": dict(self.files),
            "versions": dict(self.versions),
            "reference": self.reference,
            **rounded(self.later),
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> RunRecord:
        """Raises KeyError, TypeError or ValueError for what is no run.json."""
        rest = dict(data)
        plain = {name: rest.pop(name) for name in ("run", "site", "version", "date", "started", "finished", "exit_code")}
        tasks = TaskCounts(**{name: int(rest["tasks"].get(name, 0)) for name in vars(TaskCounts())})
        seconds = _seconds(rest["seconds"])
        cameras = tuple(map(_camera, rest["cameras"]))
        pairs = tuple(map(_pair, rest["pairs"]))
        poses = WorldRecord(rest["poses"]) if rest.get("poses") else None
        others = tuple(cloud for entry in rest.get("other_clouds", ()) if (cloud := _cloud(entry)))
        peak, reason, code = rest.get("peak_rss_mb", 0), rest.get("reason"), rest.get("code")
        verdict = Verdict.from_json(rest["verdict"]) if rest.get("verdict") else None
        known = {"tasks", "seconds", "cameras", "pairs", "poses", "cloud", "other_clouds", "peak_rss_mb"}
        usual = Usual.from_json(rest["usual"]) if rest.get("usual") else None
        known |= {"reason", "code", "verdict", "usual", "settings", "repaired", "files", "reference", "versions"}
        later = {name: value for name, value in rest.items() if name not in known}
        return RunRecord(
            **plain,
            tasks=tasks,
            seconds=seconds,
            peak_rss_mb=peak,
            cameras=cameras,
            pairs=pairs,
            cloud=_cloud(rest.get("cloud")),
            other_clouds=others,
            poses=poses,
            reason=reason,
            code=code,
            verdict=verdict,
            usual=usual,
            settings=str(rest.get("settings") or ""),
            repaired=tuple(rest.get("repaired") or ()),
            files=dict(rest.get("files") or {}),
            versions=dict(rest.get("versions") or {}),
            reference=rest.get("reference"),
            later=later,
        )


def _seconds(data: Mapping[str, Any]) -> Seconds:
    stages = {name: StageSeconds(row["wall"], row["cpu"], row["tasks"]) for name, row in data.get("stages", {}).items()}
    return Seconds(data["wall"], data["cpu"], stages)


def _camera(data: Mapping[str, Any]) -> CameraRecord:
    named = ("id", "outcome", "reason", "code", "notes", "health", "down")
    figures = {name: value for name, value in data.items() if name not in named}
    notes = tuple(data.get("notes") or ())
    health = Health.from_json(data["health"]) if data.get("health") else None
    down = Down.from_json(data["down"]) if data.get("down") else None
    return CameraRecord(data["id"], data["outcome"], data.get("reason"), data.get("code"), notes, figures, health, down)


def _pair(data: Mapping[str, Any]) -> PairRecord:
    named = ("left", "right", "outcome", "reason", "code", "stage")
    figures = {name: value for name, value in data.items() if name not in named}
    optional = {name: data.get(name) for name in ("reason", "code", "stage")}
    return PairRecord(data["left"], data["right"], data["outcome"], **optional, figures=figures)


def _cloud(data: Mapping[str, Any] | None) -> CloudRecord | None:
    if not data:
        return None
    low, high = data["bounds"]
    return CloudRecord(data["path"], data["points"], (tuple(low), tuple(high)))

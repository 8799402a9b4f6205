"""The summary of a run: what the page of its site shows of it.

The ledger keeps it, so that a page over hundreds of nights reads no run.json, and knows nights whose folders are gone.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from wbflow_stages.contracts.ground_figures import CutFill

from ..cache.layout import started_by
from ..json_dataclass import JsonDataclass
from ..pipeline.meanings import BOOKKEEPING
from ..pipeline.summaries import RecordedChange
from .findings import Finding
from .record import RunRecord

MOST_FINDINGS = 5
"""Largest number of findings whose texts are kept; the report of the run has all."""


@dataclass(frozen=True)
class FindingSummary(JsonDataclass):
    """What a finding says."""

    text: str
    remedy: str = ""


@dataclass(frozen=True)
class ChangeSummary(JsonDataclass):
    """What a change of one night is, and where."""

    id: str
    kind: str
    zone: str
    size: tuple[float, float, float]
    """Length, width and height."""
    place: tuple[float, float, float]
    """x, y, z of its centre."""
    volume: float
    volume_sigma: float
    volume_least: float
    volume_most: float
    seen: bool
    first: str
    last: str
    """The first night on which it was seen, and the newest one."""
    acknowledged: str
    picture: str
    """File in the run's folder that shows it on both nights; "" if there is none."""


@dataclass(frozen=True)
class RunSummary(JsonDataclass):
    """A run, in short."""

    run: str
    date: str
    """The night of the captures, ISO 8601."""
    level: str
    """good, degraded or failed."""
    findings: tuple[FindingSummary, ...] = ()
    """The first `MOST_FINDINGS` findings."""
    finding_count: int = 0
    unit: str = "m"
    """The unit of lengths: m, or "" if the scale is unknown."""
    compared: bool = False
    """Were changes looked for?"""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Figures of the whole night: `points` of the cloud, usable `cameras` and `pairs`, `seconds`; of a stage: "stage.name"."""
    volumes: Mapping[str, CutFill] = field(default_factory=dict)
    """Volumes gained and lost, by zone; "" is the whole site."""
    changes: tuple[ChangeSummary, ...] = ()
    new: tuple[str, ...] = ()
    """Ids of the changes that it saw first."""
    gone: tuple[str, ...] = ()
    """Ids of the changes of the night before that are there no more."""


def summary_of(record: RunRecord) -> RunSummary:
    """Return the summary of a run."""
    # 1. the verdict; runs of earlier versions have none
    level = "failed"
    findings: tuple[Finding, ...] = ()
    if record.verdict:
        level = record.verdict.level
        findings = record.verdict.findings
    elif record.exit_code == 0:
        level = "good"
    elif record.cloud:
        level = "degraded"

    # 2. what has changed
    volumes: Mapping[str, CutFill] = {}
    gone: tuple[str, ...] = ()
    if record.compared:
        volumes = record.compared.volumes
        gone = tuple(record.compared.gone)
    changes = []
    new = []
    for name, change in record.changes.items():
        changes.append(_change(name, change, record))
        if change.first == record.date:
            new.append(name)

    return RunSummary(
        run=record.run,
        date=_night(record),
        level=level,
        findings=tuple(FindingSummary(str(finding), finding.remedy) for finding in findings[:MOST_FINDINGS]),
        finding_count=len(findings),
        unit=record.unit,
        compared=record.compared is not None,
        figures=_figures(record),
        volumes=volumes,
        changes=tuple(changes),
        new=tuple(new),
        gone=gone,
    )


def _night(record: RunRecord) -> str:
    """Return the night of a run, which is never days after the run: a clock may be years ahead."""
    started = started_by(record.run)
    if started is None:
        return record.date
    # a day ahead is no fault: runs are named in UTC
    latest = started.date() + datetime.timedelta(days=1)
    return min(record.date, latest.isoformat())


def _change(name: str, change: RecordedChange, record: RunRecord) -> ChangeSummary:
    picture = ""
    if record.compared:
        for file in record.compared.files:
            if Path(file).stem.endswith(f"-{name}"):
                picture = file
    return ChangeSummary(
        id=name,
        kind=change.kind,
        zone=change.zone,
        size=(change.length, change.width, change.height),
        place=(change.x, change.y, change.z),
        volume=change.volume,
        volume_sigma=change.volume_sigma,
        volume_least=change.volume_least,
        volume_most=change.volume_most,
        seen=change.seen,
        first=change.first or record.date,
        last=change.last or record.date,
        acknowledged=change.acknowledged,
        picture=picture,
    )


def _figures(record: RunRecord) -> dict[str, float]:
    figures: dict[str, float] = {
        "cameras": sum(camera.ok for camera in record.cameras),
        "pairs": sum(pair.ok for pair in record.pairs),
        "seconds": record.seconds.wall,
    }
    if record.cloud:
        figures["points"] = record.cloud.points
    for stage, result in record.results.items():
        for name, value in vars(result).items():
            if isinstance(value, int | float) and not isinstance(value, bool) and name not in BOOKKEEPING:
                figures[f"{stage}.{name}"] = value
    return figures

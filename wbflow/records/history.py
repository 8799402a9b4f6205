"""The history of a site: its runs, the volumes of its zones night by night, and each change from its first night to its last."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from typing import Any

from ..cache.layout import WorkFolder
from ..json_dataclass import JsonDataclass
from ..pipeline.summaries import RecordedChange
from .findings import Verdict
from .killed_runs import KilledRun, killed_runs
from .ledger import Ledger, LedgerRun
from .record import RunRecord, moment
from .run_folder import last_of_nights, newest_runs

MOST_WORDS = 80
"""Longest text of a run's verdict in a line, in characters."""
KILLED_CODE = 137
"""Exit code of a killed run, as a shell reports it (128 + SIGKILL)."""


@dataclass(frozen=True)
class Entry:
    """A run in the history of its site."""

    run: LedgerRun
    verdict: Verdict | None
    """None if run.json is gone, or is of an earlier version."""
    cleaned: bool
    """Has its folder been removed?"""
    killed: KilledRun | None = None
    """How far it came, if it was killed or crashed; it has no folder then."""

    @property
    def words(self) -> str:
        """The verdict in words: the level, and the first finding."""
        if self.killed:
            return self.killed.words
        if self.cleaned:
            return "cleaned"
        if self.verdict is None:
            return ""
        words = f"{self.verdict.level}: {self.verdict.findings[0]}" if self.verdict.findings else self.verdict.level
        return words if len(words) <= MOST_WORDS else f"{words[: MOST_WORDS - 3]}..."

    def to_json(self) -> dict[str, Any]:
        verdict = self.verdict.to_json() if self.verdict else None
        return {**asdict(self.run), "verdict": verdict, "cleaned": self.cleaned, "killed": self.killed is not None}


def history(work: WorkFolder) -> list[Entry]:
    """Return every run, oldest first; also those that were killed."""
    verdicts = {folder.id: record.verdict for folder, record in newest_runs(work)}
    with Ledger(work) as ledger:
        runs = ledger.runs()
    entries = [Entry(run, verdicts.get(run.run), cleaned=not work.run(run.run).record.exists()) for run in runs]
    entries += [Entry(_ledger_run(killed), None, cleaned=False, killed=killed) for killed in killed_runs(work)]
    return sorted(entries, key=lambda entry: entry.run.run)


def _ledger_run(killed: KilledRun) -> LedgerRun:
    """Return what is known of a killed run as a row of the ledger, which has none for it."""
    wall = (moment(killed.last) - moment(killed.started)).total_seconds()
    return LedgerRun(
        run=killed.run,
        date=killed.date,
        started=killed.started,
        finished=killed.last,
        wall=wall,
        cpu=0.0,
        cached=0,
        ran=killed.tasks,
        rejected=0,
        failed=0,
        skipped=0,
        points=None,
        exit_code=KILLED_CODE,
    )


def places(work: WorkFolder) -> list[dict[str, Any]]:
    """Return the paths of every run's files, oldest run first, for programs; the path of a file that is gone is None."""
    rows = []
    for entry in history(work):
        if entry.killed:
            continue
        run, paths, level = entry.run, work.run(entry.run.run), entry.verdict.level if entry.verdict else None
        data = {"run": run.run, "night": run.date, "exit_code": run.exit_code, "level": level, "points": run.points}
        files = {"folder": paths.folder, "cloud": paths.cloud, "report": paths.report}
        rows.append(data | {name: str(path) if path.exists() else None for name, path in files.items()})
    return rows


@dataclass(frozen=True)
class GrowthRow(JsonDataclass):
    """A part of the ground, or a change, on one night; volumes and areas in the site's unit."""

    night: str
    run: str
    what: str
    """What the row describes: site, zone or change."""
    name: str
    """Name of the site or zone; of a change its number, which stays the same through the nights."""
    kind: str = ""
    zone: str = ""
    gained: float | None = None
    gained_sigma: float | None = None
    lost: float | None = None
    lost_sigma: float | None = None
    growth: float | None = None
    """Growth of a change's volume since the night on which it was last seen."""
    area: float | None = None
    unseen: float | None = None
    begin: str = ""
    """The first night of a change."""
    end: str = ""
    """The first night after the last one of a change; "" while it lasts."""
    x: float | None = None
    y: float | None = None
    z: float | None = None

    def __str__(self) -> str:
        """As a line of a table."""
        gained, lost = (
            f"{value:.1f} ± {sigma or 0.0:.1f}" if value is not None else ""
            for value, sigma in ((self.gained, self.gained_sigma), (self.lost, self.lost_sigma))
        )
        growth_text = f"{self.growth:+.1f}" if self.growth is not None else ""
        extent = f"{self.begin} to {self.end or 'now'}" if self.begin else f"{self.area:.0f} m² seen, {self.unseen:.0f} m² not"
        return f"{self.night} {self.what:6} {self.name:16} {self.kind:9} {gained:>14} {lost:>14} {growth_text:>7}  {extent}"


HEAD = f"{'night':10} {'what':6} {'name':16} {'kind':9} {'gained':>14} {'lost':>14} {'growth':>7}  nights, or ground"
"""Heading of a table whose lines are `GrowthRow`s."""


def growth(work: WorkFolder) -> list[GrowthRow]:
    """Return the volumes of the site and its zones, night by night, then each change from its first night to its last."""
    compared = [night for night in last_of_nights(newest_runs(work)) if any(result.volumes for result in night.results.values())]
    rows = []
    for night in compared:
        for zone, part in ((zone, part) for result in night.results.values() for zone, part in result.volumes.items()):
            what, name = ("zone", zone) if zone else ("site", night.site)
            volumes = part.gained, part.gained_sigma, part.lost, part.lost_sigma
            rows.append(GrowthRow(night.date, night.run, what, name, "", zone, *volumes, None, part.area, part.unseen))
    for number, track in enumerate(_tracks(compared), 1):
        (first, _), (last, _) = track[0], track[-1]
        end = next((night.date for night in compared if night.date > last.date), "")
        previous: float | None = None
        for night, change in track:
            volume, sigma = change.volume or 0.0, change.volume_sigma
            row: dict[str, Any] = {name: getattr(change, name) for name in ("kind", "zone", "area", "x", "y", "z")}
            row |= {"gained": volume, "gained_sigma": sigma} if change.kind != "vanished" else {}
            row |= {"lost": volume, "lost_sigma": sigma} if change.kind != "new" else {}
            row |= {"growth": None if previous is None else volume - previous, "begin": first.date, "end": end}
            rows.append(GrowthRow(night.date, night.run, "change", str(number), **row))
            previous = volume
    return rows


def _tracks(nights: Iterable[RunRecord]) -> list[list[tuple[RunRecord, RecordedChange]]]:
    """Return every change on the nights on which it was seen; one that is hidden for a night stays the same change.

    Changes are followed through the nights with the same reference.
    """
    tracks: list[list[tuple[RunRecord, RecordedChange]]] = []
    for night in nights:
        known = [track for track in tracks if track[0][0].reference == night.reference]
        for change in (change for result in night.results.values() for change in result.objects.values()):
            track = next((t for t in known if t[-1][0] is not night and change.is_same(t[-1][1])), None)
            if track is None:
                track = []
                tracks.append(track)
            track.append((night, change))
    return tracks


def as_csv(rows: Iterable[GrowthRow]) -> str:
    """Return a table with a header row, for spreadsheets."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [column.name for column in fields(GrowthRow)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(row.to_json() for row in rows)
    return text.getvalue()

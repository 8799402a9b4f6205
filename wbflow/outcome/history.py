"""The history of a site: its runs, the volumes of its zones night by night, and each change from its first night to its last."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from ..cache.layout import WorkFolder
from ..json_dataclass import JsonDataclass
from ..pipeline.summaries import Change
from ..records.findings import Verdict
from ..records.ledger import Ledger, LedgerRun
from ..records.record import RunRecord
from ..records.run_folder import NoSuchRun, RunFolder, last_of_nights, newest_runs

MOST_WORDS = 80
"""Longest text of a run's verdict in a line, in characters."""


@dataclass(frozen=True)
class Entry:
    """A run in the history of its site."""

    run: LedgerRun
    verdict: Verdict | None
    """None if run.json is gone, or is of an earlier version."""
    cleaned: bool
    """Has its folder been removed?"""

    @property
    def words(self) -> str:
        """The verdict in words: the level, and the first finding."""
        if self.cleaned:
            return "cleaned"
        if self.verdict is None:
            return ""
        words = f"{self.verdict.level}: {self.verdict.findings[0]}" if self.verdict.findings else self.verdict.level
        return words if len(words) <= MOST_WORDS else f"{words[: MOST_WORDS - 3]}..."

    def to_json(self) -> dict[str, Any]:
        verdict = self.verdict.to_json() if self.verdict else None
        return {**asdict(self.run), "verdict": verdict, "cleaned": self.cleaned}


def history(work: WorkFolder) -> list[Entry]:
    """Return every run, oldest first."""
    with Ledger(work) as ledger:
        runs = [(run, RunFolder(work.run(run.run))) for run in ledger.runs()]
    return [Entry(run, _verdict_of(folder), cleaned=not folder.paths.record.exists()) for run, folder in runs]


def _verdict_of(folder: RunFolder) -> Verdict | None:
    try:
        return folder.record().verdict
    except NoSuchRun:
        return None


def places(work: WorkFolder) -> list[dict[str, Any]]:
    """Return the paths of every run's files, oldest run first, for programs; the path of a file that is gone is None."""
    rows = []
    for entry in history(work) if work.root.exists() else ():
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


@dataclass
class _Track:
    """A change, followed through the nights with the same reference."""

    number: int
    reference: str | None
    seen: list[tuple[RunRecord, Change]] = field(default_factory=list)
    end: str = ""

    def rows(self) -> Iterator[GrowthRow]:
        previous: float | None = None
        for record, change in self.seen:
            volume, sigma = change.volume or 0.0, change.volume_sigma
            row = {name: getattr(change, name) for name in ("kind", "zone", "area", "x", "y", "z")}
            row |= {"gained": volume, "gained_sigma": sigma} if change.kind != "vanished" else {}
            row |= {"lost": volume, "lost_sigma": sigma} if change.kind != "new" else {}
            row |= {"growth": None if previous is None else volume - previous, "begin": self.seen[0][0].date, "end": self.end}
            yield GrowthRow(record.date, record.run, "change", str(self.number), **row)
            previous = volume


def growth(work: WorkFolder) -> list[GrowthRow]:
    """Return the volumes of the site and its zones, night by night, then each change from its first night to its last."""
    nights = last_of_nights(newest_runs(work))
    return [*_volume_rows(nights), *(row for change in _follow(nights) for row in change.rows())]


def _volume_rows(nights: Iterable[RunRecord]) -> Iterator[GrowthRow]:
    for record in nights:
        for zone, part in ((zone, part) for result in record.results.values() for zone, part in result.volumes.items()):
            volumes = part.gained, part.gained_sigma, part.lost, part.lost_sigma
            what = "zone" if zone else "site"
            yield GrowthRow(record.date, record.run, what, zone or record.site, "", zone, *volumes, None, part.area, part.unseen)


def _follow(nights: Iterable[RunRecord]) -> list[_Track]:
    """Return every change with the nights on which it was seen; one that is hidden for a night stays the same change."""
    all_tracks: list[_Track] = []
    for record in (night for night in nights if any(result.volumes for result in night.results.values())):
        tracks = [track for track in all_tracks if track.reference == record.reference]
        for change in (change for result in record.results.values() for change in result.objects.values()):
            track = next((t for t in tracks if t.seen[-1][0] is not record and change.is_same(t.seen[-1][1])), None)
            if track is None:
                track = _Track(len(all_tracks) + 1, record.reference)
                all_tracks.append(track)
            track.seen.append((record, change))
        for track in all_tracks:
            track.end = "" if track.seen[-1][0] is record else track.end or record.date
    return all_tracks


def as_csv(rows: Iterable[GrowthRow]) -> str:
    """Return a table with a header row, for spreadsheets."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [column.name for column in fields(GrowthRow)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(row.to_json() for row in rows)
    return text.getvalue()

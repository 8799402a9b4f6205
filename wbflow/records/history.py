"""The history of a site: its runs, the volumes of its zones night by night, and each change from its first night to its last."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from ..cache.layout import WorkFolder
from ..json_dataclass import JsonDataclass
from ..pipeline.summaries import RecordedChange, volume_words
from .changes import count_words, news_words
from .findings import Verdict
from .killed_runs import KilledRun, killed_runs
from .ledger import Ledger, LedgerRun
from .record import RunRecord, moment
from .run_folder import last_of_nights, newest_runs

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
    changes: str = ""
    """How many changes nobody has acknowledged: "2 changes"; "" for none."""
    reason: str = ""
    """The first finding, and what has changed on that night, in a line; how far a killed run came; "" for none."""

    @property
    def words(self) -> str:
        """The verdict in words: the level, and how much has changed."""
        if self.killed:
            return "killed"
        if self.cleaned:
            return "cleaned"
        if self.verdict is None:
            return ""
        return f"{self.verdict.level}, {self.changes}" if self.changes else self.verdict.level

    def to_json(self) -> dict[str, Any]:
        verdict = self.verdict.to_json() if self.verdict else None
        return {**asdict(self.run), "verdict": verdict, "cleaned": self.cleaned, "killed": self.killed is not None}


def history(work: WorkFolder) -> list[Entry]:
    """Return every run, oldest first; also those that were killed."""
    records = {folder.id: record for folder, record in newest_runs(work)}
    with Ledger(work) as ledger:
        runs = ledger.runs()
    entries = [_entry(run, records.get(run.run), cleaned=not work.run(run.run).record.exists()) for run in runs]
    for killed in killed_runs(work):
        entries.append(Entry(_ledger_run(killed), None, cleaned=False, killed=killed, reason=killed.words))
    return sorted(entries, key=lambda entry: entry.run.run)


def _entry(run: LedgerRun, record: RunRecord | None, cleaned: bool) -> Entry:
    if record is None:
        return Entry(run, None, cleaned)
    reasons = []
    if record.verdict and record.verdict.findings:
        reasons.append(str(record.verdict.findings[0]))
    news = news_words(record)
    if news:
        reasons.append(news)
    return Entry(run, record.verdict, cleaned, changes=count_words(record), reason="; ".join(reasons))


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
    """Name of the site or zone; id of the change."""
    kind: str = ""
    zone: str = ""
    gained: float | None = None
    gained_sigma: float | None = None
    gained_least: float | None = None
    gained_most: float | None = None
    lost: float | None = None
    lost_sigma: float | None = None
    lost_least: float | None = None
    lost_most: float | None = None
    area: float | None = None
    unseen: float | None = None
    seen: bool | None = None
    """Was the change seen on this night?"""
    begin: str = ""
    """The first night of a change."""
    end: str = ""
    """The first night on which a change was gone; "" while it lasts."""
    x: float | None = None
    y: float | None = None
    z: float | None = None


def growth(nights: Sequence[RunRecord]) -> list[GrowthRow]:
    """Return the volumes of the site and its zones, night by night, then each change from its first night to its last.

    nights: those that were compared, oldest first.
    """
    rows = []
    for night in nights:
        for zone, part in ((zone, part) for result in night.results.values() for zone, part in result.volumes.items()):
            what, name = ("zone", zone) if zone else ("site", night.site)
            volumes: dict[str, Any] = {column: getattr(part, column) for column in _VOLUMES}
            rows.append(GrowthRow(night.date, night.run, what, name, zone=zone, area=part.area, unseen=part.unseen, **volumes))
    for thing in things(nights):
        for night in nights:
            change = night.changes.get(thing.change.id)
            if change:
                rows.append(_change_row(night, change, thing.gone))
    return rows


_VOLUMES = ("gained", "gained_sigma", "gained_least", "gained_most", "lost", "lost_sigma", "lost_least", "lost_most")


def _change_row(night: RunRecord, change: RecordedChange, gone: str) -> GrowthRow:
    volumes: dict[str, Any] = {}
    sides = {"new": ("gained",), "vanished": ("lost",)}.get(change.kind, ("gained", "lost"))
    for side in sides:
        volumes |= {side: change.volume, f"{side}_sigma": change.volume_sigma}
        volumes |= {f"{side}_least": change.volume_least, f"{side}_most": change.volume_most}
    place = {name: getattr(change, name) for name in ("zone", "area", "seen", "x", "y", "z")}
    return GrowthRow(night.date, night.run, "change", change.id, change.kind, **place, **volumes, begin=change.first, end=gone)


@dataclass(frozen=True)
class Thing:
    """A change, from its first night to its last."""

    change: RecordedChange
    """As it was on the newest night that has it."""
    gone: str
    """The first night on which it was gone (ISO 8601); "" while it lasts."""

    def line(self, unit: str) -> str:
        """Return it as a line of a table: id, kind, size, place, interval of its volume, nights."""
        change = self.change
        size = " x ".join(f"{side:.1f}" for side in (change.length, change.width, change.height))
        place = f"{change.x:.1f}, {change.y:.1f}"
        nights = f"{change.first} to {change.last if self.gone else 'now'}"
        return f"{change.id:5} {change.kind:9} {size:18} {place:14} {change.volume_words(unit):15} {nights}"


THINGS_HEAD = f"{'id':5} {'kind':9} {'size':18} {'at':14} {'volume':15} nights"
"""Heading of the lines of things."""


def compared_nights(work: WorkFolder) -> list[RunRecord]:
    """Return the last run of each night that has found what changed, oldest first."""
    return [record for record in last_of_nights(newest_runs(work)) if record.compared]


def things(nights: Sequence[RunRecord]) -> list[Thing]:
    """Return every change since the first night, in the order in which they were first seen; those that have ended, too."""
    newest: dict[str, RecordedChange] = {}
    gone: dict[str, str] = {}
    for night in nights:
        for name, change in night.changes.items():
            newest[name] = change
            gone.pop(name, None)
        for name in newest:
            if name not in night.changes:
                gone.setdefault(name, night.date)
    found = [Thing(change, gone.get(name, "")) for name, change in newest.items()]
    return sorted(found, key=lambda thing: thing.change.first)


def balance_lines(night: RunRecord) -> Iterator[str]:
    """Yield the volumes gained and lost on the site and in each zone, as lines of text."""
    unit = night.unit
    for zone, part in ((zone, part) for result in night.results.values() for zone, part in result.volumes.items()):
        gained = volume_words((part.gained_least, part.gained_most), (part.gained, part.gained_sigma), unit)
        lost = volume_words((part.lost_least, part.lost_most), (part.lost, part.lost_sigma), unit)
        ground = f"{part.area:,.0f} {unit}² seen" if unit else f"{part.area:,.0f} seen"
        yield f"{zone or 'whole site'}: gained {gained}, lost {lost}; {ground}, {part.unseen:,.0f} not"


def as_csv(rows: Iterable[GrowthRow]) -> str:
    """Return a table with a header row, for spreadsheets."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [column.name for column in fields(GrowthRow)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(row.to_json() for row in rows)
    return text.getvalue()

"""All nights of a site and its changes, from first to last night, as the page of the site shows them.

They come from the summaries in the ledger, so that hundreds of nights cost less than a second, and nights whose folders are gone
are still known.
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

from ..cache.layout import WorkFolder
from ..cache.untrusted import read_untrusted
from ..pipeline.summaries import volume_words
from ..records.killed_runs import KilledRun, killed_runs
from ..records.ledger import Ledger
from ..records.summary import ChangeSummary, RunSummary
from .pictures import data_url
from .timeline import Period

KILLED = "killed"
"""State of a night whose only runs were killed; those of other nights are the levels of verdicts."""
_MOST_PICTURES_BYTES = 4_000_000
"""Pictures of changes are shown, in the order of the page, until they take this many bytes."""


@dataclass(frozen=True)
class Night:
    """A night of a site: its last run that was published, and those that were killed."""

    date: str
    state: str
    """good, degraded, failed or killed."""
    run: RunSummary | None
    """None if all its runs were killed."""
    report: str
    """Link to its report; "" if there is none any more."""
    cleaned: bool
    """Has its folder been removed?"""
    killed: tuple[KilledRun, ...]
    run_count: int
    """Number of its runs, also of those that were killed."""

    @property
    def day(self) -> datetime.date:
        return datetime.date.fromisoformat(self.date)

    @property
    def title(self) -> str:
        """The night in words, for the calendar."""
        words = f"{self.date}: {self.state}"
        if self.run and self.run.new:
            words += f"; new {', '.join(self.run.new)}"
        if self.run and self.run.gone:
            words += f"; gone {', '.join(self.run.gone)}"
        return words


@dataclass(frozen=True)
class Thing:
    """A change, from its first night to its last."""

    change: ChangeSummary
    """As it was on its last night."""
    volume: str
    """Its volume in words."""
    end: str
    """The night since which it is there no more, or is not compared any more; "" if it is still there."""
    is_gone: bool
    """False: nights are compared with another reference since its end."""
    report: str
    """Link to the report of the last night; "" if there is none any more."""
    left: float
    width: float
    """Where its nights lie within those of the page, in percent."""
    picture: str = ""
    """URL of its data; "" if there is none any more."""


def nights_of(work: WorkFolder, folder: Path) -> list[Night]:
    """Return all nights, oldest first.  folder: that of the page, which links are relative to.  Raises OSError, sqlite3.Error."""
    with Ledger(work) as ledger:
        runs = ledger.summaries()
    runs_of: dict[str, list[RunSummary]] = {}
    killed_of: dict[str, list[KilledRun]] = {}
    for run in runs:
        runs_of.setdefault(run.date, []).append(run)
    for killed in killed_runs(work):
        killed_of.setdefault(killed.date, []).append(killed)
    nights = []
    for date in sorted(runs_of.keys() | killed_of.keys()):
        nights.append(_night(work, date, runs_of.get(date, []), killed_of.get(date, []), folder))
    return nights


def _night(work: WorkFolder, date: str, runs: Sequence[RunSummary], killed: Sequence[KilledRun], folder: Path) -> Night:
    """Return a night.  runs, killed: its runs, oldest first, of which at least one list is not empty."""
    run_count = len(runs) + len(killed)
    if not runs:
        return Night(date, KILLED, None, report="", cleaned=False, killed=tuple(killed), run_count=run_count)
    last = runs[-1]
    paths = work.run(last.run)
    report = ""
    if paths.report.is_file():
        report = quote(Path(os.path.relpath(paths.report, folder)).as_posix())
    return Night(
        date=date,
        state=last.level,
        run=last,
        report=report,
        cleaned=not paths.record.is_file(),
        killed=tuple(killed),
        run_count=run_count,
    )


def unit_of(nights: Sequence[Night]) -> str:
    """Return the unit of lengths: that of the newest run."""
    for night in reversed(nights):
        if night.run:
            return night.run.unit
    return ""


def things_of(work: WorkFolder, nights: Sequence[Night], period: Period) -> list[Thing]:
    """Return every change: those that are still there first, the newest first.  period: the days of the page."""
    # 1. The last night of each change, and the night since which it is gone.
    compared = [(night, night.run) for night in nights if night.run and night.run.compared]
    last_of: dict[str, tuple[int, ChangeSummary]] = {}
    gone_on: dict[str, str] = {}
    for index, (night, run) in enumerate(compared):
        for change in run.changes:
            last_of[change.id] = (index, change)
        for name in run.gone:
            gone_on[name] = night.date

    # 2. How each of them ended.
    unit = unit_of(nights)
    things = []
    for name, (index, change) in last_of.items():
        last, _ = compared[index]
        end = gone_on.get(name, "")
        if not end and index + 1 < len(compared):
            end = compared[index + 1][0].date  # it is not among its changes: these are of another reference
        first_day = max(datetime.date.fromisoformat(change.first), period.first)
        left, width = period.part(first_day, last.day)
        volume = volume_words((change.volume_least, change.volume_most), (change.volume, change.volume_sigma), unit)
        things.append(Thing(change, volume, end, name in gone_on, last.report, left, width))
    things.sort(key=lambda thing: (not thing.end, thing.end, thing.change.first), reverse=True)

    # 3. The pictures of those that are still there, which are in the folder of the newest run.
    if compared:
        _, newest = compared[-1]
        things = _with_pictures(things, work.run(newest.run).folder)
    return things


def _with_pictures(things: Sequence[Thing], folder: Path) -> list[Thing]:
    """Return changes, those that are still there with their pictures, as long as these fit.  folder: contains the pictures."""
    bytes_left = _MOST_PICTURES_BYTES
    pictured = []
    for thing in things:
        shown = thing
        if thing.change.picture and not thing.end:
            picture = _picture(folder / thing.change.picture)
            if len(picture) <= bytes_left:
                bytes_left -= len(picture)
                shown = replace(thing, picture=picture)
        pictured.append(shown)
    return pictured


def _picture(file: Path) -> str:
    """Return a picture as the URL of its data; "" if it is gone."""
    try:
        return data_url(read_untrusted(file))
    except OSError:
        return ""

"""The page about one site: a calendar of all its nights with their verdicts, its changes from first to last night, trends.

It is made from the summaries in the ledger, so that hundreds of nights cost less than a second, and nights whose folders are gone
stay in it.  Each report links to it, and it to each report.
"""

from __future__ import annotations

import calendar
import datetime
import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

from ..cache.atomic import write_atomic
from ..cache.layout import WorkFolder
from ..cache.untrusted import read_untrusted
from ..pipeline.meanings import meaning, titled
from ..records.killed_runs import KilledRun, killed_runs
from ..records.ledger import Ledger
from ..records.run_folder import NoSuchRun
from ..records.summary import ChangeSummary, RunSummary
from ..site.models import Site
from . import render
from .pictures import data_url
from .timeline import Chart, Period, Sample, chart

KILLED = "killed"
"""State of a night whose only runs were killed; those of other nights are the levels of verdicts."""
_MOST_PICTURES_BYTES = 4_000_000
"""Pictures of changes are shown, the largest changes first, until they take this many bytes."""
_TITLES = {
    "points": ("points in the cloud", ""),
    "cameras": ("cameras in use", ""),
    "pairs": ("usable pairs", ""),
    "seconds": ("time of a run", "s"),
}
"""Title and unit of the figures that no stage reports."""
_MOST_GONE = 10
"""Largest number of changes that are there no more that are shown at once; earlier ones are folded."""
_UNITS = {"m", "m²", "m³", "px"}
"""Units with which the title of a figure may end, after a comma."""


@dataclass(frozen=True)
class Night:
    """A night on the page: its last run that was published."""

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
    """Its runs that were killed."""
    run_count: int
    new: tuple[str, ...]
    """Ids of the changes that it saw first."""
    gone: tuple[str, ...]
    """Ids of the changes that it saw no more."""

    @property
    def day(self) -> datetime.date:
        return datetime.date.fromisoformat(self.date)

    @property
    def title(self) -> str:
        """The night in words, for the calendar."""
        words = [f"{self.date}: {self.state}"]
        if self.new:
            words.append(f"new {', '.join(self.new)}")
        if self.gone:
            words.append(f"gone {', '.join(self.gone)}")
        return "; ".join(words)


@dataclass(frozen=True)
class Thing:
    """A change, from its first night to its last."""

    change: ChangeSummary
    """As it was seen on its last night."""
    first: str
    last: str
    """The first and the last night on which it was there."""
    end: str
    """The first compared night after the last one; "" if it is still there."""
    end_words: str
    """Why it ended: it is gone, or nights are compared with another reference."""
    report: str
    """Link to the report of the last night; "" if there is none any more."""
    picture: str
    """URL of its data; "" if there is none any more."""
    left: float
    width: float
    """Where its nights lie within those of the page, in percent."""


Week = Sequence[tuple[datetime.date | None, Night | None]]
"""Seven days, Monday first; None for days of other months, and for nights without a run."""


def write_site_page(site: Site, out: Path | None = None) -> Path:
    """Write the page about all nights of a site; returns its file.

    out: the file; None for its place in the work folder, where the reports link to.

    Raises NoSuchRun if there is no run; OSError, sqlite3.Error.
    """
    path = out or site.work_folder.site_page
    write_atomic(path, site_page(site, path).encode(errors="backslashreplace"))
    return path


def site_page(site: Site, out: Path) -> str:
    """Return the HTML page about all nights of a site.  out: the file it will be written to; links are relative to it.

    Raises NoSuchRun if there is no run.
    """
    work = site.work_folder
    folder = out.resolve().parent
    with Ledger(work) as ledger:
        runs = ledger.summaries()
    nights = _nights(work, runs, killed_runs(work), folder)
    if not nights:
        raise NoSuchRun(f"{work.root} has no runs yet", remedy="wbflow run SITE.yaml  makes one")
    things = _things(work, nights)
    return render(
        "site.html",
        site=site,
        nights=nights,
        newest=nights[-1],
        newest_report=next((night.report for night in reversed(nights) if night.report), ""),
        months=_months(nights),
        there=[thing for thing in things if not thing.end],
        gone=[thing for thing in things if thing.end],
        most_gone=_MOST_GONE,
        charts=_charts(nights),
        unit=_unit(nights),
        volume_words=_volume_words,
        place=place_of(work),
    )


def place_of(work: WorkFolder) -> str:
    """Return where the page of a site is, for a person to whom one of its reports was sent."""
    return f"{work.store}/{work.site_page.name}" if work.store else f"{work.site_page.absolute()} on {platform.node()}"


def _nights(work: WorkFolder, runs: Sequence[RunSummary], killed: Sequence[KilledRun], folder: Path) -> list[Night]:
    """Return all nights, oldest first.  runs, killed: oldest first; folder: that of the page."""
    runs_of: dict[str, list[RunSummary]] = {}
    killed_of: dict[str, list[KilledRun]] = {}
    for run in runs:
        runs_of.setdefault(run.date, []).append(run)
    for dead in killed:
        killed_of.setdefault(dead.date, []).append(dead)
    shown = {date: of_night[-1] for date, of_night in sorted(runs_of.items())}
    new, gone = _first_and_gone(list(shown.values()))
    nights = []
    for date in sorted(runs_of.keys() | killed_of.keys()):
        last = shown.get(date)
        paths = work.run(last.run) if last else None
        nights.append(
            Night(
                date=date,
                state=last.level if last else KILLED,
                run=last,
                report=_link(paths.report, folder) if paths and paths.report.is_file() else "",
                cleaned=paths is not None and not paths.record.is_file(),
                killed=tuple(killed_of.get(date, ())),
                run_count=len(runs_of.get(date, ())) + len(killed_of.get(date, ())),
                new=tuple(new.get(date, ())),
                gone=tuple(gone.get(date, ())),
            )
        )
    return nights


def _first_and_gone(runs: Sequence[RunSummary]) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Return, by night, the ids of changes that were there for the first time, and of those that were there no more.

    Nights that looked for no changes say nothing of them; with another reference, changes begin anew.
    """
    new: dict[str, list[str]] = {}
    gone: dict[str, list[str]] = {}
    known: set[str] = set()
    before: RunSummary | None = None
    for run in runs:
        if not run.compared:
            continue
        ids = [change.id for change in run.changes]
        new[run.date] = [name for name in ids if name not in known]
        if before is not None and before.reference == run.reference:
            gone[run.date] = [change.id for change in before.changes if change.id not in ids]
        known.update(ids)
        before = run
    return new, gone


def _link(path: Path, folder: Path) -> str:
    return quote(Path(os.path.relpath(path, folder)).as_posix())


def _things(work: WorkFolder, nights: Sequence[Night]) -> list[Thing]:
    """Return every change: those that are there first, the newest first."""
    period = Period(nights[0].day, nights[-1].day)
    # 1. the nights of each change
    compared = [night for night in nights if night.run and night.run.compared]
    nights_of: dict[str, list[tuple[int, ChangeSummary]]] = {}
    for index, night in enumerate(compared):
        for change in night.run.changes if night.run else ():
            nights_of.setdefault(change.id, []).append((index, change))
    # 2. how each of them ended
    things = []
    for name, seen in nights_of.items():
        last_index, change = seen[-1]
        first = compared[seen[0][0]]
        last = compared[last_index]
        end = compared[last_index + 1] if last_index + 1 < len(compared) else None
        left, width = period.part(first.day, last.day)
        things.append(
            Thing(
                change=change,
                first=first.date,
                last=last.date,
                end=end.date if end else "",
                end_words="gone" if end and name in end.gone else "not compared any more" if end else "",
                report=last.report,
                picture="",
                left=left,
                width=width,
            )
        )
    things.sort(key=lambda thing: (not thing.end, thing.last, thing.first), reverse=True)
    return _with_pictures(work, compared, things)


def _with_pictures(work: WorkFolder, compared: Sequence[Night], things: Iterable[Thing]) -> list[Thing]:
    """Return the changes, those that are still there with their pictures, as long as these fit."""
    run_of = {night.date: night.run.run for night in compared if night.run}
    bytes_left = _MOST_PICTURES_BYTES
    pictured = []
    for thing in things:
        if thing.change.picture and not thing.end:
            picture = _picture(work.run(run_of[thing.last]).folder / thing.change.picture)
            if len(picture) <= bytes_left:
                bytes_left -= len(picture)
                thing = replace(thing, picture=picture)
        pictured.append(thing)
    return pictured


def _picture(file: Path) -> str:
    """Return a picture as the URL of its data; "" if it is gone."""
    try:
        return data_url(read_untrusted(file))
    except OSError:
        return ""


def _months(nights: Sequence[Night]) -> list[tuple[str, list[Week]]]:
    """Return the months that have nights, the newest first, each with its name and its weeks."""
    night_of = {night.day: night for night in nights}
    months = []
    for year, month in sorted({(day.year, day.month) for day in night_of}, reverse=True):
        weeks: list[Week] = []
        for week in calendar.Calendar().monthdatescalendar(year, month):
            weeks.append([(day, night_of.get(day)) if day.month == month else (None, None) for day in week])
        months.append((f"{datetime.date(year, month, 1):%B %Y}", weeks))
    return months


def _charts(nights: Sequence[Night]) -> list[Chart]:
    """Return a chart for each figure of the nights."""
    runs = [night.run for night in nights if night.run]
    cubic = f"{unit}³" if (unit := _unit(nights)) else ""
    series: dict[tuple[str, str], list[Sample]] = {("points in the cloud", ""): []}
    for run in runs:
        for zone, part in run.volumes.items():
            of_zone = f" in {zone}" if zone else ""
            gained = _volume(run, part.gained, part.gained_least, part.gained_most)
            lost = _volume(run, part.lost, part.lost_least, part.lost_most)
            series.setdefault((f"volume gained{of_zone}", cubic), []).append(gained)
            series.setdefault((f"volume lost{of_zone}", cubic), []).append(lost)
    for run in runs:
        day = datetime.date.fromisoformat(run.date)
        for name, value in run.figures.items():
            title, figure_unit, scale = _titled(name)
            series.setdefault((title, figure_unit), []).append(Sample(day, scale * value, run.level))
    period = Period(nights[0].day, nights[-1].day)
    charts = []
    for (title, figure_unit), samples in series.items():
        drawn = chart(title, figure_unit, samples, period)
        if drawn:
            charts.append(drawn)
    return charts


def _volume(run: RunSummary, seen: float, least: float, most: float) -> Sample:
    """Return the sample of a volume; its interval is unknown where its upper end is below what was seen."""
    day = datetime.date.fromisoformat(run.date)
    return Sample(day, seen, run.level, least, most) if most >= seen else Sample(day, seen, run.level)


def _titled(name: str) -> tuple[str, str, float]:
    """Return the title of a figure of `RunSummary.figures`, its unit, and the factor to it."""
    if name in _TITLES:
        return *_TITLES[name], 1.0
    figure = name.partition(".")[2]
    if meaning(figure).share:
        return titled(figure), "%", 100.0
    title, _, unit = titled(figure).rpartition(", ")
    return (title, unit, 1.0) if unit in _UNITS else (titled(figure), "", 1.0)


def _unit(nights: Sequence[Night]) -> str:
    """Return the unit of lengths: m, or "" if the scale is unknown."""
    metric = [night.run.metric for night in nights if night.run]
    return "m" if metric and metric[-1] else ""


def _volume_words(change: ChangeSummary, unit: str) -> str:
    """Return the volume of a change, as far as it is known."""
    power = f" {unit}³" if unit else ""
    if change.volume_most > 0:
        return f"{change.volume_least:.1f} to {change.volume_most:.1f}{power}"
    return f"{change.volume:.1f} ± {change.volume_sigma:.1f}{power}" if change.volume else ""

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
from ..pipeline.summaries import volume_words
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
    """Ids of the changes that are there no more since it."""

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
    volume: str
    """Its volume in words."""
    end: str
    """The night since which it is there no more, or is not compared any more; "" if it is still there."""
    is_gone: bool
    """False: nights are compared with another reference since its end."""
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
        days={night.date: f"#night-{night.date}" for night in nights},
        unit=_unit(nights),
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
                new=tuple(change.id for change in last.changes if change.first == date) if last else (),
                gone=last.gone if last else (),
            )
        )
    return nights


def _link(path: Path, folder: Path) -> str:
    return quote(Path(os.path.relpath(path, folder)).as_posix())


def _things(work: WorkFolder, nights: Sequence[Night]) -> list[Thing]:
    """Return every change: those that are there first, the newest first."""
    period = Period(nights[0].day, nights[-1].day)
    unit = _unit(nights)
    # 1. the last night of each change, and the night since which it is gone
    compared = [night for night in nights if night.run and night.run.compared]
    last_of: dict[str, tuple[int, ChangeSummary]] = {}
    gone_on: dict[str, str] = {}
    for index, night in enumerate(compared):
        for change in night.run.changes if night.run else ():
            last_of[change.id] = (index, change)
        gone_on.update(dict.fromkeys(night.gone, night.date))
    # 2. how each of them ended
    things = []
    for name, (index, change) in last_of.items():
        last = compared[index]
        next_date = compared[index + 1].date if index + 1 < len(compared) else ""
        interval = (change.volume_least, change.volume_most)
        left, width = period.part(max(datetime.date.fromisoformat(change.first), period.first), last.day)
        things.append(
            Thing(
                change=change,
                volume=volume_words(interval, (change.volume, change.volume_sigma), unit),
                end=gone_on.get(name, next_date),
                is_gone=name in gone_on,
                report=last.report,
                picture="",
                left=left,
                width=width,
            )
        )
    things.sort(key=lambda thing: (not thing.end, thing.end, thing.change.first), reverse=True)
    return _with_pictures(work, compared, things)


def _with_pictures(work: WorkFolder, compared: Sequence[Night], things: Iterable[Thing]) -> list[Thing]:
    """Return the changes, those that are still there with their pictures, as long as these fit."""
    newest = compared[-1].run if compared else None
    bytes_left = _MOST_PICTURES_BYTES
    pictured = []
    for thing in things:
        if newest and thing.change.picture and not thing.end:
            picture = _picture(work.run(newest.run).folder / thing.change.picture)
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
    unit = _unit(nights)
    cubic = f"{unit}³" if unit else ""
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
    """Return the unit of lengths of the newest run."""
    units = [night.run.unit for night in nights if night.run]
    return units[-1] if units else ""

"""The page about one site: a calendar of all its nights with their verdicts, its changes from first to last night, trends.

Each report links to it, and it to each report.
"""

from __future__ import annotations

import calendar
import datetime
from collections.abc import Sequence
from pathlib import Path

from ..cache.atomic import write_atomic
from ..pipeline.meanings import meaning, titled
from ..records.run_folder import NoSuchRun
from ..records.summary import RunSummary
from ..site.models import Site
from . import place_of, render
from .site_nights import Night, nights_of, things_of, unit_of
from .timeline import Chart, Period, Sample, chart

_MOST_GONE = 10
"""Largest number of changes that are there no more that are shown at once; earlier ones are folded."""
_MOST_MONTHS = 12
"""Largest number of months that are shown at once; earlier ones are folded."""
_TITLES = {
    "points": ("points in the cloud", ""),
    "cameras": ("cameras in use", ""),
    "pairs": ("usable pairs", ""),
    "seconds": ("time of a run", "s"),
}
"""Title and unit of the figures that no stage reports."""
_UNITS = {"m", "m²", "m³", "px"}
"""Units with which the title of a figure may end, after a comma."""

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

    Raises NoSuchRun if there is no run; OSError, sqlite3.Error.
    """
    work = site.work_folder
    nights = nights_of(work, out.resolve().parent)
    if not nights:
        raise NoSuchRun(f"{work.root} has no runs yet", remedy="wbflow run SITE.yaml  makes one")
    period = Period(nights[0].day, nights[-1].day)
    reports = [night.report for night in nights if night.report]
    return render(
        "site.html",
        site=site,
        nights=nights,
        newest=nights[-1],
        newest_report=reports[-1] if reports else "",
        months=_months(nights),
        most_months=_MOST_MONTHS,
        things=things_of(work, nights, period),
        most_gone=_MOST_GONE,
        charts=_charts(nights, period),
        days={night.date: f"#night-{night.date}" for night in nights},
        unit=unit_of(nights),
        place=place_of(work),
    )


def _months(nights: Sequence[Night]) -> list[tuple[str, list[Week]]]:
    """Return the months that have nights, the newest first, each with its name and its weeks."""
    night_of = {night.day: night for night in nights}
    months = []
    for year, month in sorted({(day.year, day.month) for day in night_of}, reverse=True):
        weeks: list[Week] = []
        for days in calendar.Calendar().monthdatescalendar(year, month):
            week: list[tuple[datetime.date | None, Night | None]] = []
            for day in days:
                if day.month == month:
                    week.append((day, night_of.get(day)))
                else:
                    week.append((None, None))
            weeks.append(week)
        months.append((f"{datetime.date(year, month, 1):%B %Y}", weeks))
    return months


def _charts(nights: Sequence[Night], period: Period) -> list[Chart]:
    """Return a chart for each figure of the nights; those that say most come first.  period: the days of the page."""
    runs = [night.run for night in nights if night.run]
    points = ("points in the cloud", "")
    series: dict[tuple[str, str], list[Sample]] = {points: []}  # by title and unit
    for run in runs:
        for zone, part in run.volumes.items():
            where = f" in {zone}" if zone else ""
            cubic = f"{run.unit}³" if run.unit else ""
            gained = _volume(run, part.gained, part.gained_least, part.gained_most)
            lost = _volume(run, part.lost, part.lost_least, part.lost_most)
            series.setdefault((f"volume gained{where}", cubic), []).append(gained)
            series.setdefault((f"volume lost{where}", cubic), []).append(lost)
    for run in runs:
        day = datetime.date.fromisoformat(run.date)
        for name, value in run.figures.items():
            title, unit, scale = _titled(name)
            series.setdefault((title, unit), []).append(Sample(day, scale * value, run.level))
    charts = []
    for (title, unit), samples in series.items():
        drawn = chart(title, unit, samples, period)
        if drawn:
            charts.append(drawn)
    return charts


def _volume(run: RunSummary, seen: float, least: float, most: float) -> Sample:
    """Return the sample of a volume; its interval is unknown where its upper end is below what was seen."""
    day = datetime.date.fromisoformat(run.date)
    if most < seen:
        return Sample(day, seen, run.level)
    return Sample(day, seen, run.level, least, most)


def _titled(name: str) -> tuple[str, str, float]:
    """Return the title of a figure of `RunSummary.figures`, its unit, and the factor to it."""
    if name in _TITLES:
        title, unit = _TITLES[name]
        return title, unit, 1.0
    _, _, figure = name.partition(".")
    words = titled(figure)
    if meaning(figure).share:
        return words, "%", 100.0
    # "ground, m²" names its unit
    title, _, unit = words.rpartition(", ")
    if unit in _UNITS:
        return title, unit, 1.0
    return words, "", 1.0

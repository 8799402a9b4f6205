"""Charts of the report: figures over the last nights, each camera's last nights, and the run times of tasks."""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from ..pipeline.meanings import BOOKKEEPING, meaning, titled
from ..pipeline.stages import CHANGES, STAGES
from ..records.record import RunRecord
from ..task import Task
from ..verdict.baseline import appearance_of
from ..words import number
from .data import ReportData, is_number, state_of
from .timeline import Chart, Period, Sample, chart

FIRST_TRENDS = 6
"""Number of trends that are always shown; a phone folds the others."""
SPARK_NIGHTS = 14
"""Number of nights in a camera's row of bars."""
_LEAST_BAR = 0.12
"""Smallest height of such a bar, so that a camera without usable pairs can still be seen."""
TIMETABLE_WIDTH = 1000.0
"""Width of the timetable, in units of its drawing."""
_MOST_ROWS = 64
"""Largest number of rows of the timetable; tasks beyond it are left out."""
_SAME_MOMENT_S = 0.02
"""A task may begin this much before the end of the one before it in its row: clocks are not more exact."""
_LEAST_SPAN_S = 1e-3
"""Smallest length of the timetable: a single short task must not divide by zero."""


@dataclass(frozen=True)
class Trend:
    """A figure over the last nights."""

    title: str
    chart: Chart
    now: str
    """This night's value, with its unit; a dash if it has none."""
    median: str


class _Figure(NamedTuple):
    """A figure of one night, which the chart of its title shows."""

    title: str
    unit: str
    value: float
    least: float | None = None
    most: float | None = None


def trends(data: ReportData) -> list[Trend]:
    """Return a chart for each figure of the whole night; those that say most come first."""
    # 1. The samples of each figure, oldest first.
    series: dict[tuple[str, str], list[Sample]] = {}
    for figures_of in (_used, _changed, _reported, _spent):
        for night in data.nights:
            day = datetime.date.fromisoformat(night.date)
            state = night.verdict.level if night.verdict else ""
            for title, unit, value, least, most in figures_of(data, night):
                series.setdefault((title, unit), []).append(Sample(day, value, state, least, most))

    # 2. Their charts, all over the same days.
    first = datetime.date.fromisoformat(data.nights[0].date)
    last = datetime.date.fromisoformat(data.record.date)
    found = []
    for (title, unit), samples in series.items():
        drawn = chart(title, unit, samples, Period(first, last))
        if drawn is None:
            continue
        now = "–"
        if samples[-1].day == last:
            now = drawn.now
        found.append(Trend(title, drawn, now, _median(samples, unit)))
    return found


def _used(data: ReportData, night: RunRecord) -> Iterator[_Figure]:
    points = night.cloud.points if night.cloud else 0
    yield _Figure("points in the cloud", "", points)
    yield _Figure("cameras in use", "", sum(camera.ok for camera in night.cameras))
    yield _Figure("usable pairs", "", sum(pair.ok for pair in night.pairs))


def _changed(data: ReportData, night: RunRecord) -> Iterator[_Figure]:
    """Yield the volumes that were gained and lost, of the whole site and of each zone."""
    result = night.results.get(CHANGES)
    if result is None:
        return
    cubic = f"{night.unit}³" if night.unit else ""
    for zone, part in result.volumes.items():
        of_zone = f", {zone}" if zone else ""
        yield _Figure(f"volume gained{of_zone}", cubic, *_volume(part.gained, part.gained_least, part.gained_most))
        yield _Figure(f"volume lost{of_zone}", cubic, *_volume(part.lost, part.lost_least, part.lost_most))


def _volume(seen: float, least: float, most: float) -> tuple[float, float | None, float | None]:
    """Return a volume with the ends of its interval; None where it is unknown: its upper end is below what was seen."""
    if most < seen:
        return seen, None, None
    return seen, least, most


def _reported(data: ReportData, night: RunRecord) -> Iterator[_Figure]:
    """Yield the numbers that site-wide stages report."""
    for result in night.results.values():
        for name, value in vars(result).items():
            if not is_number(value) or name in BOOKKEEPING:
                continue
            if meaning(name).share:
                yield _Figure(titled(name), "%", 100 * value)
            else:
                yield _Figure(titled(name), "", value)


def _spent(data: ReportData, night: RunRecord) -> Iterator[_Figure]:
    yield _Figure("time", "s", night.seconds.wall)
    yield _Figure("CPU", "s", night.seconds.cpu)
    # the run of this page is not published yet
    folder = data.files
    if night.run != data.record.run:
        folder = data.work.run(night.run).folder
    with suppress(OSError):
        # not of its report, which is still to be written, nor of its log
        size = sum((folder / name).stat().st_size for name in night.files)
        yield _Figure("size of the night's products", "MB", size / 1e6)


def _median(samples: Sequence[Sample], unit: str) -> str:
    values = sorted(sample.value for sample in samples)
    return f"{number(values[len(values) // 2])} {unit}".strip()


def camera_bars(data: ReportData) -> dict[str, list[tuple[str, float, str]]]:
    """Return each camera's last nights: its state, the share of its pairs that find common points, and a label."""
    bars: dict[str, list[tuple[str, float, str]]] = {camera.id: [] for camera in data.record.cameras}
    for night in data.nights[-SPARK_NIGHTS:]:
        figures = appearance_of(night)
        for camera in night.cameras:
            # a camera that is no longer in the site has no row
            if camera.id not in bars:
                continue
            # a night that records no such share says only whether the camera was in use
            share = figures.get(camera.id, {}).get("matched_share", float(camera.ok))
            if camera.ok:
                health = "as it should be"
                if camera.health and not camera.health.ok:
                    health = camera.health.state
                words = f"{health}, {100 * share:.0f} % of its pairs find common points"
            else:
                words = camera.reason or camera.outcome
            bars[camera.id].append((state_of(camera, night), max(_LEAST_BAR, share), f"{night.date}: {words}"))
    return bars


def tasks_of_stages(data: ReportData) -> list[tuple[str, Counter[str]]]:
    """Return the name of each stage with the counts of its tasks' outcomes: ran, cached, rejected, failed, skipped."""
    counts: dict[str, Counter[str]] = {}
    for task, event in data.tasks.items():
        has_run = event.outcome == "ran" and event.fresh
        outcome: str = event.outcome
        if event.usable and not has_run:
            outcome = "cached"
        counts.setdefault(task.stage, Counter())[outcome] += 1
    return [(stage.name, counts[stage.name]) for stage in STAGES if stage.name in counts]


def timetable(data: ReportData) -> tuple[list[tuple[int, int, float, float, str]], float]:
    """Return a bar for each task that ran this night, and the seconds from the first begin to the last end.

    A bar is the index of the stage in `STAGES`, which gives the colour, its row, x, width, and label; tasks that ran at the same
    time are in different rows.
    """
    # 1. When each task ran, by its receipt.
    ran: list[tuple[float, float, Task]] = []
    for task, event in data.tasks.items():
        if not event.fresh:
            continue
        receipt = data.receipt(task)
        if receipt and receipt.finished:
            end = datetime.datetime.fromisoformat(receipt.finished).timestamp()
            ran.append((end - receipt.wall, end, task))
    if not ran:
        return [], 0.0
    ran.sort(key=lambda entry: entry[0])
    first = ran[0][0]
    last = max(end for _, end, _ in ran)
    span = max(last - first, _LEAST_SPAN_S)

    # 2. Each task is in the first row that is free when it begins.
    stage_numbers = {stage.name: k for k, stage in enumerate(STAGES)}
    row_ends: list[float] = []
    bars = []
    for begin, end, task in ran:
        row = 0
        while row < len(row_ends) and row_ends[row] > begin + _SAME_MOMENT_S:
            row += 1
        if row >= _MOST_ROWS:
            continue
        if row < len(row_ends):
            row_ends[row] = end
        else:
            row_ends.append(end)
        title = f"{task}: {end - begin:.1f} s, from {begin - first:.1f} s on"
        width = max(1.0, (end - begin) / span * TIMETABLE_WIDTH)
        bars.append((stage_numbers[task.stage], row, (begin - first) / span * TIMETABLE_WIDTH, width, title))
    return bars, span

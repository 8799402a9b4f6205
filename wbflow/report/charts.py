"""Charts of the report: figures over the last nights, each camera's last nights, and the run times of tasks."""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

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


def trends(data: ReportData) -> list[Trend]:
    """Return a chart for each figure of the whole night; those that say most come first."""
    nights = data.nights
    series: dict[tuple[str, str], list[Sample]] = {}  # by title and unit

    def add(
        title: str, unit: str, night: RunRecord, value: object, least: float | None = None, most: float | None = None
    ) -> None:
        if is_number(value):
            day = datetime.date.fromisoformat(night.date)
            sample = Sample(day, value, night.verdict.level if night.verdict else "", least, most)
            series.setdefault((title, unit), []).append(sample)

    # 1. What was used, and what changed.
    for night in nights:
        add("points in the cloud", "", night, night.cloud.points if night.cloud else 0)
        add("cameras in use", "", night, sum(camera.ok for camera in night.cameras))
        add("usable pairs", "", night, sum(pair.ok for pair in night.pairs))
    for night in nights:
        result = night.results.get(CHANGES)
        for zone, part in result.volumes.items() if result else ():
            of_zone = f", {zone}" if zone else ""
            cubic = f"{night.unit}³" if night.unit else ""
            add(
                f"volume gained{of_zone}", cubic, night, part.gained, *_interval(part.gained, part.gained_least, part.gained_most)
            )
            add(f"volume lost{of_zone}", cubic, night, part.lost, *_interval(part.lost, part.lost_least, part.lost_most))

    # 2. The figures of all stages.
    for night in nights:
        for result in night.results.values():
            for name, value in vars(result).items():
                if is_number(value) and name not in BOOKKEEPING:
                    is_share = meaning(name).share
                    add(titled(name), "%" if is_share else "", night, 100 * value if is_share else value)

    # 3. What it cost.
    for night in nights:
        add("time", "s", night, night.seconds.wall)
        add("CPU", "s", night, night.seconds.cpu)
        add("size of the night's products", "MB", night, _megabytes(data, night))

    period = Period(datetime.date.fromisoformat(nights[0].date), datetime.date.fromisoformat(nights[-1].date))
    found = []
    for (title, unit), samples in series.items():
        drawn = chart(title, unit, samples, period)
        if drawn:
            found.append(Trend(title, drawn, _now(drawn, samples, data), _median(samples, unit)))
    return found


def _interval(seen: float, least: float, most: float) -> tuple[float | None, float | None]:
    """Return the ends of a volume's interval; None where it is unknown: its upper end is below what was seen."""
    if most < seen:
        return None, None
    return least, most


def _now(drawn: Chart, samples: Sequence[Sample], data: ReportData) -> str:
    """Return this night's value; the last one may be of an earlier night."""
    if samples[-1].day.isoformat() == data.record.date:
        return drawn.now
    return "–"


def _median(samples: Sequence[Sample], unit: str) -> str:
    values = sorted(sample.value for sample in samples)
    return f"{number(values[len(values) // 2])} {unit}".strip()


def _megabytes(data: ReportData, night: RunRecord) -> float | None:
    """Return the size of what a night has made: not of its report, which is still to be written, nor of its log."""
    folder = data.files if night.run == data.record.run else data.work.run(night.run).folder
    try:
        return sum((folder / name).stat().st_size for name in night.files) / 1e6
    except OSError:
        return None


def camera_bars(data: ReportData) -> dict[str, list[tuple[str, float, str]]]:
    """Return each camera's last nights: its state, the share of its pairs that find common points, and a label."""
    bars: dict[str, list[tuple[str, float, str]]] = {camera.id: [] for camera in data.record.cameras}
    for night in data.nights[-SPARK_NIGHTS:]:
        figures = appearance_of(night)
        for camera in night.cameras:
            # a camera that is no longer in the site has no row
            if camera.id not in bars:
                continue
            share = figures.get(camera.id, {}).get("matched_share", 1.0 if camera.ok else 0.0)
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
        outcome = "cached" if event.usable and not has_run else event.outcome
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
        receipt = data.receipt(task) if event.fresh else None
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

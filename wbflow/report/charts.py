"""Charts of the report: figures over the last nights, each camera's last nights, and the run times of tasks."""

from __future__ import annotations

import datetime
import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from ..pipeline.meanings import meaning, titled
from ..pipeline.stages import CHANGES, STAGES
from ..records.record import RunRecord
from ..task import Task
from ..verdict.baseline import appearance_of
from ..words import number
from .data import ReportData, is_number, state_of

WIDTH = 260.0
HEIGHT = 76.0
EDGE = 8.0
"""Size of a chart, and its margin, in units of its drawing: room for the dots at its ends."""
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
class Chart:
    """A figure over the last nights."""

    title: str
    now: str
    median: str
    median_y: float
    points: Sequence[tuple[float, float, str, str, str]]
    """For each night that has the figure, oldest first: x, y, verdict, label, and link to the report ("" for this night)."""


def trends(data: ReportData) -> list[Chart]:
    """Return a chart for each figure of the whole night."""
    nights = data.nights
    series: list[tuple[str, str, list[float | None]]] = []  # title, unit, and the value of each night
    series.append(("points in the cloud", "", [night.cloud.points if night.cloud else 0 for night in nights]))
    series.append(("cameras in use", "", [sum(camera.ok for camera in night.cameras) for night in nights]))
    series.append(("usable pairs", "", [sum(pair.ok for pair in night.pairs) for night in nights]))
    names = dict.fromkeys((stage, name) for night in nights for stage, result in night.results.items() for name in vars(result))
    for stage, name in names:
        scale, unit = (100, "%") if meaning(name).share else (1, "")
        values = [getattr(night.results.get(stage), name, None) for night in nights]
        series.append((titled(name), unit, [scale * value if is_number(value) else None for value in values]))
    volumes = [result.volumes if (result := night.results.get(CHANGES)) else {} for night in nights]
    for zone, change in itertools.product(dict.fromkeys(itertools.chain(*volumes)), ("gained", "lost")):
        title = f"volume {change}{f', {zone}' if zone else ''}"
        series.append((title, "m³", [getattr(by_zone.get(zone), change, None) for by_zone in volumes]))
    series.append(("time", "s", [night.seconds.wall for night in nights]))
    series.append(("CPU", "s", [night.seconds.cpu for night in nights]))
    series.append(("size of the night's files", "MB", [_megabytes(data, night) for night in nights]))
    return [chart for title, unit, values in series if (chart := _chart(data, title, unit, values))]


def _chart(data: ReportData, title: str, unit: str, values: Sequence[float | None]) -> Chart | None:
    """Return the chart of a figure; None if fewer than two nights have it, or all values are 0."""
    known = [value for value in values if value is not None]
    if len(known) < 2 or not any(known):
        return None
    low, high = min(0.0, *known) if min(known) < 0.5 * max(known) else min(known), max(known)
    spread = high - low or abs(high) or 1.0
    step = (WIDTH - 2 * EDGE) / max(1, len(values) - 1)

    def y(value: float) -> float:
        return HEIGHT - EDGE - (value - low) / spread * (HEIGHT - 2 * EDGE)

    def format_label(value: float) -> str:
        return f"{number(value)} {unit}".strip()

    points = []
    for k, (night, value) in enumerate(zip(data.nights, values, strict=True)):
        if value is not None:
            link = "" if night.run == data.record.run else data.report_of(night.run)
            state = night.verdict.level if night.verdict else ""
            points.append((EDGE + k * step, y(value), state, f"{night.date}: {format_label(value)}", link))
    median, last = sorted(known)[len(known) // 2], values[-1]
    latest = "–" if last is None else format_label(last)
    return Chart(title, latest, format_label(median), y(median), points)


def _megabytes(data: ReportData, night: RunRecord) -> float | None:
    folder = data.files if night.run == data.record.run else data.work.run(night.run).folder
    try:
        return sum(path.stat().st_size for path in folder.iterdir()) / 1e6
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

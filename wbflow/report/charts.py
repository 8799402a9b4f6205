"""Charts of the report: figures over the last nights, each camera's last nights, and the run times of tasks."""

from __future__ import annotations

import datetime
import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from ..outcome.baseline import appearance_of, figures_of
from ..pipeline.meanings import meaning, titled
from ..pipeline.stages import STAGES
from ..records.record import CameraRecord, RunRecord
from ..site.models import Measure
from ..task import Task
from ..words import number
from .data import ReportData, state_of

WIDTH, HEIGHT, EDGE = 260.0, 76.0, 8.0
SPARK_NIGHTS = 14
TIMETABLE_WIDTH = 1000.0
_MOST_ROWS = 64


def trends(data: ReportData) -> list[dict[str, Any]]:
    """Return a chart for each figure of the whole night."""
    nights, charts = data.nights, list[dict[str, Any] | None]()
    titles = {str(Measure.POINTS): "points in the cloud", str(Measure.PAIRS): "pairs that were used"}
    names = dict.fromkeys(name for night in nights for name in figures_of(night))
    for name in (name for name in names if name not in {stage.name for stage in STAGES}):  # stages follow, with own titles
        charts.append(_chart(data, titles.get(name, name), [figures_of(night).get(name) for night in nights]))
    fields = {(stage, name): None for night in nights for stage, result in night.results.items() for name in vars(result)}
    for stage, name in fields:
        values = [_as_number(getattr(night.results.get(stage), name, None)) for night in nights]
        scale, unit = (100, "%") if meaning(name).share else (1, "")
        charts.append(_chart(data, titled(name), [None if value is None else scale * value for value in values], unit))
    zones = {(stage, zone): None for night in nights for stage, result in night.results.items() for zone in result.volumes}
    for (stage, zone), change in itertools.product(zones, ("gained", "lost")):
        volumes = [result.volumes.get(zone) if (result := night.results.get(stage)) else None for night in nights]
        values = [None if part is None else float(getattr(part, change)) for part in volumes]
        charts.append(_chart(data, f"volume {change}{f', {zone}' if zone else ''}", values, "m³"))
    charts.append(_chart(data, "time", [night.seconds.wall for night in nights], "s"))
    charts.append(_chart(data, "CPU", [night.seconds.cpu for night in nights], "s"))
    charts.append(_chart(data, "size of the night's files", [_megabytes(data, night) for night in nights], "MB"))
    return [chart for chart in charts if chart]


def _chart(data: ReportData, title: str, values: Sequence[float | None], unit: str = "") -> dict[str, Any] | None:
    """Return the chart of a figure, oldest night first; None if fewer than two nights have it, or all values are 0.

    Its points are, for each night: x, y, verdict, label, and link to the report ("" for this night).
    """
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
    return {"title": title, "now": latest, "median": format_label(median), "median_y": y(median), "points": points}


def _as_number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


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
            if camera.id in bars:
                share = figures.get(camera.id, {}).get("matched_share", 1.0 if camera.ok else 0.0)
                label = f"{night.date}: {_camera_label(camera, share)}"
                bars[camera.id].append((state_of(camera, night), max(0.12, share), label))
    return bars


def _camera_label(camera: CameraRecord, share: float) -> str:
    if not camera.ok:
        return camera.reason or camera.outcome
    health = camera.health.state if camera.health and not camera.health.ok else "as it should be"
    return f"{health}, {100 * share:.0f} % of its pairs find common points"


def tasks_of_stages(data: ReportData) -> Iterator[tuple[str, Counter[str]]]:
    """Yield the name of each stage with the counts of its tasks' outcomes: ran, cached, rejected, failed, skipped."""
    counts: dict[str, Counter[str]] = {}
    for task, event in data.tasks.items():
        outcome = "cached" if event.usable and not (event.outcome == "ran" and event.fresh) else event.outcome
        counts.setdefault(task.stage, Counter())[outcome] += 1
    yield from ((stage.name, counts[stage.name]) for stage in STAGES if stage.name in counts)


def timetable(data: ReportData) -> dict[str, Any] | None:
    """Return when tasks ran this night; None if none did.  Tasks that ran at the same time are in different rows.

    Its bars are, for each task: the number of its stage, which gives the colour, row, x, width, and label.
    """
    numbers = {stage.name: k for k, stage in enumerate(STAGES)}
    ran: list[tuple[float, float, Task]] = []
    for task, event in data.tasks.items():
        receipt = data.cache.by_key(task, event.key) if event.fresh and event.key else None
        if receipt and receipt.finished:
            end = datetime.datetime.fromisoformat(receipt.finished).timestamp()
            ran.append((end - receipt.wall, end, task))
    if not ran:
        return None
    ran.sort(key=lambda entry: entry[0])
    first, last = ran[0][0], max(end for _, end, _ in ran)
    span = max(last - first, 1e-3)
    row_ends: list[float] = []
    bars = []
    for begin, end, task in ran:
        row = next((k for k, row_end in enumerate(row_ends) if row_end <= begin + 0.02), len(row_ends))
        if row >= _MOST_ROWS:
            continue
        row_ends[row : row + 1] = [end]
        title = f"{task}: {end - begin:.1f} s, from {begin - first:.1f} s on"
        width = max(1.0, (end - begin) / span * TIMETABLE_WIDTH)
        bars.append((numbers[task.stage], row, (begin - first) / span * TIMETABLE_WIDTH, width, title))
    shown_stages = {stage for stage, *_ in bars}
    stages = [(k, stage.name) for k, stage in enumerate(STAGES) if k in shown_stages]
    return {"bars": bars, "seconds": span, "rows": len(row_ends), "stages": stages}

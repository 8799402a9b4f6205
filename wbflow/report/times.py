"""Where the time went: stages, and when each task ran."""

from __future__ import annotations

import datetime
from collections import Counter
from dataclasses import dataclass

from ..cache.store import Receipt
from ..pipeline.stages import STAGES
from ..task import Task
from .sources import Sources

WIDTH, ROW = 1000.0, 16.0
_MOST_LANES = 64


@dataclass(frozen=True)
class StageTime:
    """A stage on one night."""

    name: str
    cached: int
    ran: int
    other: int
    """Rejected, failed or skipped."""
    wall: float
    cpu: float
    share: float
    """Of the CPU time of all."""


@dataclass(frozen=True)
class Work:
    """A task in the drawing."""

    stage: int
    """Number of its stage: its colour."""
    lane: int
    x: float
    width: float
    title: str


@dataclass(frozen=True)
class Timetable:
    """When tasks ran, one lane for each that ran at the same time."""

    works: tuple[Work, ...]
    lanes: int
    seconds: float
    height: float
    stages: tuple[tuple[int, str], ...]


def stage_times(sources: Sources) -> list[StageTime]:
    """Each stage that the night had."""
    counted: dict[str, Counter[str]] = {}
    for task, event in sources.tasks.items():
        kind = "ran" if event.outcome == "ran" and event.fresh else "cached" if event.usable else event.outcome
        counted.setdefault(task.stage, Counter())[kind] += 1
    spent = sources.record.seconds.stages
    total = sum(row.cpu for row in spent.values()) or 1.0
    found = []
    for stage in STAGES:
        if counts := counted.get(stage.name):
            row = spent.get(stage.name)
            other = counts.total() - counts["ran"] - counts["cached"]
            wall, cpu = (row.wall, row.cpu) if row else (0.0, 0.0)
            found.append(StageTime(stage.name, counts["cached"], counts["ran"], other, wall, cpu, cpu / total))
    return found


def timetable(sources: Sources) -> Timetable | None:
    """The tasks that ran this night; None where none did."""
    cache, numbers = sources.cache, {stage.name: k for k, stage in enumerate(STAGES)}
    ran: list[tuple[float, float, Task]] = []
    for task, event in sources.tasks.items():
        receipt = cache.by_key(task, event.key) if event.fresh and event.key else None
        if receipt and (end := _finished(receipt)):
            ran.append((end - receipt.wall, end, task))
    if not ran:
        return None
    ran.sort(key=lambda entry: entry[0])
    first, last = ran[0][0], max(end for _, end, _ in ran)
    span = max(last - first, 1e-3)
    free: list[float] = []
    works = []
    for begin, end, task in ran:
        lane = next((k for k, until in enumerate(free) if until <= begin + 0.02), len(free))
        if lane >= _MOST_LANES:
            continue
        free[lane : lane + 1] = [end]
        title = f"{task}: {end - begin:.1f} s, from {begin - first:.1f} s on"
        width = max(1.0, (end - begin) / span * WIDTH)
        works.append(Work(numbers[task.stage], lane, (begin - first) / span * WIDTH, width, title))
    shown = {work.stage for work in works}
    stages = tuple((k, stage.name) for k, stage in enumerate(STAGES) if k in shown)
    return Timetable(tuple(works), len(free), span, len(free) * ROW, stages)


def _finished(receipt: Receipt) -> float | None:
    try:
        return datetime.datetime.fromisoformat(receipt.finished).timestamp()
    except ValueError:
        return None

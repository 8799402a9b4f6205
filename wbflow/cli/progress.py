"""How far a run is, and how long it still takes: told by its events alone."""

from __future__ import annotations

import datetime
from collections import Counter
from dataclasses import dataclass, field

from ..records.events import Event, PlannedEvent, Signal, StartedEvent, TaskEvent
from ..task import Task

_TRUST = 3.0
"""What a stage took in earlier runs counts as much as so many of its tasks tonight."""
_TRUST_ROUGH = 0.3
"""The same, where nothing but a rough guess is known."""
_DOUBT = 1.0
"""So many seconds of compiling, as they were stated, count before it is seen what it takes tonight."""
_SLACK = 0.1
"""How much of all the work has to be done before tonight's pace counts as much as that of earlier runs."""


@dataclass
class StageProgress:
    """How far one stage is."""

    name: str
    tasks: int = 0
    done: int = 0
    seconds: float = 0.0
    """What a task was expected to take."""
    known: bool = False
    """By earlier runs?"""
    compiles: float = 0.0
    """What the first one was expected to take on top."""
    walls: list[float] = field(default_factory=list)
    """What tasks of tonight took, by the clock."""
    outcomes: dict[Task, str] = field(default_factory=dict)
    fresh: set[Task] = field(default_factory=set)
    """Tasks that were worked on tonight."""
    cpu: float = 0.0
    """Seconds that they took together."""
    told: bool = False
    """Has its end been told of?"""

    @property
    def left(self) -> int:
        return max(0, self.tasks - self.done)

    def counts(self) -> str:
        """Outcomes in words: 24 ran, 3 rejected."""
        counts = Counter(self.outcomes.values())
        return ", ".join(f"{counts[name]} {name}" for name in ("ran", "cached", "rejected", "failed", "skipped") if counts[name])


@dataclass
class Progress:
    """How far a run is."""

    stages: dict[str, StageProgress] = field(default_factory=dict)
    """In the order of the pipeline."""
    running: dict[Task, float] = field(default_factory=dict)
    """When each task that is in hand was begun (seconds since 1970)."""
    workers: int = 1
    planned: bool = False
    """Is it known what there is to do?"""

    def add(self, event: Event | Signal) -> list[StageProgress]:
        """Take an event in; returns the stages that have come to their end with it, where there was something to do."""
        if isinstance(event, PlannedEvent):
            return self._plan(event)
        if isinstance(event, StartedEvent):
            self.running[event.task] = _seconds(event.at)
        elif isinstance(event, TaskEvent):
            stage = self.stages.setdefault(event.task.stage, StageProgress(event.task.stage))
            begun = self.running.pop(event.task, None)
            if event.fresh:
                stage.fresh.add(event.task)
                stage.cpu += event.cpu or 0.0
                if begun is not None and event.outcome in {"ran", "rejected"}:
                    stage.walls.append(max(0.0, _seconds(event.at) - begun))
            stage.done += event.task not in stage.outcomes
            stage.outcomes[event.task] = event.outcome
        return []

    @property
    def totals(self) -> tuple[int, int]:
        """Tasks that are done, and all."""
        return sum(stage.done for stage in self.stages.values()), sum(stage.tasks for stage in self.stages.values())

    def seconds_left(self, now: float) -> float | None:
        """How long the run still works, by the clock; None where it is not known yet what there is to do.

        Each stage's tasks take what they took in earlier runs, as much quicker or slower as tonight's have been until now, and
        more and more what they take tonight; a stage has as many workers as it has tasks, at most all.  Where nobody has timed a
        stage yet, its first task takes longer, and the others wait for what it compiles: as much as was stated, and as much more
        or less as the stages before it have taken.

        now: seconds since 1970.
        """
        if not self.planned:
            return None
        pace = {known: self._pace(known) for known in (True, False)}
        compiling = self._compiling(pace[False])
        total = 0.0
        for stage in self.stages.values():
            if not stage.left:
                continue
            total += self._seconds_of(stage, now, self._each(stage, pace[stage.known]), compiling)
        return total

    def _seconds_of(self, stage: StageProgress, now: float, each: float, compiling: float) -> float:
        """How long a stage still works.

        Parameters
        ----------
        stage : StageProgress
            With something left to do.
        now : float
            Seconds since 1970.
        each : float
            What one of its tasks takes.
        compiling : float
            How much longer compiling takes than was stated.
        """
        workers = min(self.workers, stage.left)
        begun = [now - since for task, since in self.running.items() if task.stage == stage.name][: stage.left]
        if stage.compiles and not stage.walls:  # whoever has one in hand compiles, or waits for who does
            first = compiling * stage.compiles
            rest = (stage.left - len(begun)) * each / workers
            return rest + (_to_go(max(begun), each + first) if begun else first)
        if stage.compiles and len(stage.walls) < self.workers:  # these waited
            begun = [min(age, each) for age in begun]
        return ((stage.left - len(begun)) * each + sum(_to_go(age, each) for age in begun)) / workers

    def _plan(self, event: PlannedEvent) -> list[StageProgress]:
        self.planned, self.workers = True, event.workers
        before = self.stages
        self.stages = {row.stage: before.get(row.stage, StageProgress(row.stage)) for row in event.stages}
        ended, earlier = [], True  # a stage has all its tasks when those before it have ended: they may bring more
        for row in event.stages:
            stage = self.stages[row.stage]
            stage.tasks, stage.done, stage.seconds, stage.known = row.tasks, row.settled, row.seconds, row.known
            stage.compiles = row.compiles
            if stage.fresh and earlier and not (stage.left or stage.told):
                stage.told = True
                ended.append(stage)
            earlier = earlier and not stage.left
        return ended

    def _pace(self, known: bool) -> float:
        """How much longer tasks take tonight than was expected of them."""
        of_kind = [stage for stage in self.stages.values() if stage.known == known]
        took = sum(sum(self._telling(stage)) for stage in of_kind)
        expected = sum(len(self._telling(stage)) * stage.seconds for stage in of_kind)
        slack = _SLACK * sum(stage.tasks * stage.seconds for stage in of_kind) if known else 0.0
        return (took + slack) / (expected + slack) if expected + slack > 0 else 1.0

    def _compiling(self, pace: float) -> float:
        """How much longer compiling takes tonight than was stated; next to nothing where it had been done before."""
        seen = [stage for stage in self.stages.values() if stage.compiles and stage.walls]
        took = sum(max(0.0, stage.walls[0] - self._each(stage, pace)) for stage in seen)
        return (took + _DOUBT) / (sum(stage.compiles for stage in seen) + _DOUBT)

    def _each(self, stage: StageProgress, pace: float) -> float:
        """What one of a stage's tasks to come takes."""
        trust, walls = _TRUST if stage.known else _TRUST_ROUGH, self._telling(stage)
        return (sum(walls) + trust * stage.seconds * pace) / (len(walls) + trust)

    def _telling(self, stage: StageProgress) -> list[float]:
        """What tasks took that tell of those to come: in a first run not each worker's first, which compiles, too."""
        few = stage.tasks <= self.workers and not stage.compiles
        first = 0 if stage.known or few else self.workers
        return stage.walls[first:]


def _to_go(age: float, each: float) -> float:
    """Seconds that a task at work still takes: the longer it has taken than was expected, the longer it may still take."""
    return max(each - age, 0.1 * each, 0.25 * (age - each))


def _seconds(at: str) -> float:
    return datetime.datetime.fromisoformat(at).timestamp()


def in_words(seconds: float) -> str:
    """A span of time as people say it: 40 s, 3 min, 2 h 10 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"

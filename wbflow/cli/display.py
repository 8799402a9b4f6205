"""What a run shows while it works: a live table on a terminal, one line for each finished stage in a log file."""

from __future__ import annotations

import datetime
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..errors import printable
from ..records.events import CapturesEvent, Event, PlannedEvent, Signal, StartedEvent, TaskEvent, WarningEvent
from ..task import Task
from .common import LONGEST_TEXT, echo

if TYPE_CHECKING:
    from rich.console import Group

HEARTBEAT_SECONDS = 300.0
"""A log file gets a line at least this often."""
MOST_RUNNING = 6
"""Running tasks that the live table names."""
MOST_REJECTED = 8
"""Rejections of a stage that are printed with their reason; with -v all are."""
_PRIOR = {True: 3.0, False: 0.3}
"""How many of tonight's tasks an expectation weighs: one that earlier runs measured, and a rough guess."""


@contextmanager
def display(site: str, verbose: bool = False, quiet: bool = False) -> Iterator[Display]:
    """Yield the display that suits stderr; whatever it has drawn is gone at the end.

    verbose: print every task with its seconds, and tracebacks.  quiet: print warnings only; findings follow at the end.
    """
    if quiet:
        yield Display(site, verbose, quiet=True)
    elif sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
        with LiveTable(site, verbose) as table:
            yield table
    else:
        with LogLines(site, verbose) as lines:
            yield lines


class Display:
    """Prints messages about single events, and keeps the progress."""

    def __init__(self, site: str, verbose: bool = False, quiet: bool = False) -> None:
        self.site = site
        self.progress = Progress()
        self.lock = threading.Lock()
        self._verbose, self._quiet = verbose, quiet
        self._rejected: Counter[str] = Counter()

    def receive(self, event: Event | Signal) -> None:
        """Show an event."""
        with self.lock:
            ended = self.progress.add(event)
            lines = self._messages(event)
        for line, is_fault in lines:
            self.print(line, is_fault)
        for stage in ended:
            self.stage_ended(stage)

    def print(self, line: str, is_fault: bool = False) -> None:
        """Print a line; of a fault to stderr."""
        echo(line, err=is_fault)

    def stage_ended(self, stage: StageProgress) -> None:
        """Show that a stage has done all its tasks."""

    def _messages(self, event: Event | Signal) -> list[tuple[str, bool]]:
        """Return the lines to print for an event, each with whether it is a fault."""
        if isinstance(event, WarningEvent):
            lines = [(f"warning: {event}", True)]
        elif isinstance(event, TaskEvent) and self._is_printed(event):
            subject = "--".join(event.task.subject) or self.site
            took = f"{event.cpu:.1f} s" if self._verbose and event.cpu is not None else ""
            line = f"{subject:20} {event.task.stage:10} {event.outcome:9} {event.reason or took}"
            lines = [(line.rstrip(), event.outcome == "failed")]
        else:
            return []
        return [*lines, (event.trace, True)] if event.trace and self._verbose else lines

    def _is_printed(self, event: TaskEvent) -> bool:
        if self._verbose or self._quiet:
            return self._verbose
        if event.outcome == "rejected":
            self._rejected[event.task.stage] += 1
            return self._rejected[event.task.stage] <= MOST_REJECTED
        return event.outcome == "failed"


class LogLines(Display):
    """For files: a time-stamped line for each message and each stage that ends, and a heartbeat in between."""

    def __init__(self, site: str, verbose: bool = False, heartbeat: float = HEARTBEAT_SECONDS) -> None:
        super().__init__(site, verbose)
        self._heartbeat = heartbeat
        self._printed = time.monotonic()
        self._over = threading.Event()
        self._clock = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> LogLines:
        self._clock.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._clock.join()

    def print(self, line: str, is_fault: bool = False) -> None:
        echo(f"{datetime.datetime.now():%Y-%m-%dT%H:%M:%S} {line}", err=is_fault)
        self._printed = time.monotonic()

    def stage_ended(self, stage: StageProgress) -> None:
        self.print(f"{stage.name}: {stage.done} of {stage.tasks} done: {stage.counts()}; {stage.cpu:.1f} CPU s")

    def _beat(self) -> None:
        while not self._over.wait(max(0.0, self._printed + self._heartbeat - time.monotonic())):
            if time.monotonic() - self._printed >= self._heartbeat:
                with self.lock:
                    summary, running = self.progress.summary(), ", ".join(self.progress.running_tasks())
                self.print(summary + (f"; running: {running}" if running else ""))


class LiveTable(Display):
    """For terminals: stages with their progress, running tasks and the time left; messages scroll by above."""

    def __init__(self, site: str, verbose: bool = False) -> None:
        from rich.console import Console
        from rich.live import Live

        super().__init__(site, verbose)
        self._console = Console(stderr=True, highlight=False)
        self._live = Live(
            get_renderable=self._render, console=self._console, transient=True, redirect_stdout=False, redirect_stderr=False
        )

    def __enter__(self) -> LiveTable:
        self._live.start(refresh=True)
        return self

    def __exit__(self, *error: object) -> None:
        self._live.stop()

    def print(self, line: str, is_fault: bool = False) -> None:
        if is_fault or sys.stdout.isatty():
            self._console.print(printable(line, LONGEST_TEXT), markup=False, soft_wrap=True)
        else:
            echo(line)

    def _render(self) -> Group:
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        table = Table.grid(padding=(0, 2, 0, 0))
        table.add_column(min_width=10, no_wrap=True)
        table.add_column(width=24)
        table.add_column(justify="right", no_wrap=True)
        table.add_column(no_wrap=True, overflow="ellipsis", style="dim")
        with self.lock:
            progress = self.progress
            for stage in visible_stages(list(progress.stages.values()), max(3, self._console.height - MOST_RUNNING - 3)):
                bar = ProgressBar(total=max(1, stage.tasks), completed=stage.done, width=24)
                table.add_row(stage.name, bar, f"{stage.done}/{stage.tasks}", stage.counts())
            running, summary = progress.running_tasks("{}  {}")[:MOST_RUNNING], progress.summary()
        if not progress.planned:
            summary = f"{printable(self.site)}: {summary}"
        lines = [(f"  {printable(task)}", "dim") for task in running] + [(summary, "bold")]
        return Group(table, *(Text(line, style, no_wrap=True, overflow="ellipsis") for line, style in lines))


@dataclass
class StageProgress:
    """Progress of one stage."""

    name: str
    tasks: int = 0
    done: int = 0
    expected_seconds: float = 0.0
    """Expected for each task, by the clock."""
    measured: bool = False
    """Whether earlier runs measured that."""
    compile_seconds: float = 0.0
    """What the first task may take on top."""
    walls: list[float] = field(default_factory=list)
    """Seconds that tasks have taken tonight, by the clock."""
    outcomes: dict[Task, str] = field(default_factory=dict)
    cpu: float = 0.0
    """Seconds that its tasks took together."""
    fresh: bool = False
    """Whether tonight has worked on it, and its end has not been reported."""

    @property
    def left(self) -> int:
        return max(0, self.tasks - self.done)

    def counts(self) -> str:
        """Return the outcomes: "24 ran, 3 rejected"."""
        counts = Counter(self.outcomes.values())
        return ", ".join(f"{counts[name]} {name}" for name in ("ran", "cached", "rejected", "failed", "skipped") if counts[name])


@dataclass
class Progress:
    """Progress of a run, from its events alone."""

    stages: dict[str, StageProgress] = field(default_factory=dict)
    """In the order of the pipeline."""
    running: dict[Task, float] = field(default_factory=dict)
    """When each running task began (seconds since 1970)."""
    workers: int = 1
    planned: bool = False
    """Whether the plan is known."""
    captures_read: str = ""
    """How many captures have been read so far."""
    begun: float = field(default_factory=time.monotonic)

    def add(self, event: Event | Signal) -> list[StageProgress]:
        """Take in an event; returns the stages that end with it and had something to do."""
        if isinstance(event, PlannedEvent):
            return self._plan(event)
        if isinstance(event, CapturesEvent):
            left = duration((time.monotonic() - self.begun) * (event.of - event.cameras) / max(1, event.cameras))
            self.captures_read = f"captures of {event.cameras}/{event.of} cameras read; the plan in about {left}"
        elif isinstance(event, StartedEvent):
            self.running[event.task] = _seconds(event.at)
        elif isinstance(event, TaskEvent):
            stage = self.stages.setdefault(event.task.stage, StageProgress(event.task.stage))
            begun = self.running.pop(event.task, None)
            if event.fresh:
                stage.fresh = True
                stage.cpu += event.cpu or 0.0
                if begun is not None and event.outcome in {"ran", "rejected"}:
                    stage.walls.append(max(0.0, _seconds(event.at) - begun))
            stage.done += event.task not in stage.outcomes
            stage.outcomes[event.task] = event.outcome
        return []

    def _plan(self, event: PlannedEvent) -> list[StageProgress]:
        self.planned, self.workers = True, event.workers
        self.stages = {row.stage: self.stages.get(row.stage, StageProgress(row.stage)) for row in event.stages}
        ended, earlier_ended = [], True  # a stage knows all its tasks when the stages before it have ended
        for row in event.stages:
            stage = self.stages[row.stage]
            stage.tasks, stage.done, stage.expected_seconds, stage.measured = row.tasks, row.settled, row.seconds, row.known
            stage.compile_seconds = row.compiles
            earlier_ended = earlier_ended and not stage.left
            if stage.fresh and earlier_ended:
                stage.fresh = False
                ended.append(stage)
        return ended

    def running_tasks(self, form: str = "{} ({})") -> list[str]:
        """Return the running tasks and for how long each has run, in this form."""
        now = time.time()
        return [form.format(task, duration(max(0.0, now - since))) for task, since in self.running.items()]

    @property
    def totals(self) -> tuple[int, int]:
        """Tasks that are done, and all tasks."""
        return sum(stage.done for stage in self.stages.values()), sum(stage.tasks for stage in self.stages.values())

    def summary(self) -> str:
        """Return the progress in one line."""
        left, (done, tasks) = self.seconds_left(time.time()), self.totals
        if left is None:
            return self.captures_read or "looking for what is to be done"
        if done >= tasks:
            return f"{done} of {tasks} tasks done; publishing the run"
        until = datetime.datetime.now() + datetime.timedelta(seconds=left)
        return f"{done} of {tasks} tasks done; ETA {until:%H:%M}, about {duration(left)} left"

    def seconds_left(self, now: float) -> float | None:
        """Estimate the seconds that the run still takes; None before the plan is known.  now: seconds since 1970.

        A task of a stage takes what it took in earlier runs, scaled by tonight's pace, and more and more the mean of tonight's.
        Where no run has measured a stage yet, its first task compiles while the others wait.
        """
        if not self.planned:
            return None
        compile_pace = self._compile_pace()
        return sum(self._stage_seconds(stage, now, compile_pace) for stage in self.stages.values() if stage.left)

    def _stage_seconds(self, stage: StageProgress, now: float, compile_pace: float) -> float:
        workers, each = min(self.workers, stage.left), self._task_seconds(stage)
        ages = [now - since for task, since in self.running.items() if task.stage == stage.name][: stage.left]
        waiting = (stage.left - len(ages)) * each / workers
        if not stage.compile_seconds or stage.walls:
            return waiting + sum(_remaining(age, each) for age in ages) / workers
        first = compile_pace * stage.compile_seconds
        return waiting + (_remaining(max(ages), each + first) if ages else first)

    def _task_seconds(self, stage: StageProgress) -> float:
        prior, walls = _PRIOR[stage.measured], self._typical_walls(stage)
        return (sum(walls) + prior * stage.expected_seconds * self._pace(stage.measured)) / (len(walls) + prior)

    def _pace(self, measured: bool) -> float:
        """Return how many times longer tasks take tonight than expected; a tenth of all that was measured counts as on time."""
        stages = [stage for stage in self.stages.values() if stage.measured == measured]
        took = sum(sum(self._typical_walls(stage)) for stage in stages)
        expected = sum(len(self._typical_walls(stage)) * stage.expected_seconds for stage in stages)
        on_time = 0.1 * sum(stage.tasks * stage.expected_seconds for stage in stages) if measured else 0.0
        return (took + on_time) / (expected + on_time) if expected + on_time > 0 else 1.0

    def _compile_pace(self) -> float:
        """Return how many times longer compiling takes tonight than stated; next to 0 where it had been done before."""
        compiled = [stage for stage in self.stages.values() if stage.compile_seconds and stage.walls]
        took = sum(max(0.0, stage.walls[0] - self._task_seconds(stage)) for stage in compiled)
        return (took + 1.0) / (sum(stage.compile_seconds for stage in compiled) + 1.0)

    def _typical_walls(self, stage: StageProgress) -> list[float]:
        """Return the seconds of tasks without, in a first run, each worker's first, which compiles too."""
        few = stage.tasks <= self.workers and not stage.compile_seconds
        return stage.walls[0 if stage.measured or few else self.workers :]


def visible_stages(stages: list[StageProgress], room: int) -> list[StageProgress]:
    """Return the stages that fit on a low terminal: from the last that has ended."""
    first = next((i for i, stage in enumerate(stages) if stage.left), len(stages))
    start = max(0, min(first - 1, len(stages) - room))
    return stages[start : start + room]


def duration(seconds: float) -> str:
    """Return a span of time for people: 40 s, 3 min, 2 h 10 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def _remaining(age: float, each: float) -> float:
    """Return the seconds that a running task still takes: the longer it is overdue, the longer it may still take."""
    return max(each - age, 0.1 * each, 0.25 * (age - each))


def _seconds(at: str) -> float:
    return datetime.datetime.fromisoformat(at).timestamp()

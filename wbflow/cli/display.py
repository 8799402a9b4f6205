"""Progress display of a run: a live table on a terminal, or one line for each finished stage in a log file."""

from __future__ import annotations

import datetime
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..records.events import Event, OutputEvent, PlannedEvent, Signal, StartedEvent, TaskEvent, WarningEvent
from ..task import Task
from ..words import printable
from .common import LONGEST_TEXT, echo

if TYPE_CHECKING:
    from rich.progress import TaskID

PROGRESS_SECONDS = 300.0
"""After this many seconds without output, a log file gets a line on the progress, at the next event."""
MOST_REJECTED = 8
"""Number of rejections per stage that are printed with their reason; with -v all are printed."""


@contextmanager
def display(site: str, verbose: bool = False, quiet: bool = False) -> Iterator[Display]:
    """Yield the display that suits stderr.  A live table is erased at the end.

    verbose: print every task with its seconds, and tracebacks.  quiet: print warnings only; the caller prints the findings later.
    """
    if quiet:
        yield Display(site, verbose, quiet=True)
    elif sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
        with LiveTable(site, verbose) as table:
            yield table
    else:
        yield LogLines(site, verbose)


@dataclass
class StageProgress:
    """Progress of one stage."""

    name: str
    tasks: int = 0
    outcomes: dict[Task, str] = field(default_factory=dict)
    cpu: float = 0.0
    """Total CPU seconds of its tasks in this run."""
    fresh: bool = False
    """Whether this run has worked on the stage and has not reported its end yet."""

    @property
    def done(self) -> int:
        return len(self.outcomes)

    def counts(self) -> str:
        """Return the number of tasks by outcome: "24 ran, 3 rejected"."""
        counts = Counter(self.outcomes.values())
        known = [name for name in ("ran", "cached", "rejected", "failed", "skipped") if counts[name]]
        return ", ".join(f"{counts[name]} {name}" for name in known)


class Display:
    """Prints messages about single events, and tracks the progress."""

    def __init__(self, site: str, verbose: bool = False, quiet: bool = False) -> None:
        self.site = site
        self.stages: dict[str, StageProgress] = {}
        """By name, in the order of the pipeline."""
        self.running: dict[Task, None] = {}
        self._verbose, self._quiet = verbose, quiet
        self._rejections: Counter[str] = Counter()

    def receive(self, event: Event | Signal) -> None:
        """Show an event."""
        if isinstance(event, OutputEvent):  # for the log alone
            return
        if isinstance(event, PlannedEvent):
            self._plan(event)
        elif isinstance(event, StartedEvent):
            self.running[event.task] = None
        elif isinstance(event, WarningEvent):
            self.print(f"warning: {event}", is_fault=True)
        else:
            self._count(event)
            if self._is_printed(event):
                subject = "--".join(event.task.subject) or self.site
                words = event.reason or ""
                if not words and self._verbose and event.cpu is not None:
                    words = f"{event.cpu:.1f} s"
                line = f"{subject:20} {event.task.stage:10} {event.outcome:9} {words}"
                self.print(line.rstrip(), is_fault=event.outcome == "failed")
        if self._verbose and isinstance(event, Event) and event.trace:
            self.print(event.trace, is_fault=True)
        self.update()

    def print(self, line: str, is_fault: bool = False) -> None:
        """Print a line, to stderr if it reports a fault."""
        echo(line, err=is_fault)

    def stage_ended(self, stage: StageProgress) -> None:
        """Show that a stage has done all its tasks."""

    def update(self) -> None:
        """Show the progress."""

    @property
    def totals(self) -> tuple[int, int]:
        """Number of finished tasks, and of all known tasks."""
        done = sum(stage.done for stage in self.stages.values())
        known = sum(stage.tasks for stage in self.stages.values())
        return done, known

    def _plan(self, event: PlannedEvent) -> None:
        """Update the number of tasks, and show the stages that have ended since the last call and had work to do in this run."""
        self.stages = {name: self.stages.get(name, StageProgress(name)) for name in event.tasks}
        earlier_ended = True  # all tasks of a stage are known only once the stages before it have ended
        for name, stage in self.stages.items():
            stage.tasks = event.tasks[name]
            earlier_ended = earlier_ended and stage.done >= stage.tasks
            if stage.fresh and earlier_ended:
                stage.fresh = False
                self.stage_ended(stage)

    def _count(self, event: TaskEvent) -> None:
        self.running.pop(event.task, None)
        stage = self.stages.setdefault(event.task.stage, StageProgress(event.task.stage))
        stage.outcomes[event.task] = event.outcome
        if event.fresh:
            stage.fresh = True
            stage.cpu += event.cpu or 0.0

    def _is_printed(self, event: TaskEvent) -> bool:
        if self._verbose or self._quiet:
            return self._verbose
        if event.outcome == "rejected":
            self._rejections[event.task.stage] += 1
            return self._rejections[event.task.stage] <= MOST_REJECTED
        return event.outcome == "failed"


class LogLines(Display):
    """Display for log files: a time-stamped line for each message, each stage that ends and, now and then, the progress."""

    def __init__(self, site: str, verbose: bool = False) -> None:
        super().__init__(site, verbose)
        self._last_output = time.monotonic()

    def print(self, line: str, is_fault: bool = False) -> None:
        echo(f"{datetime.datetime.now():%Y-%m-%dT%H:%M:%S} {line}", err=is_fault)
        self._last_output = time.monotonic()

    def stage_ended(self, stage: StageProgress) -> None:
        self.print(f"{stage.name}: {stage.done} of {stage.tasks} done: {stage.counts()}; {stage.cpu:.1f} CPU s")

    def update(self) -> None:
        if time.monotonic() - self._last_output >= PROGRESS_SECONDS:
            done, tasks = self.totals
            self.print(f"{done} of {tasks} tasks done; running: {', '.join(map(str, self.running))}")


class LiveTable(Display):
    """Display for terminals: overall progress, running tasks, and a bar for each stage that has begun; messages scroll above."""

    def __init__(self, site: str, verbose: bool = False) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
        from rich.table import Column

        super().__init__(site, verbose)
        one_line = Column(no_wrap=True, overflow="ellipsis", ratio=1)
        self._bars = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(16, table_column=Column(min_width=16)),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[text]}", style="dim", markup=False, table_column=one_line),
            console=Console(stderr=True, highlight=False),
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
            expand=True,
        )
        self._rows: dict[str, TaskID] = {}
        self._overall = self._bars.add_task(printable(site), total=None, text="planning the run")

    def __enter__(self) -> LiveTable:
        self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()

    def print(self, line: str, is_fault: bool = False) -> None:
        if is_fault or sys.stdout.isatty():
            self._bars.console.print(printable(line, LONGEST_TEXT), markup=False, soft_wrap=True)
        else:
            echo(line)

    def update(self) -> None:
        for name, stage in self.stages.items():
            if name not in self._rows and (stage.done or any(task.stage == name for task in self.running)):
                self._rows[name] = self._bars.add_task(name, text="")
            if name in self._rows:
                self._bars.update(self._rows[name], total=stage.tasks, completed=stage.done, text=stage.counts())
        if self.stages:
            done, tasks = self.totals
            text = "publishing the run"
            if done < tasks:
                text = printable(", ".join(map(str, self.running)))
            self._bars.update(self._overall, total=tasks, completed=done, text=text)

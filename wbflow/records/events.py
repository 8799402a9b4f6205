"""What happens in a run, as typed events: the lines of its log, and what listeners receive."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ..task import Task


def now() -> str:
    """The time stamp of an event."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")


@dataclass(frozen=True)
class TaskEvent:
    """A task has ended."""

    task: Task
    outcome: str
    """cached, ran, rejected, failed or skipped."""
    at: str
    """When, ISO 8601, UTC."""
    fresh: bool = False
    """Has it been worked on in this run?"""
    reason: str | None = None
    """Why, in words, for all but cached and ran."""
    code: str | None = None
    """Why, as one word that can be counted, where the task gave one."""
    key: str | None = None
    """Under which the cache keeps its artifact."""
    cpu: float | None = None
    """Seconds, where it ran."""
    trace: str | None = None
    """Traceback of a fault that nobody foresaw."""

    @property
    def usable(self) -> bool:
        """Did it leave an artifact?"""
        return self.outcome in {"cached", "ran"} and self.key is not None

    def to_json(self) -> dict[str, Any]:
        """A line of the log."""
        return {
            "event": "task",
            "at": self.at,
            "task": str(self.task),
            "stage": self.task.stage,
            "subject": list(self.task.subject),
            "outcome": self.outcome,
            "fresh": self.fresh,
            "reason": self.reason,
            "code": self.code,
            "key": self.key,
            "cpu": self.cpu,
            "trace": self.trace,
        }


@dataclass(frozen=True)
class WarningEvent:
    """Something that the operator should know of, and that the run has survived: a picture that was not drawn, an artifact made
    again, a ledger that was not written, a word of the site file that is out of date."""

    what: str
    """What, in one line."""
    at: str
    """When, ISO 8601, UTC."""
    task: Task | None = None
    """The task that it happened to, if any."""
    remedy: str = ""
    """What to do about it, where something can be done."""
    trace: str | None = None
    """Traceback of a fault that nobody foresaw."""
    repaired: bool = False
    """Was it damage on disk that has been put right?"""

    def __str__(self) -> str:
        head = f"{self.task}: {self.what}" if self.task else self.what
        return f"{head}; {self.remedy}" if self.remedy else head

    def to_json(self) -> dict[str, Any]:
        """A line of the log."""
        subject = {"task": str(self.task), "stage": self.task.stage, "subject": list(self.task.subject)} if self.task else {}
        rest = {"what": self.what, "remedy": self.remedy, "trace": self.trace, "repaired": self.repaired}
        return {"event": "warning", "at": self.at, **subject, **rest}


@dataclass(frozen=True)
class StageOutlook:
    """What is to be done of a stage, as far as is known."""

    stage: str
    tasks: int
    """In all: those that are known of, or, before the pair graph is there, about so many."""
    settled: int
    seconds: float
    """What one of the tasks to come takes by the clock: by the last runs, else roughly."""
    known: bool
    """Is that what the last runs took?"""
    compiles: float = 0.0
    """What its first task may take on top, where nobody has timed the stage: its kernels may have to be compiled."""


@dataclass(frozen=True)
class PlannedEvent:
    """What is to be done was looked at anew; for whoever watches, and in no log."""

    stages: tuple[StageOutlook, ...]
    """In the order of the pipeline."""
    workers: int
    """Tasks that are done at once."""
    at: str
    """When, ISO 8601, UTC."""


@dataclass(frozen=True)
class StartedEvent:
    """A worker has a task in hand; for whoever watches, and in no log."""

    task: Task
    at: str
    """When, ISO 8601, UTC."""


@dataclass(frozen=True)
class CapturesEvent:
    """Captures were looked at; for whoever watches, and in no log."""

    cameras: int
    """So many have been done."""
    of: int
    """All."""


Event = TaskEvent | WarningEvent
"""What a log keeps."""

Signal = CapturesEvent | PlannedEvent | StartedEvent
"""For whoever watches a run, and in no log."""

Listener = Callable[[Event], None]
"""Receives every event as it happens."""


Watcher = Callable[[Signal], None]
"""Receives what is planned and begun, too."""


def event_from_json(line: Mapping[str, Any]) -> Event | None:
    """An event as the log has it; None for a kind of a later version.  Raises KeyError."""
    task = Task(line["stage"], tuple(line["subject"])) if "stage" in line else None
    if line.get("event") == "warning":
        return WarningEvent(line["what"], line["at"], task, line.get("remedy", ""), line.get("trace"), bool(line.get("repaired")))
    if line.get("event") != "task" or task is None:
        return None
    optional = {name: line.get(name) for name in ("reason", "code", "key", "cpu", "trace")}
    return TaskEvent(task, line["outcome"], line["at"], bool(line.get("fresh")), **optional)

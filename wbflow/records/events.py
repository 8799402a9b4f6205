"""What happens in a run, as typed events: the lines of its log, and what listeners receive."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
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


@dataclass(frozen=True)
class PlannedEvent:
    """What is to be done was looked at again; for whoever watches, and in no log."""

    tasks: Mapping[str, int]
    """How many tasks each stage has, as far as they are known, in the order of the pipeline."""


@dataclass(frozen=True)
class StartedEvent:
    """A worker has begun a task; for whoever watches, and in no log."""

    task: Task


Event = TaskEvent | WarningEvent
"""What a log keeps."""

Signal = PlannedEvent | StartedEvent
"""For whoever watches a run, and in no log."""

Listener = Callable[[Event | Signal], None]
"""Receives every event as it happens, and what is planned and begun."""


_KINDS: dict[str, type[Event]] = {"task": TaskEvent, "warning": WarningEvent}


def event_to_json(event: Event) -> dict[str, Any]:
    """Return a line of the log."""
    task = event.task
    whose = {"task": str(task), "stage": task.stage, "subject": task.subject} if task else {}
    return {"event": next(name for name, kind in _KINDS.items() if isinstance(event, kind)), **vars(event), **whose}


def event_from_json(line: Mapping[str, Any]) -> Event | None:
    """Return an event as the log has it; None for a kind of a later version.  Raises KeyError, TypeError."""
    if (kind := _KINDS.get(line["event"])) is None:
        return None
    known = {field.name: line[field.name] for field in fields(kind) if field.name in line}
    return kind(**known | {"task": Task(line["stage"], tuple(line["subject"])) if "stage" in line else None})

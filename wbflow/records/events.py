"""Typed events of a run: the lines of its log, and what listeners receive."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from ..task import Task


def now() -> str:
    """Return the current time as the time stamp of an event."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")


@dataclass(frozen=True)
class TaskEvent:
    """A task has ended."""

    task: Task
    outcome: str
    """cached, ran, rejected, failed or skipped."""
    at: str
    """Time of the event, ISO 8601, UTC."""
    fresh: bool = False
    """Was the task worked on in this run?"""
    reason: str | None = None
    """Reason for the outcome, in words; None for cached and ran."""
    code: str | None = None
    """The reason as one word, for statistics, if the task gave one."""
    key: str | None = None
    """Cache key of its artifact."""
    cpu: float | None = None
    """CPU time in seconds, if it ran."""
    trace: str | None = None
    """Traceback of an unexpected error."""

    @property
    def usable(self) -> bool:
        """Is there an artifact?"""
        return self.outcome in {"cached", "ran"} and self.key is not None


@dataclass(frozen=True)
class WarningEvent:
    """A problem that did not stop the run but that the operator should know of: a failed drawing, an artifact that was made
    again, a ledger that was not written, an obsolete word in the site file."""

    what: str
    """The problem, in one line."""
    at: str
    """Time of the event, ISO 8601, UTC."""
    task: Task | None = None
    """The task concerned, if any."""
    remedy: str = ""
    """What to do about it; "" if nothing can be done."""
    trace: str | None = None
    """Traceback of an unexpected error."""
    repaired: bool = False
    """Was it damage on disk that has been repaired?"""

    def __str__(self) -> str:
        text = self.what
        if self.task:
            text = f"{self.task}: {text}"
        if self.remedy:
            text += f"; {self.remedy}"
        return text


@dataclass(frozen=True)
class OutputEvent:
    """What a task, or a library that it uses, has printed.  Logged, and not sent to listeners."""

    task: Task | None
    """None if it was printed in the process of the run, where tasks run side by side in threads."""
    what: str
    """The text; line ends are escaped."""
    at: str
    """Time of the end of the task's chain, or of the run, ISO 8601, UTC."""


@dataclass(frozen=True)
class PlannedEvent:
    """The plan was updated.  Sent to listeners only, not logged."""

    tasks: Mapping[str, int]
    """Number of known tasks of each stage, in the order of the pipeline."""


@dataclass(frozen=True)
class StartedEvent:
    """A worker has begun a task.  Sent to listeners only, not logged."""

    task: Task


Event = TaskEvent | WarningEvent | OutputEvent
"""An event that is logged."""

Signal = PlannedEvent | StartedEvent
"""An event for listeners only, which is not logged."""

Listener = Callable[[Event | Signal], None]
"""Receives every event and signal as it happens."""


_KINDS: dict[str, type[Event]] = {"task": TaskEvent, "warning": WarningEvent, "output": OutputEvent}


def event_to_json(event: Event) -> dict[str, Any]:
    """Return an event as a line of the log, before JSON encoding."""
    line: dict[str, Any] = {}
    for name, kind in _KINDS.items():
        if isinstance(event, kind):
            line["event"] = name
    line |= vars(event)
    if event.task:
        # the name for people, its parts for programs
        line |= {"task": str(event.task), "stage": event.task.stage, "subject": event.task.subject}
    return line


def event_from_json(line: Mapping[str, Any]) -> Event | None:
    """Return the event of a log line; None for a kind that only later versions know.  Raises KeyError, TypeError."""
    kind = _KINDS.get(line["event"])
    if kind is None:
        return None
    # fields that an earlier version did not have keep their defaults
    values = {field.name: line[field.name] for field in fields(kind) if field.name in line}
    values["task"] = None
    if "stage" in line:
        values["task"] = Task(line["stage"], tuple(line["subject"]))
    return kind(**values)

"""What is said of single events of a run, in lines."""

from __future__ import annotations

from ..records.events import Event, Signal, TaskEvent, WarningEvent
from .words import say

MOST_REJECTED = 8
"""So many rejections of a stage are said with their reasons, unless -v is given; the others are counted."""


class Words:
    """What is said of single events, in lines."""

    def __init__(self, site: str, verbose: bool, quiet: bool = False) -> None:
        self.site = site
        self.verbose = verbose
        self._quiet = quiet
        self._rejected: dict[str, int] = {}

    def hear(self, event: Event | Signal) -> None:
        """Say what there is to say of an event."""
        for line, fault in self.of(event):
            say(line, err=fault)

    def of(self, event: Event | Signal) -> list[tuple[str, bool]]:
        """What there is to say of an event: lines, and whether something is wrong (then they go to stderr)."""
        if isinstance(event, WarningEvent):
            said = [(f"warning: {event}", True)]
        elif isinstance(event, TaskEvent) and self._worth(event):
            subject = "--".join(event.task.subject) or self.site
            took = f"{event.cpu:.1f} s" if self.verbose and event.cpu is not None else ""
            line = f"{subject:20} {event.task.stage:10} {event.outcome:9} {event.reason or took}"
            said = [(line.rstrip(), event.outcome == "failed")]
        else:
            return []
        if event.trace and self.verbose:
            said.append((event.trace, True))
        return said

    def _worth(self, event: TaskEvent) -> bool:
        """Is a task said?"""
        if self.verbose or self._quiet:
            return self.verbose
        if event.outcome == "rejected":
            self._rejected[event.task.stage] = count = self._rejected.get(event.task.stage, 0) + 1
            return count <= MOST_REJECTED
        return event.outcome == "failed"

"""Which tasks a plan has to look at: each once, and again when what it waited for is settled; never all after each event."""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from dataclasses import dataclass, field

from ..pipeline.stages import DENSE_PAIRS, PAIRS, POSES
from ..task import Task

_DECIDE = frozenset(Task(name) for name in (PAIRS, POSES, DENSE_PAIRS))
"""What these come to decides which tasks there are."""


@dataclass
class Agenda:
    """The tasks that are to be looked at, in the order of the table of stages."""

    all_anew: bool = True
    """Every task is to be listed again."""
    _places: dict[Task, int] = field(default_factory=dict)
    _due: list[tuple[int, Task]] = field(default_factory=list)
    _queued: set[Task] = field(default_factory=set)
    _waiting: dict[Task | None, list[Task]] = field(default_factory=dict)
    """Who waits, by what for."""
    _news: list[Task] = field(default_factory=list)

    def begin(self, tasks: Iterable[Task]) -> None:
        """Look at all of these, and at nothing else."""
        self.all_anew = False
        self._places = {task: place for place, task in enumerate(tasks)}
        self._due = [(place, task) for task, place in self._places.items()]  # in order, so it is a heap
        self._queued = set(self._places)
        self._waiting = {}

    def next(self) -> Task | None:
        """The next task that is to be looked at; None where there is none."""
        if not self._due:
            return None
        task = heapq.heappop(self._due)[1]
        self._queued.discard(task)
        return task

    def add(self, task: Task) -> None:
        """A task is to be looked at again."""
        if task in self._places and task not in self._queued:
            self._queued.add(task)
            heapq.heappush(self._due, (self._places[task], task))

    def wait(self, task: Task, other: Task | None) -> None:
        """A task is to be looked at when another is settled."""
        self._waiting.setdefault(other, []).append(task)

    def settled(self, task: Task) -> None:
        """A task is settled: who waited for it is looked at."""
        self._news.append(task)
        for other in self._waiting.pop(task, ()):
            self.add(other)
        self.all_anew = self.all_anew or task in _DECIDE

    def news(self) -> list[Task]:
        """The tasks that were settled since somebody asked last."""
        found, self._news = self._news, []
        return found

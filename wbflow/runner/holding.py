"""What tasks will hold in memory, by what they held before: lanes that don't fit side by side are done one after the other."""

from __future__ import annotations

from collections.abc import Iterable

from ..task import Task
from .limits import Limits

MB = 2**20


class Holding:
    """Of one run.

    Parameters
    ----------
    limits : Limits
        What all workers together may hold, and what tasks held in earlier runs.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._tonight: dict[str, float] = {}

    def learn(self, stage: str, mb: float) -> None:
        """What a task held tonight tells of the others of its stage."""
        self._tonight[stage] = max(mb, self._tonight.get(stage, 0.0))

    def fits(self, begun: Iterable[Iterable[Task]], lane: Iterable[Task]) -> bool:
        """May a lane be begun beside others?  What nobody knows anything of may: who takes too much is done again, alone."""
        if not self._limits.memory:
            return True
        return sum(map(self._most, [*begun, lane])) * MB <= self._limits.memory

    def _most(self, tasks: Iterable[Task]) -> float:
        """MB that tasks that follow each other will hold at most."""
        past = self._limits.past
        return max((past.held(task.stage, str(task), self._tonight.get(task.stage, 0.0)) for task in tasks), default=0.0)

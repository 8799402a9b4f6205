"""What a task may take before it is ended: time from what its stage took before, memory from what the machine has."""

from __future__ import annotations

import datetime
from dataclasses import dataclass, field

from ..records.costs import Past
from ..task import Task

SHORTEST = 600.0
"""No task is ended before it has had so many seconds, however quick its stage was before."""
LONGEST = 6 * 3600.0
"""A task that takes longer is taken for stuck, however slow its stage was before; so is one of a stage without a past."""
TIMES = 20.0
"""A task may take so many times what its stage took before (the median, by the clock)."""


@dataclass(frozen=True)
class Limits:
    """Of one run."""

    memory: int = 0
    """Bytes that all workers together may hold; 0: no limit."""
    seconds: float | None = None
    """For every task; None: told by the past."""
    past: Past = field(default_factory=Past)
    until: datetime.datetime | None = None
    """When the run looks up, whatever is at work (local time)."""

    def seconds_for(self, task: Task) -> float:
        """After how long a task is taken for stuck."""
        if self.seconds is not None:
            return self.seconds
        before = self.past.stages.get(task.stage)
        return LONGEST if before is None else min(max(SHORTEST, TIMES * before), LONGEST)

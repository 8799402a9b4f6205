"""What tasks have cost in earlier runs, in time and memory, from the ledger; nothing where none can be read."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass, field

from ..cache.layout import WorkFolder

_MOST = 20_000
"""Tasks that are looked at, the newest first."""


@dataclass(frozen=True)
class TaskCosts:
    """By stage and by task."""

    stages: dict[str, float] = field(default_factory=dict)
    """Seconds by the clock: median of a stage's tasks."""
    tasks: dict[str, float] = field(default_factory=dict)
    """Of a task, the last time."""
    stages_mb: dict[str, float] = field(default_factory=dict)
    """MB (2^20 bytes) that a stage's tasks held at most."""
    tasks_mb: dict[str, float] = field(default_factory=dict)
    """Of a task, the last time."""

    def expected(self, stage: str, task: str) -> float:
        """What a task will take, as far as one can say."""
        return self.tasks.get(task, self.stages.get(stage, 0.0))

    def held(self, stage: str, task: str, others: float = 0.0) -> float:
        """MB that a task will hold, as far as one can say; `others` of its stage held so much in the meantime."""
        return self.tasks_mb.get(task, max(others, self.stages_mb.get(stage, 0.0)))


def read_costs(work: WorkFolder) -> TaskCosts:
    """The costs that a work folder's ledger knows; reading changes nothing."""
    if not work.ledger.is_file():
        return TaskCosts()
    query = f"select stage, task, wall, peak_mb from artifacts where wall is not null order by finished desc limit {_MOST}"
    try:
        database = sqlite3.connect(f"{work.ledger.resolve().as_uri()}?mode=ro", uri=True, timeout=1.0)
        try:
            rows = [(str(stage), str(task), float(wall), float(mb or 0)) for stage, task, wall, mb in database.execute(query)]
        finally:
            database.close()
    except (sqlite3.Error, ValueError, TypeError):
        return TaskCosts()
    import statistics  # here: it takes a while

    stages: dict[str, list[float]] = {}
    past = TaskCosts()
    for stage, task, wall, held in rows:
        stages.setdefault(stage, []).append(wall)
        past.tasks.setdefault(task, wall)
        past.tasks_mb.setdefault(task, held)
        past.stages_mb[stage] = max(held, past.stages_mb.get(stage, 0.0))
    past.stages.update({stage: statistics.median(walls) for stage, walls in stages.items()})
    return past

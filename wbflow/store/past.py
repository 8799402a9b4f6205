"""What tasks have cost in earlier runs, from the ledger; nothing where there is none, or it cannot be read."""

from __future__ import annotations

import sqlite3
from dataclasses import field

from ..lean import dataclass
from .layout import WorkFolder

_MOST = 20_000
"""Tasks that are looked at, the newest first."""


@dataclass(frozen=True)
class Past:
    """Seconds by the clock."""

    stages: dict[str, float] = field(default_factory=dict)
    """Median of a stage's tasks."""
    tasks: dict[str, float] = field(default_factory=dict)
    """Of a task, the last time."""

    def expected(self, stage: str, task: str) -> float:
        """What a task will take, as far as one can say."""
        return self.tasks.get(task, self.stages.get(stage, 0.0))


def read_past(work: WorkFolder) -> Past:
    """The costs that a work folder's ledger knows; reading changes nothing."""
    if not work.ledger.is_file():
        return Past()
    query = f"select stage, task, wall from artifacts where wall is not null order by finished desc limit {_MOST}"
    try:
        database = sqlite3.connect(f"{work.ledger.resolve().as_uri()}?mode=ro", uri=True, timeout=1.0)
        try:
            rows = [(str(stage), str(task), float(wall)) for stage, task, wall in database.execute(query)]
        finally:
            database.close()
    except (sqlite3.Error, ValueError, TypeError):
        return Past()
    import statistics  # here: it takes a while

    stages: dict[str, list[float]] = {}
    tasks: dict[str, float] = {}
    for stage, task, wall in rows:
        stages.setdefault(stage, []).append(wall)
        tasks.setdefault(task, wall)
    return Past({stage: statistics.median(walls) for stage, walls in stages.items()}, tasks)

"""Room on the disk is looked at before it is needed."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass, field

from ..records.ledger import Ledger
from ..task import Task
from .layout import WorkFolder
from .room import free_bytes, in_words

FLOOR = 16_000_000
"""Bytes that stay free whatever tasks are expected to take: the run has to be published."""
MARGIN = 1.2
"""Nights differ."""


@dataclass
class DiskFloor:
    """Looks whether there is room for what comes next, by what such tasks have left before."""

    work: WorkFolder
    _usual: dict[str, float] | None = field(default=None)

    def lacks(self, tasks: Iterable[Task]) -> str | None:
        """What is missing for some tasks, in words; None where there is room."""
        if self._usual is None:
            self._usual = _usual_bytes(self.work)
        need = round(MARGIN * sum(self._usual.get(task.stage, 0.0) for task in tasks)) + FLOOR
        free = free_bytes(self.work.root)
        if free >= need:
            return None
        return f"the disk is nearly full: about {in_words(need)} needed to go on, {in_words(free)} free in {self.work.root}"


def _usual_bytes(work: WorkFolder) -> dict[str, float]:
    try:
        with Ledger(work) as ledger:
            return ledger.usual_bytes()
    except (sqlite3.Error, OSError):  # then only the floor is kept
        return {}

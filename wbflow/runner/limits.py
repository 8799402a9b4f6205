"""What the tasks of a run may take: time and memory, by what such tasks took before, and room on the disk."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from ..cache.atomic import free_bytes
from ..records.ledger import TaskCosts
from ..task import Task
from ..words import in_words

LEAST_SECONDS, MOST_SECONDS, TIMES_MEDIAN = 600.0, 6 * 3600.0, 20.0
"""Seconds that a task may take: so many times the median of its stage, within limits; MOST_SECONDS where that is not known."""
DISK_RESERVE, DISK_MARGIN = 16_000_000, 1.2
"""Bytes on disk that tasks leave free, since the run has to be published; how much more they may need than before."""
SHARE = 0.8
"""Of the memory of this machine, or of the control group that the run is in, that its workers may hold together."""


@dataclass(frozen=True)
class Limits:
    """What the tasks of a run may take, of time and memory, by what such tasks took before."""

    memory: int = 0
    """Bytes that all workers together may hold; 0: no limit."""
    seconds: float | None = None
    """For every task; None: by what its stage took before."""
    costs: TaskCosts = field(default_factory=TaskCosts)
    measured_mb: dict[str, float] = field(default_factory=dict)
    """MB that tasks of a stage held at most in this run."""

    def seconds_for(self, stage: str) -> float:
        """Return after how long a task of a stage is ended."""
        if self.seconds is not None:
            return self.seconds
        before = self.costs.stages.get(stage)
        return MOST_SECONDS if before is None else min(max(LEAST_SECONDS, TIMES_MEDIAN * before), MOST_SECONDS)

    def learn(self, stage: str, mb: float) -> None:
        """Note what a task of this run held."""
        self.measured_mb[stage] = max(mb, self.measured_mb.get(stage, 0.0))

    def fits(self, begun: Iterable[Iterable[Task]], chain: Iterable[Task]) -> bool:
        """Return whether a chain may begin beside others; an unknown one may: if need be it runs again, alone."""
        return not self.memory or sum(map(self._most_mb, [*begun, chain])) * 2**20 <= self.memory

    def _most_mb(self, chain: Iterable[Task]) -> float:
        return max((self.costs.held(task.stage, str(task), self.measured_mb.get(task.stage, 0.0)) for task in chain), default=0.0)


def machine_memory() -> int:
    """Return how many bytes workers may hold together, unless the user gives a limit; 0 where it is not known."""
    groups, known = Path("/sys/fs/cgroup"), []
    files = [groups / "memory" / "memory.limit_in_bytes"]
    with suppress(OSError, StopIteration):
        own = next(line for line in Path("/proc/self/cgroup").read_text().splitlines() if line.startswith("0::"))
        group = groups / own.removeprefix("0::").lstrip("/")
        files += [folder / "memory.max" for folder in (group, *group.parents) if folder.is_relative_to(groups)]
    for file in files:
        with suppress(OSError, ValueError):  # "max": there is no limit
            known.append(int(file.read_text()))
    with suppress(ValueError, OSError):
        known.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    return int(SHARE * min(known, default=0))


def disk_shortage(root: Path, costs: TaskCosts, tasks: Iterable[Task]) -> str:
    """What is missing on the disk of a work folder for some tasks, in words; "" where there is room."""
    need = round(DISK_MARGIN * sum(costs.stages_bytes.get(task.stage, 0.0) for task in tasks)) + DISK_RESERVE
    if (free := free_bytes(root)) >= need:
        return ""
    return f"the disk is nearly full: about {in_words(need)} needed to go on, {in_words(free)} free in {root}"

"""Limits for the tasks of a run: time and memory, derived from the costs of earlier tasks, and disk space."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from ..cache.atomic import free_bytes
from ..records.costs import TaskCosts
from ..task import Task
from ..words import format_size

LEAST_SECONDS, MOST_WAIT_SECONDS, TIMES_MEDIAN = 600.0, 6 * 3600.0, 20.0
"""Time limit of a task: TIMES_MEDIAN times its stage's median, within two bounds (seconds); the upper one without a median."""
DISK_RESERVE, DISK_MARGIN = 16_000_000, 1.2
"""Bytes of disk space kept free so that the run can be published; factor by which tasks may need more space than earlier ones."""
MEMORY_SHARE = 0.8
"""Share of the memory of this machine, or of the run's control group, that all workers together may hold."""


@dataclass(frozen=True)
class Limits:
    """Limits for the tasks of a run."""

    memory: int
    """Bytes that all workers together may hold."""
    seconds: float | None = None
    """Time limit of every task; None: derived from the stage's earlier tasks."""
    costs: TaskCosts = field(default_factory=TaskCosts)
    measured_mb: dict[str, float] = field(default_factory=dict)
    """By stage: peak memory of its tasks in this run, MB (2^20 bytes)."""

    def seconds_for(self, stage: str) -> float:
        """Return the time limit of a stage's tasks, seconds."""
        if self.seconds is not None:
            return self.seconds
        median = self.costs.stages.get(stage)
        return MOST_WAIT_SECONDS if median is None else min(max(LEAST_SECONDS, TIMES_MEDIAN * median), MOST_WAIT_SECONDS)

    def learn(self, stage: str, mb: float) -> None:
        """Record the peak memory of a task in this run, MB."""
        self.measured_mb[stage] = max(mb, self.measured_mb.get(stage, 0.0))

    def fits(self, begun: Iterable[Iterable[Task]], chain: Iterable[Task]) -> bool:
        """Return whether memory suffices for one more chain; a task of unknown cost counts as 0, and is retried alone if lost."""
        return sum(map(self._peak_mb, [*begun, chain])) * 2**20 <= self.memory

    def disk_shortage(self, root: Path, tasks: Iterable[Task]) -> str:
        """Return a message if the disk of a work folder has too little space for some tasks; "" if it has enough."""
        needed = round(DISK_MARGIN * sum(self.costs.stages_bytes.get(task.stage, 0.0) for task in tasks)) + DISK_RESERVE
        if (free := free_bytes(root)) >= needed:
            return ""
        return f"the disk is nearly full: about {format_size(needed)} needed to go on, {format_size(free)} free in {root}"

    def _peak_mb(self, chain: Iterable[Task]) -> float:
        peaks = (self.costs.expected_peak_mb(task.stage, str(task), self.measured_mb.get(task.stage, 0.0)) for task in chain)
        return max(peaks, default=0.0)


def machine_memory() -> int:
    """Return the default limit of the memory of all workers together, bytes."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    groups = Path("/sys/fs/cgroup")
    files = [groups / "memory" / "memory.limit_in_bytes"]
    with suppress(OSError, StopIteration):
        own_line = next(line for line in Path("/proc/self/cgroup").read_text().splitlines() if line.startswith("0::"))
        group = groups / own_line.removeprefix("0::").lstrip("/")
        files += [folder / "memory.max" for folder in (group, *group.parents) if folder.is_relative_to(groups)]
    for file in files:
        with suppress(OSError, ValueError):  # "max": there is no limit
            limits.append(int(file.read_text()))
    return int(MEMORY_SHARE * min(limits))

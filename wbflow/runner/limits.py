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

TIMES_MEDIAN = 20.0
"""Time limit of a task, in medians of its stage's earlier tasks: one that takes longer hangs."""
LEAST_SECONDS = 600.0
"""Smallest time limit: a machine can be busy with other things for minutes."""
MOST_WAIT_SECONDS = 6 * 3600.0
"""Largest time limit, and that of a stage without earlier tasks: a task that hangs must not cost the whole night."""
DISK_RESERVE = 16_000_000
"""Bytes of disk space that are kept free, so that the run can be published."""
DISK_MARGIN = 1.2
"""Factor by which tasks may need more disk space than earlier ones of their stage."""
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
        if median is None:
            return MOST_WAIT_SECONDS
        return min(max(LEAST_SECONDS, TIMES_MEDIAN * median), MOST_WAIT_SECONDS)

    def learn(self, stage: str, mb: float) -> None:
        """Record the peak memory of a task in this run, MB."""
        self.measured_mb[stage] = max(mb, self.measured_mb.get(stage, 0.0))

    def fits(self, begun: Iterable[Iterable[Task]], chain: Iterable[Task]) -> bool:
        """Return whether memory suffices for one more chain; a task of unknown cost counts as 0, and is retried alone if lost."""
        return sum(map(self._peak_mb, [*begun, chain])) * 2**20 <= self.memory

    def disk_shortage(self, root: Path, tasks: Iterable[Task]) -> str:
        """Return a message if the disk of a work folder has too little space for some tasks; "" if it has enough."""
        expected = sum(self.costs.stages_bytes.get(task.stage, 0.0) for task in tasks)
        needed = round(DISK_MARGIN * expected) + DISK_RESERVE
        free = free_bytes(root)
        if free >= needed:
            return ""
        return f"the disk is nearly full: about {format_size(needed)} needed to go on, {format_size(free)} free in {root}"

    def _peak_mb(self, chain: Iterable[Task]) -> float:
        """Expected peak memory of a chain, MB: that of its largest task, since they run one after the other."""
        peak = 0.0
        for task in chain:
            measured = self.measured_mb.get(task.stage, 0.0)
            peak = max(peak, self.costs.expected_peak_mb(task.stage, str(task), measured))
        return peak


def machine_memory() -> int:
    """Return the default limit of the memory of all workers together, bytes."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for file in _control_files():
        with suppress(OSError, ValueError):  # "max": there is no limit
            limits.append(int(file.read_text()))
    return int(MEMORY_SHARE * min(limits))


def _control_files() -> list[Path]:
    """Files that may state a memory limit for this process's control group, or for one that contains it (cgroups(7))."""
    groups = Path("/sys/fs/cgroup")
    files = [groups / "memory" / "memory.limit_in_bytes"]  # version 1
    with suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            if line.startswith("0::"):  # version 2
                group = groups / line.removeprefix("0::").lstrip("/")
                files += [folder / "memory.max" for folder in (group, *group.parents) if folder.is_relative_to(groups)]
                break
    return files

"""What tasks may take, of time and memory, by what such tasks took before and by what the machine has."""

from __future__ import annotations

import os
import resource
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from ..cache.layout import WorkFolder
from ..cache.room import free_bytes, in_words
from ..records.costs import TaskCosts
from ..records.ledger import Ledger
from ..task import Task

SHORTEST = 600.0
"""No task is ended before it has had so many seconds, however quick its stage was before."""
LONGEST = 6 * 3600.0
"""A task that takes longer is stuck, however slow its stage was before; so is one of a stage without a past."""
TIMES = 20.0
"""A task may take so many times what its stage took before (the median, by the clock)."""
SHARE = 0.8
"""Of the memory of this machine, or of the control group that the run is in, that its workers may hold together."""
MB = 2**20
_PROC = Path("/proc")
_GROUPS = Path("/sys/fs/cgroup")


@dataclass(frozen=True)
class Limits:
    """Of one run."""

    memory: int = 0
    """Bytes that all workers together may hold; 0: no limit."""
    seconds: float | None = None
    """For every task; None: by what its stage took before."""
    past: TaskCosts = field(default_factory=TaskCosts)
    seen_mb: dict[str, float] = field(default_factory=dict)
    """MB that tasks of a stage held at most in this run."""

    def seconds_for(self, stage: str) -> float:
        """Return after how long a task of a stage is stuck."""
        if self.seconds is not None:
            return self.seconds
        before = self.past.stages.get(stage)
        return LONGEST if before is None else min(max(SHORTEST, TIMES * before), LONGEST)

    def learn(self, stage: str, mb: float) -> None:
        """Note what a task of this run held."""
        self.seen_mb[stage] = max(mb, self.seen_mb.get(stage, 0.0))

    def fits(self, begun: Iterable[Iterable[Task]], chain: Iterable[Task]) -> bool:
        """Return whether a chain may begin beside others.  One of which nothing is known may: if need be it runs again, alone."""
        return not self.memory or sum(map(self._most_mb, [*begun, chain])) * MB <= self.memory

    def _most_mb(self, chain: Iterable[Task]) -> float:
        return max((self.past.held(task.stage, str(task), self.seen_mb.get(task.stage, 0.0)) for task in chain), default=0.0)


def memory() -> int:
    """Return how many bytes workers may hold together, unless the user says otherwise; 0 where it is not known."""
    known = [*_group_limits()]
    with suppress(ValueError, OSError):
        known.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    return int(SHARE * min(known, default=0))


def _group_limits() -> Iterator[int]:
    """Limits of the control group that this process is in, and of those around it."""
    files = [_GROUPS / "memory" / "memory.limit_in_bytes"]
    with suppress(OSError, StopIteration):
        own = next(line for line in (_PROC / "self" / "cgroup").read_text().splitlines() if line.startswith("0::"))
        group = _GROUPS / own.removeprefix("0::").lstrip("/")
        files += [folder / "memory.max" for folder in (group, *group.parents) if folder.is_relative_to(_GROUPS)]
    for file in files:
        with suppress(OSError, ValueError):  # "max": there is no limit
            yield int(file.read_text())


def reset_peak() -> None:
    """Forget what this process held at most so far."""
    with suppress(OSError):
        (_PROC / "self" / "clear_refs").write_text("5")


def peak() -> int:
    """Return the bytes that this process held for itself at most since `reset_peak`; where /proc lacks it, since its start, with
    what it shares."""
    with suppress(OSError, ValueError, KeyError):
        lines = (line.split() for line in (_PROC / "self" / "status").read_text().splitlines())
        kb = {words[0]: int(words[1]) for words in lines if words[0] in {"VmHWM:", "RssFile:", "RssShmem:"}}
        return (kb["VmHWM:"] - kb["RssFile:"] - kb["RssShmem:"]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


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

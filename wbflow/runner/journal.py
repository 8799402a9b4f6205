"""The events of a run, and its costs."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from ..cache.receipt import Receipt
from ..cache.store import Damage
from ..records.events import Event, Listener, OutputEvent, TaskEvent, WarningEvent, now
from ..records.findings import Finding
from ..records.record import Seconds, StageSeconds
from ..task import Task
from .state import State


@dataclass
class Journal:
    """The events of a run, and its costs; each event is kept for the log, and passed to the listener."""

    listen: Listener
    started: datetime.datetime = field(default_factory=lambda: datetime.datetime.now(datetime.UTC))
    events: list[Event] = field(default_factory=list)
    repairs: dict[str, None] = field(default_factory=dict)
    """Damage on disk that was found and repaired, as text (the keys)."""
    upload: Callable[[], Finding | None] = lambda: None
    """Uploads finished results to the object store, if the site has one; returns a finding if that fails."""
    peak_rss_mb: float = 0.0
    """Peak memory of the largest worker, MB (2^20 bytes)."""
    _stages: dict[str, StageSeconds] = field(default_factory=dict)
    _wall_start: float = field(default_factory=time.perf_counter)
    _cpu_start: float = field(default_factory=time.process_time)

    def add_ended(self, ended: Iterable[tuple[Task, State]]) -> None:
        """Add an event for each task that has ended, and count what it cost."""
        for task, state in ended:
            receipt = state.receipt
            key = None
            cpu = None
            if receipt:
                key = receipt.key
                if state.outcome == "ran":
                    cpu = round(receipt.cpu, 3)
            self._add(
                TaskEvent(task, state.outcome, now(), state.fresh, state.reason, state.code, key=key, cpu=cpu, trace=state.trace)
            )
            # of cached results, the receipts state what earlier runs have spent
            if state.fresh and receipt:
                self._count(task.stage, receipt)

    def _count(self, stage: str, receipt: Receipt) -> None:
        """Add what a task has cost."""
        previous = self._stages.get(stage, StageSeconds(0.0, 0.0, 0))
        wall = previous.wall + receipt.wall
        cpu = previous.cpu + receipt.cpu
        self._stages[stage] = StageSeconds(wall, cpu, previous.tasks + 1)
        self.peak_rss_mb = max(self.peak_rss_mb, receipt.peak_rss_mb)

    def warn(self, what: str, *, task: Task | None = None, remedy: str = "", trace: str | None = None) -> None:
        """Add a warning of a problem that the run has survived.

        Parameters
        ----------
        what, remedy : str
            The problem in one line, and what to do about it ("" if nothing can be done).
        task, trace : Task, str, optional
            The task that it concerns, and the traceback of an unexpected error.
        """
        self._add(WarningEvent(what, now(), task, remedy, trace))

    def add_output(self, task: Task, text: str) -> None:
        """Add to the log, without showing it, what libraries have printed during a task."""
        self.events.append(OutputEvent(task, text, now()))

    def note_damage(self, damages: Iterable[Damage]) -> None:
        """Add warnings of damage that was found in the cache."""
        for damage in damages:
            self.note_repair(f"{damage.what}: made again", task=damage.task)

    def note_repair(self, what: str, *, task: Task | None = None) -> None:
        """Add a warning of repaired damage on disk, once for each text.  task: the task whose file was damaged."""
        if what not in self.repairs:  # several tasks may meet the same damage
            self.repairs[what] = None
            self._add(WarningEvent(what, now(), task, repaired=True))

    def seconds(self, own_process: bool) -> Seconds:
        """Return the costs of the run until now.  own_process: tasks ran in this process, whose CPU time includes theirs."""
        wall = time.perf_counter() - self._wall_start
        cpu = time.process_time() - self._cpu_start
        if not own_process:  # the time of other processes is not part of this one's
            cpu += sum(stage.cpu for stage in self._stages.values())
        return Seconds(wall, cpu, self._stages)

    def _add(self, event: Event) -> None:
        self.events.append(event)
        self.listen(event)

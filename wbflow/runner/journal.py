"""What a run tells while it works, and what it costs."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..cache.store import Damage
from ..records.costs import TaskCosts, read_costs
from ..records.events import Event, Listener, PlannedEvent, StartedEvent, TaskEvent, WarningEvent, Watcher, now
from ..records.findings import Finding
from ..records.record import Seconds, StageSeconds
from ..task import Task
from .state import State

if TYPE_CHECKING:
    from .planner import Plan
    from .worker import Done


@dataclass
class Journal:
    """Everything that happened in a run so far: each event is kept for the log, and the listener is told of it."""

    listen: Listener
    watch: Watcher | None = None
    """Is told of what is planned and begun."""
    workers: int = 1
    events: list[Event] = field(default_factory=list)
    repairs: dict[str, None] = field(default_factory=dict)
    """Damage on disk that was found and put right, in words."""
    behind: Callable[[], Finding | None] = lambda: None
    """Sees to it that what was done is where it is to go besides; what a person has to know of that."""
    _told: set[Task] = field(default_factory=set)
    _past: TaskCosts | None = None
    """Read when there is something to do."""

    def tell(self, plan: Plan) -> None:
        """Tell of every task that has been settled since the last time, once, and of damage that was found in the cache."""
        self.damaged(plan.cache.damages())
        for task, state in plan.news():
            self.finished(task, state)

    def planned(self, plan: Plan) -> None:
        """Tell who watches what there is to do; a night that finds everything in the cache has nothing to tell."""
        if self.watch is None:
            return
        from .planner import anything_left, outlook  # here: it knows plans, and there are nights without one

        first = not plan.cache.work.functions_memo.is_file()  # then a plan takes a while, and all there is has to be done
        if self._past is None and not (first or anything_left(plan)):
            return
        if self._past is None:
            self._past = read_costs(plan.cache.work)
        self.watch(PlannedEvent(outlook(plan, self._past), self.workers, now()))

    def begun(self, task: Task) -> None:
        """Tell who watches that a worker has a task in hand."""
        if self.watch:
            self.watch(StartedEvent(task, now()))

    def finished(self, task: Task, state: State, done: Done | None = None) -> None:
        """Tell of a task, unless it has been told of.  done: what the worker said that has just finished it."""
        if task not in self._told:
            self._told.add(task)
            self._add(_event(task, state, done))

    def damaged(self, damages: Iterable[Damage]) -> None:
        """Note damage that was found on disk, and is put right."""
        for damage in damages:
            self.repaired(f"{damage.what}: made again", task=damage.task)

    def retract(self, task: Task) -> None:
        """A task has to be done again, and will be told of again."""
        self._told.discard(task)

    def warn(self, what: str, *, task: Task | None = None, remedy: str = "", trace: str | None = None) -> None:
        """Tell of something that went wrong and was survived.

        Parameters
        ----------
        what : str
            What, in one line.
        task : Task, optional
            The task that it happened to.
        remedy : str
            What to do about it, where something can be done.
        trace : str, optional
            Traceback of a fault that nobody foresaw.
        """
        self._add(WarningEvent(what, now(), task, remedy, trace))

    def repaired(self, what: str, *, task: Task | None = None) -> None:
        """Tell, once, of damage on disk that is put right.  task: whose file it was."""
        if what not in self.repairs:
            self.repairs[what] = None
            self._add(WarningEvent(what, now(), task, repaired=True))

    def _add(self, event: Event) -> None:
        self.events.append(event)
        self.listen(event)


def _event(task: Task, state: State, done: Done | None) -> TaskEvent:
    receipt = state.receipt
    return TaskEvent(
        task,
        state.outcome,
        now(),
        fresh=done is not None and done.outcome != "cached",
        reason=state.reason,
        code=state.code,
        key=receipt.key if receipt else None,
        cpu=round(receipt.cpu, 3) if receipt and state.outcome == "ran" else None,
        trace=done.trace if done else None,
    )


class Costs:
    """The costs of a run, summed as tasks finish."""

    def __init__(self, started: datetime.datetime) -> None:
        self.started = started
        self.peak_rss_mb = 0.0
        """Of the largest worker."""
        self._stages: dict[str, StageSeconds] = {}
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def add(self, done: Done) -> None:
        """Count a task that a worker has finished, if it ran."""
        receipt = done.receipt
        if receipt is None or done.outcome not in {"ran", "rejected"}:
            return
        so_far = self._stages.get(done.task.stage, StageSeconds(0.0, 0.0, 0))
        wall, cpu = so_far.wall + receipt.wall, so_far.cpu + receipt.cpu
        self._stages[done.task.stage] = StageSeconds(wall, cpu, so_far.tasks + 1)
        self.peak_rss_mb = max(self.peak_rss_mb, receipt.peak_rss_mb)

    def seconds(self, own_process: bool) -> Seconds:
        """The sum, until now.  own_process: the tasks ran in this process, whose CPU time holds theirs already."""
        wall, cpu = time.perf_counter() - self._wall, time.process_time() - self._cpu
        if not own_process:
            cpu += sum(stage.cpu for stage in self._stages.values())
        return Seconds(wall, cpu, self._stages)

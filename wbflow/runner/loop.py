"""The night's work: plan, do what is ready, plan again, until nothing is left and the products are safely in hand."""

from __future__ import annotations

import datetime
import signal
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from typing import Any

from ..cache.room import REMEDY
from ..cache.store import DamagedArtifact, Receipt
from ..pipeline.stages import DEPTH, FUSE, POSES, stage_named
from ..task import Task
from .context import Night
from .dispatch import Dispatcher
from .journal import Costs, Journal
from .limits import DiskFloor
from .options import Options
from .planner import Plan
from .spec import TaskSpec
from .state import Cause, State
from .worker import Done

MOST_REPAIRS = 3
"""How often one task's damaged artifact is made again in one run, before its disk is given up."""


@dataclass(frozen=True)
class Product:
    """An artifact that is published, found intact."""

    task: Task
    receipt: Receipt
    data: bytes


@dataclass(frozen=True)
class Worked:
    """What a night's work came to (its tasks are in the plan)."""

    products: Mapping[Task, Product] = field(default_factory=dict)
    """What is published."""
    interrupted: bool = False


def work(night: Night, options: Options, journal: Journal, costs: Costs) -> Worked:
    """Do all that is to be done.  The caller holds the lock.

    Parameters
    ----------
    night : Night
        Its plan, not yet refreshed.
    options : Options
        Where tasks run, and how many at once.
    journal : Journal
        Is told of everything that happens.
    costs : Costs
        To which the costs of what runs are added.
    """
    dispatcher = Dispatcher(options, night.plan.cache, journal)
    try:
        return Worked(_run_tasks(night, dispatcher, journal, costs, Deadline(options.stop_at)))
    except KeyboardInterrupt:
        return Worked(interrupted=True)
    finally:
        dispatcher.stop()
        try:
            night.remember()
        except OSError as error:  # costs time only
            journal.warn(f"what was learnt of captures and functions could not be kept: {error}")


def _run_tasks(night: Night, dispatcher: Dispatcher, journal: Journal, costs: Costs, deadline: Deadline) -> dict[Task, Product]:
    """Run all tasks; returns what is published.

    Parameters
    ----------
    night : Night
        Its plan.
    dispatcher : Dispatcher
        Runs chains of tasks.
    journal, costs : Journal, Costs
        Are told.
    deadline : Deadline
        From then on only what is there is put together.
    """
    plan, floor = night.plan, DiskFloor(night.plan.cache.work)
    repairs, changes = _Repairs(plan, journal), Changes(night, journal)
    journal.planned(plan)
    while True:
        plan.refresh()
        if deadline.over:
            if not deadline.struck:
                deadline.struck = True
                for done in dispatcher.stop():
                    _finish(done, plan, repairs, journal, costs)
                plan.take_back()
            if deadline.settle(plan):
                continue
        journal.tell(plan)
        journal.planned(plan)
        chains = [chain for each in plan.lanes() if (chain := _not_begun(deadline.shortened(each), plan))]
        if chains and (lacks := floor.lacks(spec.task for chain in chains for spec in chain)):
            full = State("failed", f"{lacks}; {REMEDY}", Cause.DISK_FULL)
            for first, *_ in chains:
                plan.settle(first.task, full)
        elif chains:
            plan.hand_out(chains)
            dispatcher.submit(chains)
        elif not plan.busy:
            try:
                return _products(plan)
            except DamagedArtifact as damage:
                repairs.make_again(damage.task, damage.what)
                continue
        ended, over = dispatcher.wait()
        for done in ended:
            if done.changed is not None:
                changes.look_again(done)
            else:
                _finish(done, plan, repairs, journal, costs)
        for chain in over:
            plan.take_back(chain)


def _not_begun(chain: list[TaskSpec], plan: Plan) -> list[TaskSpec]:
    """The tasks of a chain up to the first that is at work already."""
    return list(takewhile(lambda spec: spec.task not in plan.busy, chain))


def _finish(done: Done, plan: Plan, repairs: _Repairs, journal: Journal, costs: Costs) -> None:
    if done.outcome == "damaged" and done.damaged is not None:
        repairs.make_again(done.damaged, done.reason or "")
        return
    costs.add(done)
    outcome: Any = done.outcome
    state = State(outcome, done.reason, done.code, done.receipt)
    plan.settle(done.task, state)
    plan.force -= {str(done.task)}
    journal.finished(done.task, state, done)


def _products(plan: Plan) -> dict[Task, Product]:
    """What is published of a plan that is settled.  Raises DamagedArtifact."""
    published = {POSES, FUSE}
    found = {}
    for task, state in plan.states.items():
        if task.stage in published and state.usable and state.receipt:
            data = plan.cache.read(task, plan.cache.path(state.receipt), state.receipt.digest)
            found[task] = Product(task, state.receipt, data)
    return found


@dataclass
class _Repairs:
    """Damaged artifacts made again."""

    plan: Plan
    journal: Journal
    _counts: Counter[Task] = field(default_factory=Counter)

    def make_again(self, task: Task, reason: str) -> None:
        """Have an artifact made again.  One with several readers is reported by each of them, and counts once."""
        if task not in self.plan.states:
            return
        self.journal.retract(task)
        self._counts[task] += 1
        if self._counts[task] > MOST_REPAIRS:
            why = f"{reason}; damaged {MOST_REPAIRS} times: is the disk failing?"
            self.plan.settle(task, State("failed", why, Cause.DAMAGED))
        else:
            self.journal.repaired(f"{reason}; made again", task=task)
            self.plan.forget(task)


MOST_LOOKS = 3
"""How often a file that changes is looked at again in one run."""


@dataclass
class Changes:
    """Looks again at captures, masks and models that have been replaced since their digests were taken: what they hold now is
    planned with, and nothing is kept under what they held before."""

    night: Night
    journal: Journal
    _looks: Counter[Path] = field(default_factory=Counter)

    def look_again(self, done: Done) -> None:
        """A task has found a file changed: the plan goes on with what it holds now.

        Parameters
        ----------
        done : Done
            With the file.
        """
        assert done.changed is not None
        self._looks[done.changed] += 1
        if self._looks[done.changed] > MOST_LOOKS:
            why = f"{done.changed} keeps changing: is it still being written?"
            self.night.plan.settle(done.task, State("failed", why, Cause.BAD_INPUT))
            return
        self.journal.warn(f"{done.reason}; what it holds now is used", task=done.task)
        self.night.look_again(done.changed)


@dataclass
class Deadline:
    """When a run stops beginning work that can wait for another night."""

    at: datetime.datetime | None = None
    """Local time; None: never."""
    struck: bool = False
    """Has it been noticed that it is over?"""

    @property
    def over(self) -> bool:
        """Is it later than that?"""
        return self.at is not None and datetime.datetime.now() >= self.at

    def settle(self, plan: Plan) -> bool:
        """Give up what is ready and adds to the night; is there such?"""
        given_up = [task for task in plan.ready if not _puts_together(task)]
        assert self.at is not None
        for task in given_up:
            plan.settle(task, State("skipped", f"the run was to stop at {self.at:%H:%M}", Cause.STOPPED))
        return bool(given_up)

    def shortened(self, lane: list[TaskSpec]) -> list[TaskSpec]:
        """What of a lane is still done."""
        if not self.struck:
            return lane
        wanted = [spec for spec in lane if _puts_together(spec.task)]
        return wanted if wanted[:1] == lane[:1] else []


def _puts_together(task: Task) -> bool:
    """Does a task join what others have made into what is published?"""
    stage = stage_named(task.stage)
    return stage.scope == "site" or stage.name == DEPTH


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """SIGTERM (systemd, cron's timeout) and SIGHUP (a terminal closed) end a run as Ctrl-C does: what is finished is kept."""

    def interrupt(signum: int, frame: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # only that one is told of signals
        yield
        return
    heeded = [s for s in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(s) is not signal.SIG_IGN]  # nohup ignores one
    before = {heard: signal.signal(heard, interrupt) for heard in heeded}
    try:
        yield
    finally:
        for heard, handler in before.items():
            signal.signal(heard, handler)

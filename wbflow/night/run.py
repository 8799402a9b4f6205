"""The night's work: plan, do what is ready, plan again, until nothing is left and the products are safely in hand."""

from __future__ import annotations

import signal
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from ..graph.pipeline import Role, stage_with
from ..store.cache import DamagedArtifact
from ..store.disk import DiskFloor
from ..store.room import REMEDY
from ..task import Task
from .changes import Changes
from .executor import Executor
from .journal import Costs, Journal
from .night import Night
from .options import Options
from .plan import Plan
from .state import Cause, State

MOST_REPAIRS = 3
"""How often one task's damaged artifact is made again in one run, before its disk is given up."""


@dataclass(frozen=True)
class Worked:
    """What a night's work came to (its tasks are in the plan)."""

    products: Mapping[Task, bytes] = field(default_factory=dict)
    """Bytes of what is published, read back from the cache and found intact."""
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
    executor = Executor(options.jobs, options.backend, options.scheduler, journal.warn)
    try:
        return Worked(_until_settled(night, executor, journal, costs))
    except KeyboardInterrupt:
        executor.stop()
        return Worked(interrupted=True)
    finally:
        try:
            night.remember()
        except OSError as error:  # costs time only
            journal.warn(f"what was learnt of captures and functions could not be kept: {error}")


def _until_settled(night: Night, executor: Executor, journal: Journal, costs: Costs) -> dict[Task, bytes]:
    plan, changes, floor = night.plan, Changes(night, journal), DiskFloor(night.plan.cache.work)
    repairs: Counter[Task] = Counter()
    while True:
        plan.refresh()
        journal.tell(plan)
        lanes = list(plan.lanes())
        if not lanes:
            try:
                return _products(plan)
            except DamagedArtifact as damage:
                _repair(plan, damage.task, damage.what, repairs, journal)
                continue
        if lacks := floor.lacks(spec.task for lane in lanes for spec in lane):
            full = State("failed", f"{lacks}; {REMEDY}", Cause.DISK_FULL)
            for first, *_ in lanes:
                plan.settle(first.task, plan.states[first.task] if first.redraw else full)
            continue
        for finished in executor.run(lanes, plan.cache):
            for done in finished:
                for warning in done.warnings:
                    journal.warn(warning, task=done.task)
                if done.outcome == "damaged" and done.damaged is not None:
                    _repair(plan, done.damaged, done.reason or "", repairs, journal)
                    continue
                if done.changed is not None:
                    changes.look_again(done)
                    continue
                costs.add(done)
                outcome: Any = done.outcome
                plan.settle(done.task, State(outcome, done.reason, done.code, done.receipt))
                plan.force -= {str(done.task)}
                journal.tell(plan, done)


def _products(plan: Plan) -> dict[Task, bytes]:
    """What is published of a plan that is settled.  Raises DamagedArtifact."""
    published = {stage_with(Role.WORLD).name, stage_with(Role.PRODUCT).name}
    found = {}
    for task, state in plan.states.items():
        if task.stage in published and state.usable and state.receipt:
            found[task] = plan.cache.read(task, plan.cache.path(state.receipt), state.receipt.digest)
    return found


def _repair(plan: Plan, task: Task, reason: str, repairs: Counter[Task], journal: Journal) -> None:
    """Have a damaged artifact made again, once for all tasks of a wave that found it damaged."""
    if task not in plan.states:
        return
    journal.retract(task)
    repairs[task] += 1
    if repairs[task] > MOST_REPAIRS:
        plan.settle(task, State("failed", f"{reason}; damaged {MOST_REPAIRS} times: is the disk failing?", Cause.DAMAGED))
    else:
        journal.repaired(f"{reason}; made again", task=task)
        plan.forget(task)


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """SIGTERM (systemd, cron's timeout) ends a run as Ctrl-C does: everything finished is kept."""

    def interrupt(signum: int, frame: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # only that one is told of signals
        yield
        return
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)

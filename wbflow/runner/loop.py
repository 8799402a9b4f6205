"""The main loop of a run: plan, run the ready tasks, plan again, until no task is left and the products are intact."""

from __future__ import annotations

import datetime
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from ..cache.store import DamagedArtifact
from ..pipeline.stages import DEPTH, FUSE, POSES, stage_named
from ..records.events import PlannedEvent
from ..task import Task
from ..words import DISK_FULL_REMEDY
from .dispatch import Dispatcher
from .journal import Journal
from .options import Options
from .plan import Plan
from .spec import TaskSpec
from .state import Cause, State

MOST_ATTEMPTS = 3
"""In one run, a damaged artifact is made again, and a changed file read again, at most this often."""


def run_tasks(plan: Plan, options: Options, journal: Journal) -> dict[Task, bytes] | None:
    """Run all tasks; return the artifacts to publish by task, after checking their digests; None if the run was interrupted.

    The caller holds the lock.  plan: not yet refreshed.  journal: receives all events.
    """
    night = plan.night
    dispatcher = Dispatcher(options, night.cache, journal)
    loop = _Loop(plan, dispatcher, journal, options.stop_at)
    try:
        return loop.run()
    except KeyboardInterrupt:
        return None
    finally:
        # also after an interrupt: what has ended is in the cache, and belongs to the log
        dispatcher.stop()
        loop.note_ended()
        try:
            for memo in (night.files.digests, night.files.earlier, night.site.bindings.reader):
                memo.save()
        except OSError as error:  # the next run only takes longer
            journal.warn(f"digests of captures and signatures of functions could not be saved: {error}")


@dataclass
class _Loop:
    """Runs all tasks of a plan."""

    plan: Plan
    dispatcher: Dispatcher
    journal: Journal
    stop_at: datetime.datetime | None
    """Local time after which the run computes only what joins existing results (see `_stop`)."""
    stopped: bool = False
    _attempts: Counter[Task | Path] = field(default_factory=Counter)

    def run(self) -> dict[Task, bytes]:
        """Run all tasks; return the artifacts to publish."""
        plan = self.plan
        self.journal.listen(PlannedEvent(plan.counts()))
        while True:
            plan.refresh()  # what has ended may have made others ready, or told which tasks there are
            if self.stop_at and datetime.datetime.now() >= self.stop_at:
                self._stop(self.stop_at)
            self.note_ended()
            self.journal.listen(PlannedEvent(plan.counts()))
            chains = plan.chains()
            if self.stopped:
                chains = [chain[:1] for chain in chains]  # what would follow is given up
            if chains and not self._submit(chains):
                continue
            if plan.running:
                self._collect()
                continue
            # nothing is ready and nothing runs: what is left to do is to read the products
            try:
                return self._products()
            except DamagedArtifact as damage:
                self._make_again(damage.task, damage.what)

    def _submit(self, chains: list[list[TaskSpec]]) -> bool:
        """Submit chains; returns False if the disk has too little space for them: then their first tasks have failed instead."""
        plan = self.plan
        tasks = [spec.task for chain in chains for spec in chain]
        shortage = self.dispatcher.limits.disk_shortage(plan.night.cache.work.root, tasks)
        if shortage:
            for first, *_ in chains:
                plan.commit(first.task, State("failed", f"{shortage}; {DISK_FULL_REMEDY}", Cause.DISK_FULL))
            return False
        plan.begin(chains)
        self.dispatcher.submit(chains)
        return True

    def note_ended(self) -> None:
        """Tell the journal which tasks have ended, and what was found damaged in the cache, since the last call."""
        self.journal.note_damage(self.plan.night.cache.damages())
        self.journal.add_ended(self.plan.newly_ended())

    def _collect(self) -> None:
        for chain, ended in self.dispatcher.wait():
            for done in ended:
                if done.damaged is not None:
                    self._make_again(done.damaged, done.state.reason or "")
                elif done.changed is not None:
                    self._reread(done.task, done.changed, done.state.reason or "")
                else:
                    self.plan.commit(done.task, done.state)
            self.plan.release(spec.task for spec in chain)

    def _stop(self, stop_time: datetime.datetime) -> None:
        """End running tasks, and skip ready ones, except depth maps and site-wide stages, which join existing results."""
        plan = self.plan
        if not self.stopped:
            self.stopped = True
            self.dispatcher.stop()
            plan.release(list(plan.running))
            plan.refresh()
        # giving up one task can make others ready
        while True:
            given_up = [task for task in plan.ready if stage_named(task.stage).scope != "site" and task.stage != DEPTH]
            if not given_up:
                return
            for task in given_up:
                plan.commit(task, State("skipped", f"the run was to stop at {stop_time:%H:%M}", Cause.STOPPED))
            plan.refresh()

    def _make_again(self, task: Task, reason: str) -> None:
        """Have a damaged artifact made again.  Each of its readers reports the damage, but it counts once."""
        plan = self.plan
        if task not in plan.states:  # another reader has reported it already
            return
        self._attempts[task] += 1
        if self._attempts[task] > MOST_ATTEMPTS:
            explanation = f"{reason}; damaged {MOST_ATTEMPTS} times: is the disk failing?"
            plan.commit(task, State("failed", explanation, Cause.DAMAGED))
        else:
            self.journal.note_repair(f"{reason}; made again", task=task)
            plan.forget(task)

    def _reread(self, task: Task, file: Path, reason: str) -> None:
        """Continue the plan with the present content of a capture, mask or model that was replaced since it was read."""
        self._attempts[file] += 1
        if self._attempts[file] > MOST_ATTEMPTS:
            explanation = f"{file} keeps changing: is it still being written?"
            self.plan.commit(task, State("failed", explanation, Cause.BAD_INPUT))
            return
        self.journal.warn(f"{reason}; its present content is used", task=task)
        self.plan.night.files.reread(file)
        self.plan.relist()

    def _products(self) -> dict[Task, bytes]:
        """The artifacts to publish: poses and clouds.  Raises DamagedArtifact."""
        cache = self.plan.night.cache
        products = {}
        for task, state in self.plan.states.items():
            if task.stage in {POSES, FUSE} and state.usable and state.receipt:
                products[task] = cache.read(task, cache.path(state.receipt), state.receipt.digest)
        return products

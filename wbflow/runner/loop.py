"""The work of a run: plan, do what is ready, plan again, until nothing is left and the products are found intact."""

from __future__ import annotations

import datetime
import signal
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from ..cache.atomic import REMEDY
from ..cache.store import DamagedArtifact
from ..pipeline.stages import DEPTH, FUSE, POSES, stage_named
from ..records.events import PlannedEvent
from ..task import Task
from .context import RunContext
from .dispatch import Dispatcher
from .journal import Journal
from .options import Options
from .state import Cause, State

MOST_ATTEMPTS = 3
"""How often a damaged artifact is made again, and a file that changes is read again, in one run."""


def run_tasks(context: RunContext, options: Options, journal: Journal) -> dict[Task, bytes] | None:
    """Do all that is to be done; return the artifacts that are published, found intact; None where the run was interrupted.

    The caller holds the lock.  context: with its plan, not yet refreshed.  journal: receives everything that happens.
    """
    dispatcher = Dispatcher(options, context.plan.cache, journal)
    try:
        return _Loop(context, dispatcher, journal, options.stop_at).run()
    except KeyboardInterrupt:
        return None
    finally:
        dispatcher.stop()
        journal.add_ended(context.plan)
        try:
            for memo in (context.digests, context.earlier_captures, context.plan.site.reader):
                memo.save()
        except OSError as error:  # costs time only
            journal.warn(f"what was learnt of captures and functions could not be kept: {error}")


@dataclass
class _Loop:
    """Runs all tasks of a plan."""

    context: RunContext
    dispatcher: Dispatcher
    journal: Journal
    stop_at: datetime.datetime | None
    """Local time: from then on only what is there is put together."""
    stopped: bool = False
    _attempts: Counter[Task | Path] = field(default_factory=Counter)

    def run(self) -> dict[Task, bytes]:
        """Run them; returns what is published."""
        plan = self.context.plan
        self.journal.listen(PlannedEvent(plan.counts()))
        while True:
            plan.refresh()
            if self.stop_at and datetime.datetime.now() >= self.stop_at:
                self._stop(self.stop_at)
            self.journal.add_ended(plan)
            self.journal.listen(PlannedEvent(plan.counts()))
            chains = [chain[:1] if self.stopped else chain for chain in plan.chains()]
            if chains and (shortage := self.dispatcher.disk_shortage(spec.task for chain in chains for spec in chain)):
                for first, *_ in chains:
                    plan.commit(first.task, State("failed", f"{shortage}; {REMEDY}", Cause.DISK_FULL))
                continue
            if chains:
                plan.begin(chains)
                self.dispatcher.submit(chains)
            if plan.running:
                self._collect()
                continue
            try:
                return self._products()
            except DamagedArtifact as damage:
                self._make_again(damage.task, damage.what)

    def _collect(self) -> None:
        ended, chains = self.dispatcher.wait()
        for done in ended:
            if done.damaged is not None:
                self._make_again(done.damaged, done.state.reason or "")
            elif done.changed is not None:
                self._reread(done.task, done.changed, done.state.reason or "")
            else:
                self.context.plan.commit(done.task, done.state)
        for chain in chains:
            self.context.plan.release(spec.task for spec in chain)

    def _stop(self, at: datetime.datetime) -> None:
        """End what is at work, and give up what is ready, except for what joins the results that are there."""
        plan = self.context.plan
        if not self.stopped:
            self.stopped = True
            self.dispatcher.stop()
            plan.release(list(plan.running))
            plan.refresh()
        while given_up := [t for t in plan.ready if stage_named(t.stage).scope != "site" and t.stage != DEPTH]:
            for task in given_up:
                plan.commit(task, State("skipped", f"the run was to stop at {at:%H:%M}", Cause.STOPPED))
            plan.refresh()

    def _make_again(self, task: Task, reason: str) -> None:
        """Have a damaged artifact made again.  Each of its readers reports it; it counts once."""
        plan = self.context.plan
        if task not in plan.states:
            return
        self._attempts[task] += 1
        if self._attempts[task] > MOST_ATTEMPTS:
            why = f"{reason}; damaged {MOST_ATTEMPTS} times: is the disk failing?"
            plan.commit(task, State("failed", why, Cause.DAMAGED))
        else:
            self.journal.repaired(f"{reason}; made again", task=task)
            plan.forget(task)

    def _reread(self, task: Task, file: Path, reason: str) -> None:
        """A capture, mask or model has been replaced since it was read: the plan goes on with what it holds now."""
        self._attempts[file] += 1
        if self._attempts[file] > MOST_ATTEMPTS:
            why = f"{file} keeps changing: is it still being written?"
            self.context.plan.commit(task, State("failed", why, Cause.BAD_INPUT))
            return
        self.journal.warn(f"{reason}; what it holds now is used", task=task)
        self.context.reread(file)

    def _products(self) -> dict[Task, bytes]:
        """What is published.  Raises DamagedArtifact."""
        cache, found = self.context.plan.cache, {}
        for task, state in self.context.plan.states.items():
            if task.stage in {POSES, FUSE} and state.usable and state.receipt:
                found[task] = cache.read(task, cache.path(state.receipt), state.receipt.digest)
        return found


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """SIGTERM (systemd, cron's timeout) and SIGHUP (a terminal closed) end a run as Ctrl-C does: what is finished is kept."""

    def interrupt(signum: int, frame: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # only that one receives signals
        yield
        return
    caught = [s for s in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(s) is not signal.SIG_IGN]  # nohup ignores one
    before = {each: signal.signal(each, interrupt) for each in caught}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)

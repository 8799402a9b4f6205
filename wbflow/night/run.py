"""The night's work: plan, do what is ready, plan again, until nothing is left; then publish."""

from __future__ import annotations

import datetime
import json
import os
import signal
import sqlite3
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..config.load import Site
from ..results.publish import Publication, publish
from ..results.record import Measures, run_record
from ..store.cache import DamagedArtifact
from ..store.ledger import Ledger
from ..store.lock import hold
from ..task import Task
from .executor import Executor
from .night import Night, open_night
from .plan import Plan
from .state import State
from .worker import Done

MOST_REPAIRS = 3
"""How often one task's damaged artifact is made again in one run, before its disk is given up."""

Listener = Callable[[str, State, str | None], None]
"""Called with a task's name, how it ended, and a traceback if there is one."""


@dataclass(frozen=True)
class Options:
    """What the command line says of a run."""

    date: datetime.date | None = None
    jobs: int = 1
    until: str | None = None
    force: tuple[str, ...] = ()
    wait: bool = False
    backend: str = "loky"
    scheduler: str | None = None


@dataclass
class Journal:
    """What a run has told so far.  events: lines of log.jsonl; told: tasks that have been told of."""

    listen: Listener
    events: list[dict[str, Any]] = field(default_factory=list)
    told: set[Task] = field(default_factory=set)

    def tell(self, plan: Plan, done: Done | None = None) -> None:
        """Tell of every task that has been settled since the last time, once.  done: the one that a worker has just finished."""
        for task, state in plan.states.items():
            if task not in self.told:
                self.told.add(task)
                self._tell_one(task, state, done if done and done.task == task else None)

    def retract(self, task: Task) -> None:
        """A task has to be done again, and will be told of again."""
        self.told.discard(task)

    def _tell_one(self, task: Task, state: State, done: Done | None) -> None:
        receipt = state.receipt
        event = {
            "event": "task",
            "at": datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds"),
            "task": str(task),
            "stage": task.stage,
            "subject": list(task.subject),
            "outcome": state.outcome,
            "fresh": done is not None and done.outcome != "cached",
            "reason": state.reason,
            "key": receipt.key if receipt else None,
            "cpu": round(receipt.cpu, 3) if receipt and state.outcome == "ran" else None,
            "trace": done.trace if done else None,
        }
        self.events.append(event)
        self.listen(str(task), state, done.trace if done else None)


@dataclass(frozen=True)
class Finished:
    """record: run.json; folder: the published run."""

    record: dict[str, Any]
    folder: Path


def run(site: Site, options: Options, listen: Listener) -> Finished:
    """Do a night's work.

    Raises
    ------
    Locked
        Another run holds the work folder.
    """
    with hold(site.work / "lock", options.wait), _terminate_as_interrupt():
        started = _run_id_moment(site.work)
        wall, cpu = time.perf_counter(), time.process_time()
        measures = Measures(started)
        _sweep(site.work)
        night = open_night(site, options.date, options.until, options.force)
        executor = Executor(options.jobs, options.backend, options.scheduler)
        journal = Journal(listen)
        interrupted = False
        publication: Publication | None = None
        try:
            publication = _work(night, executor, measures, journal)
        except KeyboardInterrupt:
            interrupted = True
            executor.stop()
        night.digests.save()
        site.reader.save()
        measures.wall = time.perf_counter() - wall
        if options.jobs > 1 or not measures.stages:
            measures.cpu += time.process_time() - cpu
        else:
            measures.cpu = time.process_time() - cpu
        finished = datetime.datetime.now(datetime.UTC)
        record = run_record(started.strftime("%Y%m%dT%H%M%SZ"), night.plan, measures, finished, interrupted)
        folder = publish(night, record, journal.events, publication or Publication())
        _record(site, night, record)
    return Finished(record, folder)


def _work(night: Night, executor: Executor, measures: Measures, journal: Journal) -> Publication:
    """Refresh the plan and run what is ready, until all is settled and the products are safely in hand."""
    plan = night.plan
    repairs: Counter[Task] = Counter()
    while True:
        plan.refresh()
        journal.tell(plan)
        lanes = list(plan.lanes())
        if not lanes:
            try:
                return Publication.collect(plan)
            except DamagedArtifact as damage:
                task = next(t for t in plan.states if str(t) == damage.task)
                journal.retract(task)
                _repair(night, task, repairs, str(damage))
                continue
        for finished in executor.run(lanes, plan.cache):
            for done in finished:
                if done.outcome == "damaged" and done.damaged is not None:
                    journal.retract(done.damaged)
                    _repair(night, done.damaged, repairs, done.reason or "")
                    continue
                _count(done, measures)
                outcome: Any = done.outcome
                plan.settle(done.task, State(outcome, done.reason, done.receipt))
                plan.force -= {str(done.task)}
                journal.tell(plan, done)


def _repair(night: Night, task: Task, repairs: Counter[Task], reason: str) -> None:
    """Have a damaged artifact made again."""
    repairs[task] += 1
    if repairs[task] > MOST_REPAIRS:
        night.plan.settle(task, State("failed", f"{reason}; damaged {MOST_REPAIRS} times: is the disk failing?"))
    else:
        night.plan.forget(task)


def _count(done: Done, measures: Measures) -> None:
    receipt = done.receipt
    if receipt and done.outcome in {"ran", "rejected"}:
        measures.add(receipt.preimage.stage, receipt.wall, receipt.cpu, receipt.peak_rss_mb)


def _record(site: Site, night: Night, record: dict[str, Any]) -> None:
    """Tell the ledger; it is only an index, so a fault there costs nothing."""
    states = night.plan.states
    try:
        with Ledger(site.work) as ledger:
            ledger.record_artifacts(s.receipt for s in states.values() if s.receipt and s.outcome in {"ran", "rejected"})
            ledger.record_run(
                record, [(str(t), s.receipt.key if s.receipt else None, s.outcome, s.reason) for t, s in states.items()]
            )
    except (OSError, sqlite3.Error):
        return


def _run_id_moment(work: Path) -> datetime.datetime:
    """Now, to the second; a run id is never used twice, so a second run within the same second waits for the next."""
    while True:
        moment = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
        if not (work / "runs" / moment.strftime("%Y%m%dT%H%M%SZ")).exists():
            return moment
        time.sleep(0.05)


def _sweep(work: Path) -> None:
    """Clear away what a killed run left behind: half-written files and run folders.  We hold the lock: nobody else writes."""
    mark = work / "cache" / ".writing"
    if mark.exists():
        for path in (work / "cache").rglob(".*.tmp"):
            path.unlink(missing_ok=True)
        for folder in (work / "runs").glob(".*.tmp"):
            for file in folder.iterdir():
                file.unlink()
            folder.rmdir()
    mark.parent.mkdir(parents=True, exist_ok=True)
    mark.write_text(json.dumps(os.getpid()))


@contextmanager
def _terminate_as_interrupt() -> Iterator[None]:
    """SIGTERM (systemd, cron's timeout) ends a run as Ctrl-C does: everything finished is kept."""

    def interrupt(signum: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)

"""Dispatches chains of tasks to an executor: queues and submits them, and retries a task alone if its worker was lost."""

from __future__ import annotations

import bisect
import itertools
import re
import shutil
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..cache.store import Cache
from ..errors import WbflowError
from ..records.events import StartedEvent
from ..records.ledger import read_costs
from ..task import Task
from ..words import LONGEST_TRACE, printable
from .executors import TASK_THREADS, Cluster, CodeMismatch, Processes, WorkerLost
from .journal import Journal
from .limits import Limits, machine_memory
from .options import Options, worker_roots
from .spec import TaskSpec
from .state import Cause, State
from .worker import FinishedTask, run_chain, run_chain_in_cluster

PROGRESS_SECONDS = 0.5
"""Interval at which the progress files of running chains are read."""


_BEGUN = re.compile(r"^\x1ebegun (\d{1,9})\n", re.MULTILINE)
"""How a progress file says that a task has begun; what follows was printed by it, or written by `faulthandler`."""


@dataclass
class _Submitted:
    """A chain that was submitted to a worker."""

    specs: list[TaskSpec]
    progress: Path
    """The progress file (see `worker.progress_reporter`)."""
    at_work: int = -1
    """Position in the chain of the task that began last; -1 before the first."""

    @property
    def tasks(self) -> list[Task]:
        return [spec.task for spec in self.specs]

    def read_progress(self) -> tuple[bool, str]:
        """Read the progress file: has another task begun, and what has `faulthandler` written since?"""
        try:
            text = self.progress.read_text(errors="replace")
        except OSError:
            return False, ""
        begun = list(_BEGUN.finditer(text))
        if not begun:
            return False, printable(text.strip())
        last = begun[-1]
        previous = self.at_work
        self.at_work = self._position(last[1])
        return self.at_work != previous, printable(text[last.end() :].strip(), LONGEST_TRACE)

    def output(self) -> Iterator[tuple[Task, str]]:
        """What libraries have printed during each task, for tasks that they printed something in."""
        try:
            text = self.progress.read_text(errors="replace")
        except OSError:
            return
        # text before the first task (of another thread of the process), then number, text, number, text, ...
        parts = ["0", *_BEGUN.split(text)]
        for number, printed in zip(parts[::2], parts[1::2], strict=True):
            if printed.strip():
                yield self.tasks[self._position(number)], printable(printed.strip(), LONGEST_TRACE)

    def _position(self, number: str) -> int:
        """The position in the chain that a progress file states; its content is not trusted, since libraries write there too."""
        return min(int(number), len(self.specs) - 1)


class Dispatcher:
    """Submits chains to an executor, longest expected duration first, as many at once as workers and memory allow.

    A task whose worker was lost is retried once, while nothing else runs; after a second loss it has failed.  A task that
    exceeded its time limit is not retried.
    """

    def __init__(self, options: Options, cache: Cache, journal: Journal) -> None:
        self._options = options
        self._cache = cache
        self._journal = journal
        self._executor: Executor | None = None
        self._queue: list[list[TaskSpec]] = []
        self._running: dict[Future[list[FinishedTask]], _Submitted] = {}
        self._losses: Counter[Task] = Counter()
        self._numbers = itertools.count()

    @cached_property
    def limits(self) -> Limits:
        """The limits for tasks, with their costs in earlier runs (which a run without work does not read)."""
        return Limits(self._options.memory or machine_memory(), self._options.time_limit, read_costs(self._cache.work))

    def submit(self, chains: list[list[TaskSpec]]) -> None:
        """Queue chains."""
        if self._executor is None:  # only now: a run without work starts no worker
            self._executor = _make_executor(self._options, self.limits.memory)
            self._cache.work.progress.mkdir(parents=True, exist_ok=True)
        for chain in chains:
            bisect.insort(self._queue, chain, key=self._priority)

    def wait(self) -> list[tuple[list[TaskSpec], list[FinishedTask]]]:
        """Wait until a chain ends, at most `PROGRESS_SECONDS`; return the chains that have ended, each with its ended tasks."""
        self._begin()
        finished, _ = wait(self._running, timeout=PROGRESS_SECONDS, return_when=FIRST_COMPLETED)
        for chain in self._running.values():
            has_begun, _ = chain.read_progress()
            if has_begun:
                self._journal.listen(StartedEvent(chain.tasks[chain.at_work]))
        # none of them counts as running when their losses are judged
        ended = [(self._running.pop(future), future) for future in finished]
        return [(chain.specs, list(self._outcomes(chain, future))) for chain, future in ended]

    def stop(self) -> None:
        """End all running chains, and remove their half-written files."""
        # the workers first: they write until they have ended
        if self._executor:
            self._executor.shutdown(wait=True, cancel_futures=True)
        self._executor = None
        for chain in self._running.values():
            self._cache.work.remove_half_written(chain.tasks)
        self._running = {}
        self._queue = []
        with suppress(OSError):
            shutil.rmtree(self._cache.work.progress)

    def _priority(self, chain: list[TaskSpec]) -> tuple[bool, float]:
        """The sort key of the queue: chains whose first task has lost a worker come last, else the longest comes first."""
        expected = sum(self.limits.costs.expected_seconds(spec.task.stage, str(spec.task)) for spec in chain)
        return self._losses[chain[0].task] > 0, -expected

    def _begin(self) -> None:
        """Submit the chains of the queue that can run now, in order."""
        while self._executor and self._queue and self._can_begin(self._queue[0]):
            specs = self._queue.pop(0)
            chain = _Submitted(specs, self._cache.work.progress / str(next(self._numbers)))
            self._running[self._submit(self._executor, chain)] = chain

    def _submit(self, executor: Executor, chain: _Submitted) -> Future[list[FinishedTask]]:
        """Submit a chain in the way that its executor allows."""
        specs = chain.specs
        is_elsewhere = not (self._options.scheduler or "").startswith("inproc:")  # else it would silence this process
        if isinstance(executor, Cluster) and is_elsewhere:
            return executor.submit(run_chain_in_cluster, specs, self._cache, chain.progress)
        seconds = None
        if isinstance(executor, Processes):  # only a process of its own can be ended after its time
            seconds = {spec.task.stage: self.limits.seconds_for(spec.task.stage) for spec in specs}
        return executor.submit(run_chain, specs, self._cache, chain.progress, seconds)

    def _can_begin(self, specs: list[TaskSpec]) -> bool:
        """Is nothing running, or do workers and memory allow another chain, and has none of them lost a worker before?"""
        running = [chain.tasks for chain in self._running.values()]
        if not running:
            return True
        # a task that has lost a worker runs alone: it may be what took the memory of all others
        for tasks in (specs[0].task,), *running:
            for task in tasks:
                if self._losses[task]:
                    return False
        slots = self._options.jobs
        if isinstance(self._executor, Cluster):
            slots = self._executor.capacity
        return len(running) < slots and self.limits.fits(running, [spec.task for spec in specs])

    def _outcomes(self, chain: _Submitted, future: Future[list[FinishedTask]]) -> Iterator[FinishedTask]:
        """How the tasks of a chain ended; if its worker was lost, only the running one: finished ones are in the cache."""
        error = future.exception()
        if error is None:
            for done in future.result():
                self._note(done)
                yield done
        elif isinstance(error, WorkerLost):
            yield from self._outcomes_of_loss(chain, error)
        elif isinstance(error, CodeMismatch) and isinstance(self._executor, Cluster):
            self._executor.refuse(error)  # the plan submits the chain again
        elif isinstance(error, WbflowError):
            raise error
        else:  # Dask has lost its workers repeatedly; during which task of the chain is unknown
            names = ", ".join(map(str, chain.tasks))
            reason = printable(f"{names}: {type(error).__name__}: {error}")
            yield FinishedTask(chain.tasks[0], State("failed", reason, Cause.WORKER_LOST, fresh=True))
        for task, printed in chain.output():
            self._journal.add_output(task, printed)
        chain.progress.unlink(missing_ok=True)

    def _note(self, done: FinishedTask) -> None:
        """Pass on what a worker has found besides the result: warnings, damage, and how much memory the task took."""
        for warning in done.warnings:
            self._journal.warn(warning, task=done.task)
        for damage in done.damages:
            self._journal.note_repair(f"{damage.what}: made again", task=damage.task)
        if done.state.receipt:
            self.limits.learn(done.task.stage, done.state.receipt.peak_rss_mb)

    def _outcomes_of_loss(self, chain: _Submitted, error: WorkerLost) -> Iterator[FinishedTask]:
        """How the task ended that was running when its worker was lost; nothing, if it is tried again."""
        self._cache.work.remove_half_written(chain.tasks)
        _, trace = chain.read_progress()
        task = chain.tasks[max(0, chain.at_work)]
        if "Timeout (" in trace:  # written by faulthandler, which ended the process
            median = self.limits.costs.stages.get(task.stage)
            as_a_rule = "" if median is None else f" ({task.stage} takes {_time(median)} as a rule)"
            limit = _time(self.limits.seconds_for(task.stage))
            why = f"took longer than {limit}{as_a_rule} and was ended; --time-limit gives more"
            yield FinishedTask(task, State("failed", why, Cause.TOO_SLOW, trace=trace, fresh=True))
            return
        self._losses[task] += 1
        if self._losses[task] == 1:
            self._journal.warn(f"it {error}: it is tried again, alone", task=task, trace=trace or None)
            return
        if error.cause is Cause.OUT_OF_MEMORY:
            remedy = "lower `resolution`, or allow more with --memory"
        else:
            remedy = "check the function of the stage"
        yield FinishedTask(task, State("failed", f"{error}, twice; {remedy}", error.cause, trace=trace or None, fresh=True))


def _make_executor(options: Options, memory: int) -> Executor:
    if options.backend == "threading":  # threads start at once, but a crash in a stage ends the run
        return ThreadPoolExecutor(options.jobs, thread_name_prefix=TASK_THREADS)
    if options.backend == "dask":
        return Cluster(options.scheduler or "", worker_roots(options.worker_roots))
    return Processes(options.jobs, memory)


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.3g} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} minutes"
    return f"{seconds / 3600:.3g} hours"

"""Chains of tasks on their way through an executor: queued, at work, ended, and tried again alone where a worker was lost."""

from __future__ import annotations

import heapq
import itertools
import shutil
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from ..cache.store import Cache
from ..errors import WbflowError, printable
from ..records.costs import read_costs
from ..task import Task
from . import limits
from .executors import Cluster, OtherCode, Processes, WorkerLost, worker_roots
from .journal import Journal
from .limits import Limits
from .options import Options
from .spec import TaskSpec
from .state import Cause
from .worker import Done, run_chain

LOOK_SECONDS = 0.25
"""How often the progress of workers is read."""


@dataclass
class _Chain:
    """A chain in the hands of a worker."""

    specs: list[TaskSpec]
    progress: Path
    """See `worker.Progress`."""
    read: int = 0
    """So many lines of it have been read."""
    at_work: int = 0
    """The number of the task that began last."""
    reported: set[int] = field(default_factory=set)

    @property
    def task(self) -> Task:
        return self.specs[self.at_work].task


class Dispatcher:
    """Hands chains to an executor, longest expected first, no more at once than there are workers and memory for.

    A task whose worker was lost is tried once more, when nothing else is at work; the second loss is its failure.  One that took
    too long is not: it has had its time.
    """

    def __init__(self, options: Options, cache: Cache, journal: Journal) -> None:
        self._options = options
        self._cache = cache
        self._journal = journal
        self._executor: Executor | None = None
        self._limits = Limits()
        self._queue: list[tuple[bool, float, int, list[TaskSpec]]] = []
        self._at_work: dict[Future[list[Done]], _Chain] = {}
        self._losses: Counter[Task] = Counter()
        self._numbers = itertools.count()

    def submit(self, chains: list[list[TaskSpec]]) -> None:
        """Queue chains."""
        if self._executor is None:  # here: a night with nothing to do has no use for one
            self._limits = Limits(self._options.memory or limits.memory(), self._options.time_limit, read_costs(self._cache.work))
            self._executor = _executor(self._options, self._limits)
            self._cache.work.progress.mkdir(parents=True, exist_ok=True)
        for chain in chains:
            expected = sum(self._limits.past.expected(spec.task.stage, str(spec.task)) for spec in chain)
            suspect = self._losses[chain[0].task] > 0
            heapq.heappush(self._queue, (suspect, -expected, next(self._numbers), chain))

    def wait(self) -> tuple[list[Done], list[list[TaskSpec]]]:
        """Wait a moment, or until something happens; return the tasks that have ended, and the chains that have."""
        self._begin()
        over, _ = wait(self._at_work, timeout=LOOK_SECONDS, return_when=FIRST_COMPLETED)
        done = [each for chain in self._at_work.values() for each in self._progress(chain)]
        chains = []
        for future in over:
            chain = self._at_work.pop(future)
            done += self._ended(chain, future)
            chains.append(chain.specs)
            chain.progress.unlink(missing_ok=True)
        return done, chains

    def stop(self) -> list[Done]:
        """End whatever is at work; return the tasks that had ended."""
        if self._executor:
            self._executor.shutdown(wait=True, cancel_futures=True)
        self._executor = None
        done = [each for chain in self._at_work.values() for each in self._progress(chain)]
        for chain in self._at_work.values():
            self._tidy(chain)
        self._at_work, self._queue = {}, []
        with suppress(OSError):
            shutil.rmtree(self._cache.work.progress)
        return done

    def _begin(self) -> None:
        while self._queue and self._executor:
            suspect, *_, specs = self._queue[0]
            alone = suspect or any(self._losses[chain.task] for chain in self._at_work.values())
            begun = [[spec.task for spec in chain.specs] for chain in self._at_work.values()]
            room = self._executor.room if isinstance(self._executor, Cluster) else self._options.jobs
            fits = len(begun) < room and self._limits.fits(begun, [spec.task for spec in specs])
            if self._at_work and (alone or not fits):
                return
            heapq.heappop(self._queue)
            chain = _Chain(specs, self._cache.work.progress / str(next(self._numbers)))
            seconds = {spec.task.stage: self._limits.seconds_for(spec.task.stage) for spec in specs}
            mine = isinstance(self._executor, Processes)
            future = self._executor.submit(run_chain, specs, self._cache, chain.progress, seconds if mine else None)
            self._at_work[future] = chain

    def _progress(self, chain: _Chain) -> Iterator[Done]:
        """What a worker has noted since the last time."""
        lines = _text(chain.progress).split("\n")[:-1]
        for line in lines[chain.read :]:
            event, number, key = (line + "  ").split(" ")[:3]
            if event == "begun":
                chain.at_work = int(number)
                self._journal.begun(chain.task)
            elif event == "done":
                task = chain.specs[int(number)].task
                if receipt := self._cache.by_key(task, key):
                    chain.reported.add(int(number))
                    self._limits.learn(task.stage, receipt.peak_rss_mb)
                    yield Done(task, receipt.outcome, receipt, receipt.reason, receipt.code)
            else:  # what faulthandler says
                break
            chain.read += 1

    def _ended(self, chain: _Chain, future: Future[list[Done]]) -> Iterator[Done]:
        yield from self._progress(chain)
        error = future.exception()
        if error is None:
            for number, done in enumerate(future.result()):
                for what in done.warnings:
                    self._journal.warn(what, task=done.task)
                self._journal.damaged(done.damages)
                if number not in chain.reported:
                    yield done
        elif isinstance(error, WorkerLost):
            yield from self._lost(chain, error)
        elif isinstance(error, OtherCode) and isinstance(self._executor, Cluster):
            self._executor.refuse(error)  # the plan hands it out again
        elif isinstance(error, WbflowError):
            raise error
        else:  # Dask has lost its workers, again and again; which of its tasks did that is not known
            names = ", ".join(str(spec.task) for spec in chain.specs)
            why = printable(f"{names}: {type(error).__name__}: {error}")
            yield Done(chain.task, "failed", reason=why, code=Cause.WORKER_LOST)

    def _lost(self, chain: _Chain, error: WorkerLost) -> Iterator[Done]:
        """A worker is gone.  What its chain had finished is in the cache; the task at work is tried again, or has failed."""
        self._tidy(chain)
        if chain.at_work in chain.reported:  # it is nobody's fault
            return
        task, words = chain.task, "\n".join(_text(chain.progress).split("\n")[chain.read :])
        if "Timeout (" in words:
            before = self._limits.past.stages.get(task.stage)
            usual = f" ({task.stage} takes {_time(before)} as a rule)" if before is not None else ""
            why = f"took longer than {_time(self._limits.seconds_for(task.stage))}{usual} and was ended; --time-limit gives more"
            yield Done(task, "failed", reason=why, code=Cause.TOO_SLOW, trace=printable(words))
            return
        self._losses[task] += 1
        if self._losses[task] == 1:
            self._journal.warn(f"it {error}: it is tried again, alone", task=task, trace=printable(words) or None)
            return
        memory = error.cause is Cause.OUT_OF_MEMORY
        remedy = "lower `resolution`, or give it more with --memory" if memory else "look at its function"
        yield Done(task, "failed", reason=f"{error}, twice; {remedy}", code=error.cause, trace=printable(words) or None)

    def _tidy(self, chain: _Chain) -> None:
        """Clear away what a worker that is gone has left half-written."""
        for spec in chain.specs:
            self._cache.tidy(spec.task)


def _executor(options: Options, limit: Limits) -> Executor:
    if options.backend == "threading":  # they start at once, and nothing protects the run from what a stage does
        return ThreadPoolExecutor(options.jobs)
    if options.backend == "dask":
        return Cluster(options.scheduler or "", worker_roots(options.worker_roots))
    return Processes(options.jobs, limit.memory)


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.0f} minutes" if seconds < 7200 else f"{seconds / 3600:.3g} hours"

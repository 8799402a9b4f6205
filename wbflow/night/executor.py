"""Lanes through joblib: worker processes here, or on a Dask cluster.  A worker that is killed costs its lane, not the night."""

from __future__ import annotations

import importlib
import os
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from ..store.cache import Cache
from .spec import TaskSpec
from .state import Cause
from .worker import Done, run_lane

LANE_SECONDS = 6 * 3600
"""A lane that takes longer than this is taken for stuck."""


@dataclass(frozen=True)
class Executor:
    """How lanes are run."""

    jobs: int
    """Workers."""
    backend: str
    """loky (processes), threading or dask."""
    scheduler: str | None
    """Address of the Dask scheduler."""
    warn: Callable[[str], None]
    """Told of workers that were lost."""

    def run(self, lanes: list[list[TaskSpec]], cache: Cache) -> Iterator[list[Done]]:
        """Results of lanes as they finish.

        Raises
        ------
        KeyboardInterrupt
            Ctrl-C; the workers are gone when it arrives.
        """
        # one thread for each worker: OpenCV and the numeric libraries read these when they are first imported
        for name in ("OPENCV_FOR_THREADS_NUM", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
            os.environ[name] = "1"
        if self.jobs == 1 and self.backend == "loky":
            for lane in lanes:
                yield run_lane(lane, cache, os.getpid())
            return
        finished: set[str] = set()
        try:
            for done in self._parallel(lanes, cache):
                finished.add(str(done[0].task))
                yield done
        except _lost() as error:
            suspects = [lane for lane in lanes if str(lane[0].task) not in finished]
            why = _why(error)
            self.warn(f"a task {why}: what was not finished is done again, one task at a time")
            yield from self._alone(suspects, cache, why)

    def stop(self) -> None:
        """Kill the workers."""
        if self.backend == "loky" and self.jobs > 1:
            from joblib.externals.loky import get_reusable_executor

            get_reusable_executor().shutdown(wait=True, kill_workers=True)

    def _parallel(self, lanes: list[list[TaskSpec]], cache: Cache) -> Iterator[list[Done]]:
        from joblib import Parallel, delayed, parallel_config

        if self.backend == "dask":
            client: Any = importlib.import_module("distributed").Client
            with client(self.scheduler, set_as_default=True), parallel_config(backend="dask"):
                yield from Parallel(return_as="generator_unordered", batch_size=1)(
                    delayed(run_lane)(lane, cache, os.getpid()) for lane in lanes
                )
            return
        # loky replaces a worker that has grown, and warns of it: nothing that an operator could act on
        warnings.filterwarnings("ignore", message="A worker stopped", category=UserWarning)
        with parallel_config(backend=self.backend, n_jobs=self.jobs):
            parallel = Parallel(return_as="generator_unordered", batch_size=1, timeout=LANE_SECONDS)
            yield from parallel(delayed(run_lane)(lane, cache, os.getpid()) for lane in lanes)

    def _alone(self, suspects: list[list[TaskSpec]], cache: Cache, why: str) -> Iterator[list[Done]]:
        """After a worker died or hung: each unfinished lane in a worker of its own; the one that does it again has failed."""
        for lane in suspects:
            self.stop()
            try:
                yield from self._parallel([lane], cache)
            except _lost():
                remedy = "lower `resolution`, or run with fewer --jobs"
                yield [Done(lane[0].task, "failed", reason=f"{why}, twice; {remedy}", code=Cause.WORKER_LOST)]


def _why(error: BaseException) -> str:
    if isinstance(error, TimeoutError):
        return f"took longer than {LANE_SECONDS // 3600} hours"
    return "lost its worker process, which was killed (out of memory?)"


def _lost() -> tuple[type[BaseException], ...]:
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    return (TerminatedWorkerError, TimeoutError)

"""Lanes in threads of this process, and on a Dask cluster: no task there can be ended alone, so none has a limit."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator, Sequence
from concurrent import futures
from typing import Any

from ..cache.layout import WorkFolder
from ..cache.store import Cache
from ..errors import WbflowError
from .hand import PIXELS, THREADS
from .mounts import Mount, moved
from .same_code import code_here, named_functions
from .spec import TaskSpec
from .state import Cause
from .supervisor import Report
from .worker import Done, run_lane

PATIENCE_SECONDS = 4
"""How long a scheduler is waited for, and as long again for its first worker."""


class Threads:
    """Threads of this process: nothing protects it from what a stage does."""

    def __init__(self, jobs: int, cache: Cache) -> None:
        self._pool = futures.ThreadPoolExecutor(jobs)
        self._cache = cache
        self._lanes: dict[futures.Future[list[Done]], list[TaskSpec]] = {}

    def submit(self, lanes: list[list[TaskSpec]]) -> None:
        """Lanes to be done."""
        self._lanes |= {self._pool.submit(run_lane, lane, self._cache): lane for lane in lanes}

    def reports(self) -> Iterator[Report]:
        """What has become of lanes that have ended since."""
        for future in futures.wait(self._lanes, return_when=futures.FIRST_COMPLETED).done:
            lane = self._lanes.pop(future)
            yield from (Report(lane, done) for done in future.result())
            yield Report(lane, None)

    def close(self) -> None:
        """Take back what has not begun; what is at work is waited for."""
        self._pool.shutdown(cancel_futures=True)


class Cluster:
    """A Dask cluster whose workers share the work folder.

    A worker whose stages, engine or libraries are not those of the run would store its results under keys that promise others: it
    does nothing, and is not asked again.
    """

    def __init__(self, scheduler: str, cache: Cache, mounts: Sequence[Mount] = ()) -> None:
        distributed: Any = importlib.import_module("distributed")
        self._wait = distributed.wait
        try:
            self._client = distributed.Client(scheduler, timeout=PATIENCE_SECONDS)
        except (OSError, TimeoutError, ValueError) as error:
            what = f"no Dask scheduler answers at {scheduler}: {error}"
            raise WbflowError(what, remedy="start one (dask scheduler), or correct --scheduler") from None
        try:
            self._client.wait_for_workers(1, timeout=PATIENCE_SECONDS)
        except TimeoutError:
            self._client.close(timeout=PATIENCE_SECONDS)
            what = f"the Dask scheduler at {scheduler} has no workers"
            raise WbflowError(what, remedy=f"start some: dask worker {scheduler} --nthreads 1") from None
        self._mounts = tuple(mounts)
        self._cache = Cache(WorkFolder(moved(cache.work.root, mounts)))
        self._lanes: dict[Any, list[TaskSpec]] = {}
        self._refused: dict[str, str] = {}

    def submit(self, lanes: list[list[TaskSpec]]) -> None:
        """Lanes to be done."""
        for lane in lanes:
            workers = [address for address in self._client.nthreads() if address not in self._refused]
            if self._refused and not workers:
                told = "; ".join(f"{address}: {why}" for address, why in sorted(self._refused.items()))
                raise WbflowError(f"no worker of the cluster runs the same code: {told}", remedy="install the same on all")
            code = code_here(named_functions(lane), lane[0].folder)
            theirs = moved(lane, self._mounts)
            future = self._client.submit(
                _lane_of_same_code, theirs, self._cache, code, pure=False, workers=workers if self._refused else None
            )
            self._lanes[future] = lane

    def reports(self) -> Iterator[Report]:
        """What has become of lanes that have ended since."""
        if not self._lanes:
            return
        for future in list(self._wait(list(self._lanes), return_when="FIRST_COMPLETED").done):
            lane = self._lanes.pop(future)
            if future.status == "error":
                yield Report(lane, _lost(lane, future.exception()))
            elif isinstance(told := future.result(), _Refused):
                self._refused[told.worker] = told.why
                self.submit([lane])
                continue
            else:
                back = [mount.back for mount in self._mounts]
                yield from (Report(lane, moved(done, back)) for done in told)
            yield Report(lane, None)

    def close(self) -> None:
        """Take back what has not begun."""
        for future in self._lanes:
            future.cancel()
        self._client.close(timeout=PATIENCE_SECONDS)


class _Refused:
    """A worker whose code is another."""

    def __init__(self, worker: str, why: str) -> None:
        self.worker = worker
        self.why = why


def _lane_of_same_code(lane: list[TaskSpec], cache: Cache, code: dict[str, str]) -> list[Done] | _Refused:
    """In a worker of the cluster, which does as many lanes at once as it has threads: none takes more than its own."""
    os.environ |= PIXELS | dict.fromkeys(THREADS, "1")  # OpenCV and Numba read them when the first task imports them
    here = code_here(named_functions(lane), lane[0].folder)
    other = [name for name in code if here.get(name) != code[name]]
    if other:
        worker: Any = importlib.import_module("distributed").get_worker()
        return _Refused(worker.address, f"its {', '.join(other)} {'is' if len(other) == 1 else 'are'} not what the run has")
    return run_lane(lane, cache)


def _lost(lane: list[TaskSpec], error: BaseException | None) -> Done:
    """The lane's worker was lost, again and again; which of its tasks did that is not known."""
    names = ", ".join(str(spec.task) for spec in lane)
    return Done(lane[0].task, "failed", reason=f"{names}: {type(error).__name__}: {error}", code=Cause.WORKER_LOST)

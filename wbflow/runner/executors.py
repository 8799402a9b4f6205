"""The `concurrent.futures.Executor` classes that run chains of tasks: worker processes of joblib's loky, or a Dask cluster."""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import importlib
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import __version__
from ..cache.fingerprint import FunctionError
from ..errors import WbflowError
from ..pipeline.binding import code_of
from ..pipeline.functions import FunctionReader
from ..pipeline.stages import stage_named
from ..words import format_size
from .spec import TaskSpec
from .state import Cause

THREADS = ("OPENCV_FOR_THREADS_NUM", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Environment variables, read by OpenCV and the numeric libraries at import, that limit each worker to one thread."""
ALL_CORES = "STAGE_THREADS"
"""Environment variable with the number of workers: stages that all others wait for may use this many threads."""
PIXEL_LIMIT = {"OPENCV_IO_MAX_IMAGE_PIXELS": "200000000"}
"""Limit of OpenCV for images whose header was not checked before."""
TASK_THREADS = "wbflow-task"
"""Names of threads that run tasks begin with it."""
MEASURE_SECONDS = 0.25
"""Interval at which the memory of workers is measured."""
TIMEOUT_SECONDS = 4
"""Timeout for a Dask scheduler, and again for its first worker."""


class WorkerLost(Exception):
    """A worker process ended during a call."""

    def __init__(self, why: str, cause: Cause) -> None:
        super().__init__(why)
        self.cause = cause


class Processes(Executor):
    """Worker processes of joblib's loky, kept warm.

    Each worker is a pool of its own, so that a call that ends its process affects no other call.  The total memory of all workers
    is limited: above the limit, idle workers are ended first, then the one that holds the most.  The caller submits at most
    `jobs` calls at a time.
    """

    def __init__(self, jobs: int, memory: int) -> None:
        """memory: bytes."""
        self._jobs = jobs
        self._memory = memory
        self._workers: list[_Worker] = []
        self._idle: list[_Worker] = []
        self._closed = threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function in a worker.  The future raises `WorkerLost` if the process ends instead."""
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()
        worker = self._idle.pop() if self._idle else self._start()
        worker.started.add_done_callback(lambda _: self._begin(worker, future, functools.partial(function, *args, **kwargs)))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all workers and their child processes."""
        self._closed.set()
        self._watcher.join()
        for worker in list(self._workers):
            worker.end()
        self._workers = []
        self._idle = []

    def _start(self) -> _Worker:
        """Start a worker process; it may not have started yet when this returns."""
        from joblib.externals.loky.backend import get_context
        from joblib.externals.loky.process_executor import ProcessPoolExecutor

        # the user may set another limit for pixels, but not for threads: the workers share the cores
        preset = {name: value for name, value in PIXEL_LIMIT.items() if name not in os.environ}
        environment = preset | dict.fromkeys(THREADS, "1") | {ALL_CORES: str(self._jobs)}
        # the terminal sends Ctrl-C to all processes, but not to those that start while it is blocked: the run ends workers itself
        old_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            pool = ProcessPoolExecutor(
                1, context=get_context("loky"), initializer=_start_worker, initargs=(os.getpid(),), env=environment
            )
            started = pool.submit(os.getpid)
        except (OSError, ImportError, NotImplementedError) as error:
            raise _start_error(str(error)) from None
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, old_mask)
        self._workers.append(_Worker(pool, started))
        return self._workers[-1]

    def _begin(self, worker: _Worker, future: Future[Any], call: Callable[[], Any]) -> None:
        """Submit a call to a worker that has started: loky would wait forever if the worker died before it reads a long call."""
        failure = worker.started.exception()
        if failure:
            future.set_exception(_start_error(_describe_end(failure)))
            return
        worker.peak_bytes = 0
        try:
            worker.pool.submit(call).add_done_callback(lambda loky_future: self._finish(worker, future, loky_future))
        except RuntimeError as error:  # its process has ended since its last call
            self._report_loss(worker, future, error)

    def _finish(self, worker: _Worker, future: Future[Any], loky_future: Future[Any]) -> None:
        """Pass the result of a call on, and keep its worker for the next one."""
        from joblib.externals.loky.process_executor import BrokenProcessPool

        error = loky_future.exception()
        if isinstance(error, BrokenProcessPool):
            self._report_loss(worker, future, error)
            return
        self._idle.append(worker)  # before the result: the caller submits the next call at once
        if error:
            future.set_exception(error)
        else:
            future.set_result(loky_future.result())

    def _report_loss(self, worker: _Worker, future: Future[Any], error: BaseException) -> None:
        """Tell the caller that the worker of its call has ended, and why."""
        worker.end_group()
        with suppress(ValueError):
            self._workers.remove(worker)
        how_it_ended = _describe_end(error)
        memory = format_size(worker.peak_bytes)
        if worker.exceeded_limit:
            total = f"all workers together held more than the limit of {format_size(self._memory)}"
            loss = WorkerLost(f"ran out of memory: it held {memory}, and {total}", Cause.OUT_OF_MEMORY)
        elif "SIGKILL" in how_it_ended and worker.peak_bytes > self._memory / 2:  # probably by the kernel's OOM killer
            loss = WorkerLost(f"{how_it_ended} (out of memory? it held {memory})", Cause.OUT_OF_MEMORY)
        else:
            loss = WorkerLost(how_it_ended, Cause.WORKER_LOST)
        future.set_exception(loss)

    def _watch(self) -> None:
        """Run in a thread: measure the memory of all workers, and while it exceeds the limit, end idle ones, then the largest."""
        while not self._closed.wait(MEASURE_SECONDS):
            memory = {worker: worker.memory_bytes() for worker in list(self._workers)}
            if sum(memory.values()) <= self._memory:
                continue
            for idle in [worker for worker in memory if worker in self._idle]:
                with suppress(ValueError):  # the worker has just received a call
                    self._idle.remove(idle)
                    self._workers.remove(idle)
                    idle.end()
                    del memory[idle]
            if sum(memory.values()) > self._memory:
                largest = max(memory, key=lambda worker: memory[worker])
                largest.exceeded_limit = True
                largest.end_group()


@dataclass(eq=False)
class _Worker:
    """One worker process."""

    pool: Any
    """A pool of loky with this process only."""
    started: Future[int]
    peak_bytes: int = 0
    """Largest measured memory during the present call, bytes."""
    exceeded_limit: bool = False
    """Was the worker ended because it held too much memory?"""

    def memory_bytes(self) -> int:
        """Present memory in bytes, without memory shared with other processes."""
        import psutil

        if not self.started.done() or self.started.exception():
            return 0
        try:
            info = psutil.Process(self.started.result()).memory_info()
        except psutil.Error:
            return 0
        memory = int(info.rss - getattr(info, "shared", 0))
        self.peak_bytes = max(self.peak_bytes, memory)
        return memory

    def end(self) -> None:
        """End the worker process, its child processes, and the pool."""
        self.end_group()
        self.pool.shutdown(wait=True, kill_workers=True)

    def end_group(self) -> None:
        """Kill the worker process and its child processes, which form a process group."""
        if self.started.done() and not self.started.exception():
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.started.result(), signal.SIGKILL)


def _start_worker(parent: int) -> None:
    """Make a new process a worker of the run `parent`: it ends whenever its parent ends, and writes nothing to stdout."""
    from joblib.externals.loky import process_executor

    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)
    os.setpgid(0, 0)  # so that processes started by a stage can be ended with the worker
    with suppress(OSError):
        os.dup2(2, 1)
    process_executor._MAX_MEMORY_LEAK_SIZE = sys.maxsize  # else loky restarts a worker that has loaded 300 MB of libraries
    with suppress(OSError):  # makes the kernel's OOM killer choose a worker instead of the run
        Path("/proc/self/oom_score_adj").write_text("500")


_PR_SET_PDEATHSIG = 1  # prctl(2)


def _start_error(reason: str) -> WbflowError:
    """The error for a worker process that does not start; checks the right to execute, since loky reports only a broken pipe."""
    remedy = "its output says why; is wbflow installed for this Python?"
    if not os.access(sys.executable, os.X_OK):
        reason = f"this user may not execute {sys.executable}"
        remedy = "allow it (chmod), or use another installation of Python;"
    return WbflowError(f"no worker process can be started: {reason}", remedy=f"{remedy} or try --backend threading")


def _describe_end(error: BaseException) -> str:
    """How a worker process ended, as text; loky reports exit codes as `{SIGKILL(-9)}` or `{EXIT(3)}`."""
    match = re.search(r"\{(\w+)\((-?\d+)\)", str(error))
    if match is None:
        return "lost its worker process"
    name, code = match.groups()
    if int(code) >= 0:
        return f"ended its worker process with exit code {code}"
    if name == "UNKNOWN":
        name = f"signal {code.removeprefix('-')}"
    return f"lost its worker process, which was killed by {name}"


class CodeMismatch(Exception):
    """A worker of a cluster has different code from the run: the cache keys of its results would be wrong."""

    def __init__(self, worker: str, names: str) -> None:
        super().__init__(worker, names)
        self.worker = worker
        self.names = names


class Cluster(Executor):
    """A Dask cluster whose workers share the work folder, possibly under another path."""

    def __init__(self, scheduler: str, roots: Mapping[Path, Path] | None = None) -> None:
        """roots: paths on the workers, by folder of this machine."""
        distributed: Any = importlib.import_module("distributed")
        try:
            self._client = distributed.Client(scheduler, timeout=TIMEOUT_SECONDS)
        except (OSError, TimeoutError, ValueError) as error:
            what = f"no Dask scheduler answers at {scheduler}: {error}"
            raise WbflowError(what, remedy="start one (dask scheduler), or correct --scheduler") from None
        try:
            self._client.wait_for_workers(1, timeout=TIMEOUT_SECONDS)
        except TimeoutError:
            self._client.close(timeout=TIMEOUT_SECONDS)
            what = f"the Dask scheduler at {scheduler} has no workers"
            raise WbflowError(what, remedy=f"start some: dask worker {scheduler} --nthreads 1") from None
        self._executor = self._client.get_executor(pure=False)
        self._roots = dict(roots or {})
        self._refused: dict[str, str] = {}

    @property
    def capacity(self) -> int:
        """Number of submitted calls that keeps all workers busy: two per thread."""
        return 2 * int(sum(self._client.nthreads().values()))

    def refuse(self, other: CodeMismatch) -> None:
        """Submit no more calls to a worker."""
        self._refused[other.worker] = other.names

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function, whose first argument is a chain, in a worker not yet refused.  The future may raise `CodeMismatch`."""
        allowed = None  # any, also workers that join later
        if self._refused:
            allowed = [address for address in self._client.nthreads() if address not in self._refused]
            if not allowed:
                details = "; ".join(f"the {names} of {address}" for address, names in sorted(self._refused.items()))
                what = f"no worker of the cluster runs the same code: {details} differ"
                raise WbflowError(what, remedy="install the same on all")
        call = functools.partial(_in_cluster, self._roots, __version__, function, *args, **kwargs)
        future: Future[Any] = self._executor.submit(call, workers=allowed)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Cancel pending calls, and disconnect from the cluster."""
        self._executor.shutdown(wait=False)
        self._client.close(timeout=TIMEOUT_SECONDS)


def _in_cluster(roots: Mapping[Path, Path], version: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """Run in a worker of the cluster: check its code, and call a function with paths translated to this machine."""
    os.environ |= PIXEL_LIMIT | dict.fromkeys(THREADS, "1")  # OpenCV and Numba read them when the first task imports them
    chain, *other_args = translate_paths(args, roots)
    mismatched = [spec.function for spec in chain if not _same_code(spec)]
    if version != __version__:
        mismatched.append("wbflow")
    if mismatched:
        raise CodeMismatch(importlib.import_module("distributed").get_worker().address, ", ".join(dict.fromkeys(mismatched)))
    finished = function(chain, *other_args, **kwargs)
    return translate_paths(finished, {remote: local for local, remote in roots.items()})


_PARSING = threading.Lock()
"""Python 3.11 counts the depth of its parser for all threads together, and fails if two parse at once (CPython issue 106905)."""


def _same_code(spec: TaskSpec) -> bool:
    """Is the code of a task on this machine the code that is part of its cache key?"""
    try:
        with _PARSING:
            return code_of(stage_named(spec.task.stage), spec.function, spec.method, _reader(spec.folder)) == spec.code
    except FunctionError:
        return False


@functools.cache
def _reader(folder: Path | None) -> FunctionReader:
    """A cached reader: it describes the code that this process has loaded, even if the source files change."""
    return FunctionReader(folder=folder)


def translate_paths(value: Any, roots: Mapping[Path, Path]) -> Any:
    """Return a value with all paths in it, also in containers and dataclasses, translated by `roots` (folder -> folder)."""
    if isinstance(value, Path):
        for local, remote in roots.items():
            if value.is_relative_to(local):
                return remote / value.relative_to(local)
        return value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {}
        for field in dataclasses.fields(value):
            if field.init:  # others follow from these
                changed[field.name] = translate_paths(getattr(value, field.name), roots)
        return dataclasses.replace(value, **changed)
    if isinstance(value, dict):
        return {key: translate_paths(item, roots) for key, item in value.items()}
    if type(value) in {tuple, list}:
        return type(value)(translate_paths(item, roots) for item in value)
    return value

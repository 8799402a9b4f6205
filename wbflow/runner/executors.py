"""Where chains of tasks run, each a `concurrent.futures.Executor`: worker processes of joblib's loky, or a Dask cluster."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib.util
import os
import re
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import __version__
from ..cache.fingerprint import FOLLOWED, LIBRARIES, FunctionError, installed_version
from ..cache.functions import FunctionReader
from ..cache.room import in_words
from ..errors import UsageError, WbflowError
from . import limits, worker
from .spec import TaskSpec
from .state import Cause

THREADS = ("OPENCV_FOR_THREADS_NUM", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""One thread for each worker: OpenCV and the numeric libraries read these when they are first imported."""
ALL_CORES = "STAGE_THREADS"
"""Read by stages that all others wait for: they may take as many threads as there are workers."""
PIXELS = {"OPENCV_IO_MAX_IMAGE_PIXELS": "200000000"}
"""Of an image whose header nobody has read before OpenCV does."""
LOOK_SECONDS = 0.25
"""How often the memory of workers is measured."""
PATIENCE_SECONDS = 4
"""How long to wait for a Dask scheduler, and as long again for its first worker."""


class WorkerLost(Exception):
    """A worker process ended while it worked on a call."""

    def __init__(self, why: str, cause: Cause) -> None:
        super().__init__(why)
        self.cause = cause


class Processes(Executor):
    """Worker processes of joblib's loky, kept warm.

    Each worker is a pool of its own, so that a call that ends its process costs nobody else; the pool is then made anew.  All
    workers together may hold so much memory: beyond it idle ones are ended, then the one that holds most.  Every call has a
    worker at once: the caller submits no more than `jobs` at a time.
    """

    def __init__(self, jobs: int, memory: int) -> None:
        """memory: bytes, 0 for no limit."""
        self._jobs = jobs
        self._memory = memory
        self._workers: list[_Worker] = []
        self._idle: list[_Worker] = []
        self._kills = limits.kills_for_memory()
        self._closed = threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function in a worker.  The future raises `WorkerLost` if the process ends instead."""
        outcome: Future[Any] = Future()
        outcome.set_running_or_notify_cancel()
        hand = self._idle.pop() if self._idle else self._start()
        hand.started.add_done_callback(lambda _: self._begin(hand, outcome, functools.partial(function, *args, **kwargs)))
        return outcome

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all workers, and what they have started, whatever they are at."""
        self._closed.set()
        self._watcher.join()
        for each in list(self._workers):
            each.end()
        self._workers, self._idle = [], []

    def _start(self) -> _Worker:
        from joblib.externals.loky.backend import get_context
        from joblib.externals.loky.process_executor import ProcessPoolExecutor

        preset = {name: value for name, value in PIXELS.items() if name not in os.environ}
        environment = preset | dict.fromkeys(THREADS, "1") | {ALL_CORES: str(self._jobs)}
        try:
            pool = ProcessPoolExecutor(
                1, context=get_context("loky"), initializer=worker.start, initargs=(os.getpid(),), env=environment
            )
            with _interrupts_blocked():
                started = pool.submit(os.getpid)
        except (OSError, ImportError, NotImplementedError) as error:
            raise WbflowError(f"no worker process can be started: {error}", remedy="try --backend threading") from None
        self._workers.append(_Worker(pool, started))
        return self._workers[-1]

    def _begin(self, hand: _Worker, outcome: Future[Any], call: Callable[[], Any]) -> None:
        """Hand a call to a worker that has started: until then nobody reads what it is sent, and a long call would block."""
        from joblib.externals.loky.process_executor import BrokenProcessPool

        if failure := hand.started.exception():
            why = f"no worker process can be started: {_ending(failure)}"
            outcome.set_exception(WbflowError(why, remedy="its output says why; is wbflow installed for this Python?"))
            return
        hand.most = 0
        try:
            hand.pool.submit(call).add_done_callback(lambda inner: self._end(hand, outcome, inner))
        except BrokenProcessPool as error:
            self._lost(hand, outcome, error)

    def _end(self, hand: _Worker, outcome: Future[Any], inner: Future[Any]) -> None:
        from joblib.externals.loky.process_executor import BrokenProcessPool

        error = inner.exception()
        if isinstance(error, BrokenProcessPool):
            self._lost(hand, outcome, error)
            return
        self._idle.append(hand)
        if error:
            outcome.set_exception(error)
        else:
            outcome.set_result(inner.result())

    def _lost(self, hand: _Worker, outcome: Future[Any], error: BaseException) -> None:
        hand.end_group()
        with suppress(ValueError):
            self._workers.remove(hand)
        why, cause, held = _ending(error), Cause.WORKER_LOST, in_words(hand.most)
        kills, before = limits.kills_for_memory(), self._kills
        self._kills = kills
        if hand.over:
            together = f"all workers together more than the {in_words(self._memory)} that they may"
            why, cause = f"ran out of memory: it held {held}, and {together}", Cause.OUT_OF_MEMORY
        elif "SIGKILL" in why and kills > before:
            why, cause = f"{why} because the machine ran out of memory (it held {held})", Cause.OUT_OF_MEMORY
        elif "SIGKILL" in why and self._memory and hand.most > self._memory / 2:
            why = f"{why} (out of memory? it held {held})"
        outcome.set_exception(WorkerLost(why, cause))

    def _watch(self) -> None:
        """In a thread: measure the memory of all workers, and end who holds too much."""
        while not self._closed.wait(LOOK_SECONDS):
            held = {each: each.holds() for each in list(self._workers)}
            if not self._memory or sum(held.values()) <= self._memory:
                continue
            for idle in [each for each in held if each in self._idle]:
                with suppress(ValueError):  # it has just been given something
                    self._idle.remove(idle)
                    self._workers.remove(idle)
                    idle.end()
                    del held[idle]
            if sum(held.values()) > self._memory:
                fullest = max(held, key=lambda each: held[each])
                fullest.over = True
                fullest.end_group()


@dataclass(eq=False)
class _Worker:
    """One worker process."""

    pool: Any
    """Of this process alone."""
    started: Future[int]
    """Its process id."""
    most: int = 0
    """Bytes that it was seen to hold at most during its present call."""
    over: bool = False
    """Was it ended because it held too much?"""

    def holds(self) -> int:
        """Bytes that it holds now."""
        if not self.started.done() or self.started.exception():
            return 0
        held = limits.held_by(self.started.result())
        self.most = max(self.most, held)
        return held

    def end(self) -> None:
        """End it, and what it has started."""
        self.end_group()
        self.pool.shutdown(wait=True, kill_workers=True)

    def end_group(self) -> None:
        """Kill its process and what that has started: they are a process group."""
        if self.started.done() and not self.started.exception():
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.started.result(), signal.SIGKILL)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Processes that start in this block never receive Ctrl-C, which the terminal sends to all: the run decides what they do."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _ending(error: BaseException) -> str:
    """How a worker process ended, in words: loky gives exit codes as `{SIGKILL(-9)}` or `{EXIT(3)}`."""
    found = re.search(r"\{(\w+)\((-?\d+)\)", str(error))
    if found is None:
        return "lost its worker process"
    name, code = found.groups()
    if int(code) >= 0:
        return f"ended its worker process with exit code {code}"
    return f"lost its worker process, which was killed by {name if name != 'UNKNOWN' else f'signal {code[1:]}'}"


class OtherCode(Exception):
    """A worker of a cluster has other code than the run: its results would be kept under keys that promise something else."""

    def __init__(self, worker: str, names: str) -> None:
        super().__init__(worker, names)
        self.worker = worker
        self.names = names


class Cluster(Executor):
    """A Dask cluster whose workers share the work folder, maybe under another path."""

    def __init__(self, scheduler: str, mounts: Sequence[Mount] = ()) -> None:
        distributed: Any = importlib.import_module("distributed")
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
        self._executor = self._client.get_executor(pure=False)
        self._mounts = tuple(mounts)
        self._refused: dict[str, str] = {}

    @property
    def room(self) -> int:
        """So many calls keep all workers busy."""
        return 2 * int(sum(self._client.nthreads().values()))

    def refuse(self, other: OtherCode) -> None:
        """Give a worker nothing any more."""
        self._refused[other.worker] = other.names

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function, whose first argument is a chain, in a worker with the same code.  The future may raise `OtherCode`."""
        workers = [address for address in self._client.nthreads() if address not in self._refused]
        if self._refused and not workers:
            why = "; ".join(f"the {names} of {address}" for address, names in sorted(self._refused.items()))
            raise WbflowError(f"no worker of the cluster runs the same code: {why} differ", remedy="install the same on all")
        code = code_here(args[0])
        only = workers if self._refused else None
        future: Future[Any] = self._executor.submit(_in_cluster, self._mounts, code, function, *args, workers=only, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take back what has not begun, and leave the cluster."""
        self._executor.shutdown(wait=False)
        self._client.close(timeout=PATIENCE_SECONDS)


@dataclass(frozen=True)
class Mount:
    """A folder of this machine, and the path by which workers reach it."""

    here: Path
    there: Path

    @staticmethod
    def parse(text: str) -> Mount:
        """Return the mount written as HERE=THERE.  Raises UsageError."""
        here, is_, there = text.partition("=")
        if not is_ or not here or not there.startswith("/"):
            what = f"--worker-root {text!r}: write HERE=THERE, a folder of this machine and its path on the workers"
            raise UsageError(what, remedy="for example: --worker-root /srv=/mnt/srv")
        return Mount(Path(here).resolve(), Path(there))


def _in_cluster(mounts: Sequence[Mount], code: dict[str, str], function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """In a worker of the cluster: check its code, and call a function with paths as they are here."""
    os.environ |= PIXELS | dict.fromkeys(THREADS, "1")  # OpenCV and Numba read them when the first task imports them
    there = moved(args, mounts)
    here = code_here(there[0])
    if other := [name for name in code if here.get(name) != code[name]]:
        raise OtherCode(importlib.import_module("distributed").get_worker().address, ", ".join(other))
    return moved(function(*there, **kwargs), [Mount(mount.there, mount.here) for mount in mounts])


def moved(value: Any, mounts: Sequence[Mount]) -> Any:
    """Return a value with all paths in it as they are on the other side: paths, or containers and data classes of anything."""
    if isinstance(value, Path):
        found = next((mount for mount in mounts if value.is_relative_to(mount.here)), None)
        return found.there / value.relative_to(found.here) if found else value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {f.name: moved(getattr(value, f.name), mounts) for f in dataclasses.fields(value) if f.init}
        return dataclasses.replace(value, **changed)
    if isinstance(value, dict):
        return {key: moved(item, mounts) for key, item in value.items()}
    if type(value) in {tuple, list}:
        return type(value)(moved(item, mounts) for item in value)
    return value


def code_here(chain: Sequence[TaskSpec]) -> dict[str, str]:
    """Return fingerprints of all that runs a chain here: our packages, the libraries behind them, functions of other packages."""
    reader = FunctionReader(folder=chain[0].folder)
    found = dict(_installed())
    for spec in chain:
        for name in (spec.function, *spec.parameters.values()):
            if isinstance(name, str) and ":" in name and name.partition(":")[0].partition(".")[0] not in _OURS:
                try:
                    found[name] = reader.read(name).code
                except FunctionError:
                    found[name] = ""
    return found


_OURS = (__package__.partition(".")[0], *FOLLOWED)
"""Packages that are compared as a whole."""


@functools.cache
def _installed() -> tuple[tuple[str, str], ...]:
    return (*((name, _digest(name)) for name in _OURS), *((name, installed_version(name)) for name in LIBRARIES))


def _digest(package: str) -> str:
    """Of all source files of a package."""
    spec = importlib.util.find_spec(package)
    digest = hashlib.sha256(__version__.encode())
    for root in map(Path, (spec.submodule_search_locations or ()) if spec else ()):
        for file in sorted(root.rglob("*.py")):
            digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()

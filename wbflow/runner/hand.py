"""A worker process as the run sees it: started, given lanes, heard, measured, and ended with all that it has started itself."""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection

from ..cache.store import Cache, Receipt
from ..task import Task
from .machine import held_by
from .spec import TaskSpec
from .worker import Done

THREADS = ("OPENCV_FOR_THREADS_NUM", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""One thread for each worker: OpenCV and the numeric libraries read these when they are first imported."""
LOOK_SECONDS = 0.25
"""How often clocks and memory are looked at, and whether a worker is still there."""
ALONE = "STAGE_THREADS"
"""Stages that all others wait for may take as many threads as there are workers: it is the stages' own variable."""
PIXELS = {"OPENCV_IO_MAX_IMAGE_PIXELS": "200000000"}
"""Of an image whose header nobody has read before OpenCV does."""


class Hand:
    """One worker process."""

    def __init__(self, threads: int = 1) -> None:
        """threads: see `ALONE`."""
        ours, theirs = socket.socketpair()
        paths = [entry for entry in sys.path if type(entry) is str]  # without what `plugins.offer` added
        number, me = theirs.fileno(), os.getpid()
        code = f"import sys; sys.path[:] = {paths!a}; from wbflow.runner.service import serve; serve({number}, {me})"
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", code],
                env=PIXELS | os.environ | dict.fromkeys(THREADS, "1") | {ALONE: str(threads)},
                stdin=subprocess.DEVNULL,
                stdout=_where_words_go(),  # what a stage prints is none of ours
                pass_fds=(number,),
                process_group=0,  # Ctrl-C is for the run, and what a stage starts ends with the stage
            )
        finally:
            theirs.close()
        self.pipe = Connection(ours.detach())
        self._told = select.poll()
        self._told.register(self.pipe.fileno(), select.POLLIN)
        self._looked = 0.0
        self.ready = False
        """Has it said that it works?"""
        self.since = time.monotonic()
        """When it was last heard, or given work."""
        self.most = 0
        """Most bytes that it was seen to hold since then."""

    def give(self, lanes: Sequence[tuple[list[TaskSpec], Mapping[Task, Receipt]]], cache: Cache) -> None:
        """Hand it lanes, each with the receipts of what was done of it.

        One that is dead takes them, too: that is found out when it is next listened to.
        """
        self.since, self.most = time.monotonic(), 0
        with suppress(OSError):
            self.pipe.send((lanes, cache))

    def heard(self) -> tuple[list[Done | None], bool]:
        """What it has told (None: it is done with what it was given), and whether it is still there."""
        told: list[Done | None] = []
        alive = True
        if (now := time.monotonic()) > self._looked + LOOK_SECONDS:  # its pipe tells of its end, unless another process holds it
            alive, self._looked = self._process.poll() is None, now
        try:
            while self._told.poll(0):
                told.append(self.pipe.recv())
        except (EOFError, OSError):
            alive = False
        if told:
            self.since, self.most = time.monotonic(), 0
        return told, alive

    def holds(self) -> int:
        """Bytes that it holds now."""
        held = held_by(self._process.pid)
        self.most = max(self.most, held)
        return held

    @property
    def age(self) -> float:
        """Seconds since it was last heard, or given work."""
        return time.monotonic() - self.since

    def end(self) -> None:
        """End it, and what it has started."""
        self.pipe.close()
        with suppress(ProcessLookupError, PermissionError):  # it is gone, and so is all that it had started
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def ended(self) -> str:
        """Of one that is not there any more: how it ended, in words."""
        try:
            code = self._process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            code = None
        self.end()
        if code is None:
            return "closed the pipe of its worker process"
        if code >= 0:
            return f"ended its worker process with exit code {code}"
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        return f"lost its worker process, which was killed by {name}"


def _where_words_go() -> int:
    """Where stderr goes, if anywhere."""
    try:
        os.fstat(2)
    except OSError:
        return subprocess.DEVNULL
    return 2

"""One writer for each object store: an object that says who writes, made where there is none, and renewed while he does.

Kernels free the locks of processes that die; nobody does that for an object.  So who holds one says that he is still there,
and one that has not been heard of for ten minutes counts as gone; one of this machine, as soon as its process is.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from ..cache.lock import Locked
from .objects import Objects, StoreError

NAME = "held.json"
"""Of the object."""
BEAT_SECONDS = 60.0
"""So often who holds it says that he is there."""
GONE_SECONDS = 600.0
"""Who has not been heard of for so long is gone."""
_LOOK_SECONDS = 5.0
_SETTLE_SECONDS = 3.0
"""Of two who find the same holder gone, the slower one may still take away what the quicker one has put there."""
_LOOKS = 3
_LONG_AGO = "2000-01-01T00:00:00+00:00"
_KERNEL = Path("/proc")


@dataclass(frozen=True)
class Holder:
    """Who writes to a store."""

    token: str
    """Of this time of holding it."""
    machine: str
    """The machine since it was started, and its processes' numbers: they tell whether a process is still there."""
    process: str
    """Its number, and when it began."""
    host: str
    since: str
    heard: str
    """When he last said that he is there, ISO 8601, UTC."""

    def gone(self) -> bool:
        """Is he not there any more?"""
        if self.machine and self.machine == _machine():
            return _process(self.process.partition(" ")[0]) != self.process
        heard = datetime.datetime.fromisoformat(self.heard)
        return (_now() - heard).total_seconds() > GONE_SECONDS

    def __str__(self) -> str:
        number = self.process.partition(" ")[0]
        return f"process {number} on {self.host} since {self.since}, last heard of at {self.heard}"


class Lease:
    """A store that is held to be written to."""

    def __init__(self, objects: Objects) -> None:
        self._objects = objects
        since = _now().isoformat(timespec="seconds")
        process = _process(str(os.getpid()))
        self._mine = Holder(os.urandom(8).hex(), _machine(), process, os.uname().nodename, since, since)
        self._beat = 0.0
        self._lost = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._go_on, name="lease", daemon=True)

    def take(self, wait: bool) -> None:
        """Hold the store.

        Raises
        ------
        Locked
            Somebody else does, and `wait` is False.
        StoreError
            It does not answer.
        """
        took_over = False
        while True:
            holder = self._holder()
            if holder and holder.gone():
                self._objects.remove([NAME])
                holder, took_over = None, True
            if holder is None and self._objects.create(NAME, self._told()):
                if took_over and not self._still_mine():
                    continue
                self._beat = time.monotonic()
                self._thread.start()
                return
            if holder and not wait:
                gone = f"one that was killed counts as gone after {GONE_SECONDS / 60:.0f} minutes, on its own machine at once"
                raise Locked(
                    f"another run holds {self._objects.url}: {holder}", remedy=f"wait for it (--wait), or stop it; {gone}"
                )
            time.sleep(_LOOK_SECONDS if holder else 0.1)

    def held(self) -> bool:
        """Does one still hold it?  False where somebody else has taken the store over.  Raises StoreError."""
        if not self._lost and time.monotonic() - self._beat > 2 * BEAT_SECONDS:  # the store has not answered
            self._say()
        return not self._lost

    def leave(self) -> None:
        """Others may write.  Where the store does not answer it counts as gone after a while."""
        self._stop.set()
        self._thread.join()
        with contextlib.suppress(StoreError):
            if self.held():
                self._objects.remove([NAME])

    def _still_mine(self) -> bool:
        time.sleep(_SETTLE_SECONDS)
        holder = self._holder()
        return holder is not None and holder.token == self._mine.token

    def _go_on(self) -> None:
        while not self._lost and not self._stop.wait(BEAT_SECONDS):
            with contextlib.suppress(StoreError):
                self._say()

    def _say(self) -> None:
        """Say that one is there, unless somebody else is."""
        holder = self._holder()
        if holder and holder.token != self._mine.token:
            self._lost = True
            return
        self._objects.write(NAME, self._told())
        self._beat = time.monotonic()

    def _told(self) -> bytes:
        return json.dumps({**asdict(self._mine), "heard": _now().isoformat(timespec="seconds")}).encode()

    def _holder(self) -> Holder | None:
        for _ in range(_LOOKS):
            if (data := self._objects.read(NAME)) is None:
                return None
            with contextlib.suppress(ValueError, TypeError):
                return Holder(**json.loads(data))
            time.sleep(0.5)  # it may be about to be written
        return Holder("", "", "?", "?", "?", _LONG_AGO)  # nobody who could be asked


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)


def _machine() -> str:
    """Among which processes a number means one; "" where nobody knows."""
    try:
        boot = (_KERNEL / "sys" / "kernel" / "random" / "boot_id").read_text().strip()
        return f"{boot} {os.readlink(_KERNEL / 'self' / 'ns' / 'pid')}"  # noqa: PTH115 (it leads to no path)
    except OSError:
        return ""


def _process(number: str) -> str:
    """A process by its number and when it began; the number alone where it is not there (any more)."""
    try:
        told = (_KERNEL / number / "stat").read_text().rpartition(")")[2].split()
        return number if told[0] in "ZX" else f"{number} {told[19]}"
    except (OSError, IndexError):
        return number

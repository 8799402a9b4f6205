"""What goes to an object store while a run works: each result as it is there, so that a kill costs what is at work and little
more.

A thread of the run carries it.  Where the store does not answer the run goes on, and the rest goes up when it does again: at
the end of the run, or at the end of the next one.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from ..cache.layout import WorkFolder
from ..cache.lock import Locked, hold
from ..cache.sizes import in_words
from ..errors import WbflowError, counted
from ..records.events import Event, Listener, TaskEvent
from ..records.findings import STORE_BEHIND, Finding
from ..records.run_folder import turn_links
from ..task import Task
from .lease import Lease
from .mirror import Mirror
from .objects import Objects, StoreError
from .standin import mirrored_url

EVERY_SECONDS = 2.0
"""Results of so long go up together."""
PATIENCE_SECONDS = 30.0
"""So long a store that does not answer is left alone."""
_REMEDY = "the next run brings it up; until then this machine alone has it"


class Courier:
    """Carries results to the store of a work folder.  The caller holds the folder and the store."""

    def __init__(self, mirror: Mirror, lease: Lease) -> None:
        self._mirror, self._lease = mirror, lease
        self._waiting: dict[tuple[Task, str], None] = {}
        self._fault: str | None = None
        self._lost = False
        self._turn = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._carry, name="courier", daemon=True)
        self._thread.start()
        self.finished = False

    @property
    def damages(self) -> list[str]:
        """What the store could not be believed at the beginning."""
        return self._mirror.damages

    def listening(self, listen: Listener) -> Listener:
        """A listener that hears all, and whose results are carried."""

        def hear(event: Event) -> None:
            listen(event)
            if isinstance(event, TaskEvent) and event.fresh and event.key:
                self._waiting[event.task, event.key] = None

        return hear

    def behind(self) -> Finding | None:
        """Carry what waits; what a person has to know where that does not work."""
        with self._turn:
            self._attempt(self._some)
        if self._fault is None:
            return None
        return Finding(STORE_BEHIND, (), f"{self._left()}: {self._fault}", remedy=_REMEDY)

    def finish(self) -> str | None:
        """Carry all that there is; why that did not work, in words."""
        self.finished = True
        self.close()
        self._attempt(self._all)
        with contextlib.suppress(OSError):  # it costs reading the index again
            self._mirror.save()
        return self._fault and f"{self._left()}: {self._fault}; {_REMEDY}"

    def close(self) -> None:
        """Carry nothing more."""
        self._stop.set()
        self._thread.join()

    def _left(self) -> str:
        files, size = self._mirror.unsent()
        return f"{counted(files, 'file')} ({in_words(size)}) not yet in the store"

    def _carry(self) -> None:
        rest = EVERY_SECONDS
        while not self._stop.wait(rest):
            with self._turn:
                self._attempt(self._some)
            rest = EVERY_SECONDS if self._fault is None else PATIENCE_SECONDS

    def _attempt(self, carry: Callable[[], None]) -> None:
        if self._lost:
            return
        try:
            if not self._lease.held():
                self._lost = True
                self._fault = "another run has taken the store over, since this one was not heard of"
                return
            carry()
            self._fault = None
        except (StoreError, OSError) as error:
            self._fault = error.what if isinstance(error, WbflowError) else str(error)

    def _all(self) -> None:
        self._mirror.push()
        self._mirror.settle()

    def _some(self) -> None:
        """Carry results whose receipts are in their places: those of quick tasks may still have to be settled."""
        work, ready = self._mirror.work, []
        for task, key in list(self._waiting):
            if work.receipt(task, key).is_file():
                ready.append((task, key))
        files: list[Path] = [path for task, key in ready for path in work.of_key(task, key)]
        if files:
            self._mirror.push(files)
        for one in ready:
            self._waiting.pop(one, None)


@contextlib.contextmanager
def carried(work: WorkFolder, wait: bool) -> Iterator[Courier]:
    """Hold the store that a work folder mirrors while the block runs: it begins with all that others have done, and in the end
    all that was done here is up there.  The caller holds the folder.

    Raises
    ------
    Locked
        Somebody else holds the store, and `wait` is False.
    StoreError
        It does not answer.
    """
    mirror = Mirror(work, Objects(work.store or mirrored_url(work) or ""))
    lease = Lease(mirror.objects)
    lease.take(wait)
    with contextlib.ExitStack() as held:
        held.callback(lease.leave)
        if mirror.pull():
            turn_links(work)
        courier = Courier(mirror, lease)
        held.callback(courier.close)
        yield courier
        if not courier.finished and (fault := courier.finish()):
            raise StoreError(fault)


def look(work: WorkFolder) -> None:
    """Bring what others have done, to be looked at; what somebody writes to is up to date.  Raises StoreError, OSError."""
    if not work.store:
        return
    with contextlib.suppress(Locked), hold(work.lock, wait=False):
        mirror = Mirror(work, Objects(work.store))
        if mirror.pull():
            turn_links(work)
        mirror.save()

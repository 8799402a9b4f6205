"""Reading from disks that may hang or fail, as mounts of cameras do when the network fails: no read is waited for for ever."""

from __future__ import annotations

import errno
import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import TypeVar

from ..errors import WbflowError
from ..words import printable

ANSWER_SECONDS = 120.0
"""Timeout for listing and reading a camera's folder: if it takes longer, its mount is considered dead."""
REDUCED_ANSWER_SECONDS = 5.0
"""Timeout instead of `ANSWER_SECONDS` once another camera's folder has timed out: most cameras share one mount."""
T = TypeVar("T")


class Reader:
    """A thread that reads from disks that may hang.  Not a pool: the interpreter would wait for the pool's threads at exit."""

    def __init__(self) -> None:
        self._reads: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        threading.Thread(target=self._work, daemon=True).start()

    def _work(self) -> None:
        while read := self._reads.get():
            read()

    def read(self, read: Callable[[], T], seconds: float) -> T:
        """Return what `read` returns.  Raises TimeoutError if the disk hangs (then use another reader), or what `read` raises."""
        answer: Future[T] = Future()

        def work() -> None:
            try:
                answer.set_result(read())
            except BaseException as error:  # a fault of our own is raised where it is waited for, not taken for a disk that hangs
                answer.set_exception(error)

        self._reads.put(work)
        try:
            return answer.result(seconds)
        except TimeoutError:
            if answer.done():  # the timeout is the disk's own
                raise
            raise TimeoutError(f"no answer within {seconds:.0f} s: check its disk or the network") from None

    def close(self) -> None:
        """End the thread as soon as its disk answers."""
        self._reads.put(None)


def results_by_camera(reads: Iterable[tuple[str, Callable[[], T]]]) -> Iterator[tuple[str, T | OSError]]:
    """The result of each camera's read, or the error if its disk hangs or fails; the other cameras are still read.

    A disk that hangs is a TimeoutError.  What is refused on purpose (a WbflowError) is raised.
    """
    reader = Reader()
    seconds = ANSWER_SECONDS
    for camera, read in reads:
        try:
            yield camera, reader.read(read, seconds)
        except WbflowError:
            raise
        except TimeoutError as error:
            # the thread waits for the disk, perhaps for ever; the next cameras get another one, and less time
            reader.close()
            reader = Reader()
            seconds = REDUCED_ANSWER_SECONDS
            yield camera, error
        except OSError as error:
            yield camera, error
    reader.close()


_REMEDIES = {
    errno.EACCES: "give the user who runs wbflow the right to read it",
    errno.EPERM: "give the user who runs wbflow the right to read it",
    errno.ENOTDIR: "move what lies there in place of the folder",
    errno.ELOOP: "its symbolic links lead in a circle: make them anew",
}
"""What to do about a folder that cannot be read, by the number of the error."""


def fault_of_folder(error: OSError) -> str:
    """Why a folder cannot be read, and what to do; the words follow its name."""
    if error.errno is None:  # a TimeoutError of `Reader`, which says it all
        return str(error)
    remedy = _REMEDIES.get(error.errno, "check its disk, or its mount and the network")
    return f"cannot be read: {printable(error.strerror)}; {remedy}"

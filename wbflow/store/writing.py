"""Writing to a work folder: one at a time, and what a killed one left half-written is cleared away by the next."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from .layout import WorkFolder
from .lock import hold
from .run_folder import turn_links


@contextlib.contextmanager
def hold_to_write(work: WorkFolder, wait: bool) -> Iterator[None]:
    """Hold the work folder while the block runs, and begin with one that is whole.

    Raises
    ------
    Locked
        Another process holds it and `wait` is False.
    OSError
        It cannot be written.
    """
    with hold(work.lock, wait):
        if work.start_writing():
            turn_links(work)
        yield
        work.done_writing()  # not where the block was left by an exception: then there may be something to clear away

"""Writing to a work folder: one at a time, and what a killed one left half-written is cleared away by the next."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..records.run_folder import turn_links
from .layout import WorkFolder
from .lock import hold

if TYPE_CHECKING:
    from ..remote.courier import Courier


@contextlib.contextmanager
def hold_to_write(work: WorkFolder, wait: bool) -> Iterator[Courier | None]:
    """Hold the work folder while the block runs, and begin with one that is whole; and so the store that it is a mirror of.

    Raises
    ------
    Locked
        Another process holds it and `wait` is False.
    StoreError
        The store does not answer.
    OSError
        It cannot be written.
    """
    with hold(work.lock, wait):
        if work.start_writing():
            turn_links(work)
        if work.store or work.mirror_memo.is_file():
            from ..remote.courier import carried  # here: few work folders are mirrors

            with carried(work, wait) as courier:
                yield courier
        else:
            yield None
        work.done_writing()  # not where the block was left by an exception: then there may be something to clear away

"""What is said of a run while it works: a display where somebody watches, a line now and then where words go to a file."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from ..store.events import Event, Signal
from .spoken import Words


class Watch(Protocol):
    """Somebody who hears of all that happens in a run."""

    def hear(self, event: Event | Signal) -> None:
        """Take in an event, and say what is to be said of it."""


@contextmanager
def watching(site: str, verbose: bool = False, quiet: bool = False) -> Iterator[Watch]:
    """Who says what happens in a run; whatever is drawn on the terminal is taken away at the end.

    Parameters
    ----------
    site : str
        Its name.
    verbose : bool
        Say every task, with seconds, and tracebacks.
    quiet : bool
        Only warnings; what failed is among the findings, at the end.
    """
    words = Words(site, verbose, quiet)
    if quiet:
        yield words
        return
    if sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
        from .live import Display

        with Display(words) as display:
            yield display
        return
    from .lines import Lines

    with Lines(words) as lines:
        yield lines

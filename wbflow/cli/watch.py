"""What is said of a run while it works: a display where somebody watches, a line now and then where words go to a file."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from ..records.events import Event, Signal
from .spoken import Words


class Watch(Protocol):
    """Somebody who hears of all that happens in a run."""

    def hear(self, event: Event | Signal) -> None:
        """Take in an event, and say what is to be said of it."""


def on_a_terminal() -> bool:
    """Does somebody watch, where lines can be drawn again?"""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


@contextmanager
def reading(site: Path, quiet: bool = False) -> Iterator[None]:
    """Say, where somebody watches, that a site file is being read; of these words nothing is left afterwards."""
    if quiet or not on_a_terminal():
        yield
        return
    from .inplace import InPlace

    place = InPlace()
    place.say(f"{site}: reading ...")
    try:
        yield
    finally:
        place.end()


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
    if on_a_terminal():
        from .live import Display

        with Display(words) as display:
            yield display
        return
    from .lines import Lines

    with Lines(words) as lines:
        yield lines

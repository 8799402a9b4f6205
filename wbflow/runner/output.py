"""Sends what a process prints to a file: libraries of images and videos print from C, and cron would mail it every night."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_LOCK = threading.Lock()
_TARGETS: list[int] = []
"""Descriptors of the files that output is wanted in, in the order in which that began."""
_ORIGINALS: dict[int, int] = {}
"""Duplicates of the descriptors of stdout and stderr as they were, while there is a target."""


@contextmanager
def output_into(path: Path) -> Iterator[None]:
    """Append what this process writes to stdout and stderr, of C libraries too, to a file.

    The descriptors are the whole process's: if several threads want its output at once, as in a Dask worker with several threads,
    all of it goes to the file of the one that began last.
    """
    try:
        target = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    except OSError:  # a full disk: what is printed is lost
        target = os.open(os.devnull, os.O_WRONLY)
    with _LOCK:
        if not _TARGETS:
            _ORIGINALS.update({number: os.dup(number) for number in (1, 2)})
        _TARGETS.append(target)
        _lead_to(target)
    try:
        yield
    finally:
        with _LOCK:
            _flush()
            _TARGETS.remove(target)
            if _TARGETS:
                _lead_to(_TARGETS[-1])
            else:
                for number, original in _ORIGINALS.items():
                    os.dup2(original, number)
                    os.close(original)
                _ORIGINALS.clear()
        os.close(target)


def _lead_to(target: int) -> None:
    _flush()
    for number in _ORIGINALS:
        os.dup2(target, number)


def _flush() -> None:
    """Write what Python has buffered to where it belongs."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # closed, or None
            stream.flush()

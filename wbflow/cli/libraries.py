"""Keeps from the terminal what libraries of images and videos print during a run: cron would mail it every night."""

from __future__ import annotations

import io
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from ..runner.executors import TASK_THREADS


@contextmanager
def without_library_output() -> Iterator[Callable[[], str]]:
    """Send what C code writes to this process's stdout and stderr to a file, and what Python code of tasks in threads prints.

    Yields a function that returns it.  All else that Python prints still reaches the terminal.  If the work ends with an
    exception, what was printed is too: it may say why.
    """
    with _open_file() as file:
        originals = {number: os.dup(number) for number in (1, 2)}
        streams = sys.stdout, sys.stderr, sys.__stdout__, sys.__stderr__
        terminals = {
            number: _Terminal(original, number, sys.stderr.encoding or "utf-8") for number, original in originals.items()
        }
        # streams of a notebook or a test are not those of the process: they stay
        if _is_descriptor(sys.stdout, 1):
            sys.stdout = sys.__stdout__ = terminals[1]  # type: ignore[misc]
        if _is_descriptor(sys.stderr, 2):
            sys.stderr = sys.__stderr__ = terminals[2]  # type: ignore[misc]
        for number in originals:
            os.dup2(file.fileno(), number)
        has_ended = False
        try:
            yield lambda: _text_of(file)
            has_ended = True
        finally:
            for number, original in originals.items():
                with suppress(OSError, ValueError):  # a closed pipe
                    terminals[number].flush()
                os.dup2(original, number)
            sys.stdout, sys.stderr, sys.__stdout__, sys.__stderr__ = streams  # type: ignore[misc]
            for terminal in terminals.values():
                with suppress(OSError, ValueError):
                    terminal.close()
            if not has_ended:
                sys.stderr.write(_text_of(file))


class _Terminal(io.TextIOWrapper):
    """Where the process printed before; what a thread of tasks prints goes to the file instead."""

    def __init__(self, original: int, number: int, encoding: str) -> None:
        """original: a duplicate of the descriptor `number`, which is to lead to the file."""
        self._number = number
        super().__init__(io.FileIO(original, "w"), encoding, errors="backslashreplace", write_through=True)

    def write(self, text: str, /) -> int:
        if threading.current_thread().name.startswith(TASK_THREADS):
            os.write(self._number, text.encode(errors="backslashreplace"))
            return len(text)
        return super().write(text)


def _open_file() -> IO[bytes]:
    try:
        return tempfile.TemporaryFile()
    except OSError:  # a full disk: what is printed is lost
        return Path(os.devnull).open("w+b")


def _is_descriptor(stream: object, number: int) -> bool:
    """Does a stream write to a descriptor of the process?"""
    try:
        return isinstance(stream, io.TextIOWrapper) and stream.fileno() == number
    except (OSError, ValueError):
        return False


def _text_of(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode(errors="replace")

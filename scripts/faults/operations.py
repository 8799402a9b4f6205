"""Faults at file operations: counts the operations that write, in a process and all its children, and strikes at one of them.

The product contains nothing of this: the campaign arms the faults in the processes that it starts.
"""

from __future__ import annotations

import builtins
import errno
import io
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

OPERATIONS = ("replace", "rename", "fsync", "unlink", "remove", "mkdir", "rmdir", "symlink", "link", "chmod", "utime")
"""Functions of `os` that change files; opening a file for writing counts as well."""


def arm(counter: Path, at: int, kind: str) -> None:
    """Count file operations from now on, and strike right before operation number `at` (from 1).

    Parameters
    ----------
    counter : Path
        A file that grows by one byte with each operation.
    at : int
        Number of the operation to strike at; 0: only count.
    kind : str
        kill: kill the whole process group, as in a power failure.  full: the disk is full from this operation on.
    """
    descriptor = os.open(counter, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    write, seek = os.write, os.lseek

    def count(frees: bool = False) -> None:
        write(descriptor, b".")
        number = seek(descriptor, 0, os.SEEK_CUR)
        if at and kind == "kill" and number == at:
            os.killpg(0, signal.SIGKILL)
        if at and kind == "full" and number >= at and not frees:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for name in OPERATIONS:
        setattr(os, name, _counted(getattr(os, name), count, name in {"unlink", "remove", "rmdir"}))
    opened = io.open

    def open_counted(file: Any, mode: str = "r", *rest: Any, **named: Any) -> Any:
        if not isinstance(file, int) and set(mode) & set("wax+"):
            count()
        return opened(file, mode, *rest, **named)

    descriptor_of = os.open

    def descriptor_counted(path: Any, flags: int, *rest: Any, **named: Any) -> int:
        if flags & os.O_TRUNC:
            count()
        return descriptor_of(path, flags, *rest, **named)

    io.open = open_counted
    builtins.open = open_counted
    os.open = descriptor_counted


def _counted(operation: Callable[..., Any], count: Callable[[bool], None], frees: bool) -> Callable[..., Any]:
    def counted(*positional: Any, **named: Any) -> Any:
        count(frees)
        return operation(*positional, **named)

    return counted

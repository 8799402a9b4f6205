"""A work folder has one writer, enforced by an flock that the kernel releases when its process dies, however it dies."""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import json
import os
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from ..errors import ExitCode, WbflowError
from .atomic import clear
from .untrusted import read_untrusted


class Locked(WbflowError):
    """Another run holds the work folder; the message names its process and start time."""

    exit_code = ExitCode.LOCKED


@contextlib.contextmanager
def hold(path: Path, wait: bool) -> Iterator[None]:
    """Hold the lock file while the block runs.  Raises Locked if another process holds it and `wait` is False."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with _open_locked(path, wait) as file:
        since = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        with contextlib.suppress(OSError):  # on a full disk the lock is held, but its file stays empty
            file.truncate(0)
            holder = {"pid": os.getpid(), "host": os.uname().nodename, "since": since}
            os.write(file.fileno(), json.dumps(holder).encode())
        try:
            yield
        finally:
            file.truncate(0)  # the file stays: if it were removed, two processes could hold two files of this name


def holder_of(path: Path) -> str | None:
    """Return who holds the lock file, in words; None if nobody does.  Nothing is written."""
    try:
        if not read_untrusted(path):  # whoever held it last has ended properly
            return None
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _holder(path)
    except OSError:
        return None
    return None


def _open_locked(path: Path, wait: bool) -> IO[str]:
    """Open and lock the file.  Anything else at its path (a folder, a dangling link, a pipe) is removed, unless it is locked."""
    while True:
        # 1. Open it without blocking, whatever it is by now: a pipe would otherwise wait for a writer.
        if path.is_dir() or (path.is_symlink() and not path.exists()):
            clear(path)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK, 0o666)

        # 2. Lock it, now or after the holder has ended.
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            if not wait:
                what = f"another run holds {path.parent}: {_holder(path)}"
                raise Locked(what, remedy="wait for it (--wait), or stop it") from None
            time.sleep(0.2)
            continue

        # 3. Is what is locked still what lies at the path?  If it was replaced meanwhile, another process may hold the new file.
        status = os.fstat(descriptor)
        with contextlib.suppress(FileNotFoundError):
            current = path.stat()
            if (current.st_dev, current.st_ino) == (status.st_dev, status.st_ino):
                if stat.S_ISREG(status.st_mode):
                    return os.fdopen(descriptor, "r+")
                clear(path)
        os.close(descriptor)


def _holder(path: Path) -> str:
    """Who holds the lock, in words."""
    try:
        holder = json.loads(read_untrusted(path))
        return f"process {holder['pid']} on {holder['host']} since {holder['since']}"
    except (OSError, ValueError, KeyError):
        return "which process holds it is unknown"

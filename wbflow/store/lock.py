"""One writer for each work folder: an flock, which the kernel frees when its process dies, however it dies."""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import json
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

from ..errors import ExitCode, WbflowError


class Locked(WbflowError):
    """Another run holds the work folder; the message says who and since when."""

    exit_code = ExitCode.LOCKED


@contextlib.contextmanager
def hold(path: Path, wait: bool) -> Iterator[None]:
    """Hold the lock file while the block runs.

    Raises
    ------
    Locked
        Another process holds it and `wait` is False.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+") as file:
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if not wait:
                    what = f"another run holds {path.parent}: {_holder(path)}"
                    raise Locked(what, remedy="wait for it (--wait), or stop it") from None
                time.sleep(0.2)
        since = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        with contextlib.suppress(OSError):  # on a full disk it is held without a word
            file.truncate(0)
            os.write(file.fileno(), json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "since": since}).encode())
        try:
            yield
        finally:
            file.truncate(0)


def _holder(path: Path) -> str:
    try:
        who = json.loads(path.read_text())
        return f"process {who['pid']} on {who['host']} since {who['since']}"
    except (OSError, ValueError, KeyError):
        return "its process has not said who it is"

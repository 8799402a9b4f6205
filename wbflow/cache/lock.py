"""A work folder has one writer, enforced by an flock that the kernel releases when its process dies, however it dies.

It also belongs to one site: if two sites shared a folder, each would be compared with the other's nights.
"""

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

from .. import __version__
from ..errors import ExitCode, UsageError, WbflowError
from .atomic import clear
from .checksum import Damaged, read_checksummed, write_checksummed
from .layout import WorkFolder
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
            os.write(file.fileno(), json.dumps({"pid": os.getpid(), "host": os.uname().nodename, "since": since}).encode())
        try:
            yield
        finally:
            file.truncate(0)


def _open_locked(path: Path, wait: bool) -> IO[str]:
    """Open and lock the file.  Anything else at its path (a folder, a dangling link, a pipe) is removed, unless it is locked."""
    while True:
        if path.is_dir() or (path.is_symlink() and not path.exists()):
            clear(path)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            if not wait:
                what = f"another run holds {path.parent}: {_holder(path)}"
                raise Locked(what, remedy="wait for it (--wait), or stop it") from None
            time.sleep(0.2)
            continue
        status = os.fstat(descriptor)
        with contextlib.suppress(FileNotFoundError):
            current = path.stat()
            if (current.st_dev, current.st_ino) == (status.st_dev, status.st_ino):  # the file was not replaced meanwhile
                if stat.S_ISREG(status.st_mode):
                    return os.fdopen(descriptor, "r+")
                clear(path)
        os.close(descriptor)


def _holder(path: Path) -> str:
    try:
        holder = json.loads(read_untrusted(path))
        return f"process {holder['pid']} on {holder['host']} since {holder['since']}"
    except (OSError, ValueError, KeyError):
        return "which process holds it is unknown"


FORMAT = 1
"""Format version of the work folder; it is increased when wbflow starts to write what older versions cannot use."""
_IDENTITY = "work folder"


def claim(work: WorkFolder, site: str, file: Path) -> str | None:
    """Record which site a work folder belongs to; return a warning if another existing file of this site was the last to use it.

    The caller holds the lock.  An unclaimed folder goes to the first site that claims it.  Sites are identified by name: a site
    file may be moved or renamed.  Raises UsageError if the folder belongs to another site or was written by a newer version of
    wbflow; OSError.
    """
    claimed = {"site": site, "file": str(file.resolve()), "format": FORMAT, "version": __version__}
    try:
        owner = read_checksummed(work.owner, _IDENTITY) or {}
    except Damaged:
        owner = {}
    if owner.get("format", FORMAT) > FORMAT:
        what = f"{work.root} was written by wbflow {owner.get('version')}, and this is wbflow {claimed['version']}"
        raise UsageError(what, remedy="update wbflow, or name another work folder in the site file (work: FOLDER)")
    if owner.get("site", site) != site:
        what = f"{work.root} belongs to the site {owner['site']!r} of {owner.get('file')}, not to {site!r}"
        remedy = f"name another work folder in the site file (work: FOLDER); after renaming a site, remove {work.owner}"
        raise UsageError(what, where=str(file), remedy=remedy)
    if owner != claimed:
        write_checksummed(work.owner, _IDENTITY, claimed)
    previous_file = owner.get("file", claimed["file"])
    if previous_file == claimed["file"] or not Path(previous_file).is_file():
        return None
    return f"{previous_file} has used this work folder, too: tonight is compared with its nights as well"

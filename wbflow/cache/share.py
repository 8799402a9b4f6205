"""Products that are the same as an earlier run's share its bytes on disk: a night in which nothing changed costs nothing."""

from __future__ import annotations

import contextlib
import fcntl
import os
import sys
from pathlib import Path

from .atomic import write_atomic
from .untrusted import open_outside

_FICLONE = 0x40049409
"""The request of Linux that lets a file share another's blocks until either is written (ioctl_ficlone(2))."""

_PIECE = 1 << 22


def write_product(path: Path, data: bytes, earlier: Path | None = None) -> bool:
    """Write a file that is not to be changed any more; returns whether it shares the bytes of the earlier one.

    Where an earlier file holds the same bytes, they are shared: as a clone, where the file system can make one (then nobody can
    tell), else as a second name of the same file.  Products can be read only, so that no program writes through one name what is
    then read under the other; wbflow itself only ever puts new files in the place of old ones.

    Parameters
    ----------
    path : Path
        Where to.
    data : bytes
        What.
    earlier : Path, optional
        A product of an earlier run.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    shares = earlier is not None and _holds(earlier, data) and share_product(path, earlier)
    if not shares:
        write_atomic(path, data)
        _closed(path)
    return shares


def share_product(path: Path, earlier: Path) -> bool:
    """Publish the bytes of an earlier product once more, without reading them; False where the file system cannot."""
    shares = _shared(earlier, path)
    if shares:
        _closed(path)
    return shares


def _closed(path: Path) -> None:
    with contextlib.suppress(OSError):  # a file system without rights: nothing depends on them
        path.chmod(0o444)


def _holds(path: Path, data: bytes) -> bool:
    """Are these the bytes of the file?  A cloud is not held twice for the answer."""
    try:
        if path.stat().st_size != len(data):
            return False
        with os.fdopen(open_outside(path, most=sys.maxsize), "rb") as file:
            return all(file.read(_PIECE) == data[at : at + _PIECE] for at in range(0, len(data), _PIECE))
    except OSError:
        return False


def _shared(earlier: Path, path: Path) -> bool:
    """Give `path` the bytes of `earlier`, if the file system can."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    try:
        with earlier.open("rb") as source, path.open("wb") as target:
            fcntl.ioctl(target, _FICLONE, source.fileno())
            os.fsync(target.fileno())
        return True
    except OSError:
        path.unlink(missing_ok=True)
    try:
        path.hardlink_to(earlier)
    except OSError:
        return False
    return True

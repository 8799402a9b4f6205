"""How much room a disk has, and errors that say it has none."""

from __future__ import annotations

import errno
import re
import shutil
from pathlib import Path

from ..errors import WbflowError

_POWERS = " KMGT"


def bytes_of(text: str) -> int:
    """A size in bytes: 4GB, 1.5G, 800 MB, 2GiB.

    Raises
    ------
    ValueError
        It is none.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(i?)B?\s*", text, re.IGNORECASE)
    if not found or not float(found[1]):
        raise ValueError(f"{text!r} is no size; write for example 50GB or 800MB")
    return int(float(found[1]) * (1024 if found[3] else 1000) ** _POWERS.index(found[2].upper() or " "))


def in_words(size: float) -> str:
    """A size for people: 1.2 GB, 3.4 MB, 12 kB."""
    for power, unit in ((1e9, "GB"), (1e6, "MB")):
        if size >= power:
            return f"{size / power:,.1f} {unit}"
    return f"{size / 1e3:,.0f} kB"


FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Errors of a full disk: of all of it, of the user's share, of the longest file that a process may write."""
REMEDY = "free some space (wbflow clean SITE.yaml --keep 3), or say in the site file what to keep"


def disk_fault(error: OSError, place: Path | str) -> WbflowError:
    """Return the error for people when a file or folder cannot be read or written."""
    remedy = REMEDY if error.errno in FULL else "check the rights on the work folder and its file system"
    return WbflowError(f"{error.filename or place}: {error.strerror or error}", remedy=remedy)


def free_bytes(folder: Path) -> int:
    """What may still be written to the file system of a folder, which need not exist yet."""
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free


def told_full(error: OSError, path: Path | str, need: int) -> OSError:
    """The same error with what was needed and what is free, where it says that a disk is full; else as it is."""
    if error.errno not in FULL:
        return error
    words = f"the disk is full: {in_words(need)} needed, {in_words(free_bytes(Path(path).parent))} free"
    return OSError(error.errno, words, str(path))

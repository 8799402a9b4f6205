"""How much room a disk has, and errors that say it has none."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

from .sizes import in_words

FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Errors of a full disk: of all of it, of the user's share, of the longest file that a process may write."""
REMEDY = "free some space (wbflow clean SITE.yaml --keep 3), or say in the site file what to keep"


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

"""Atomic writes: after a power cut a file is complete or absent.  Also errors that report a full disk."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from pathlib import Path

from ..errors import WbflowError
from ..words import DISK_FULL_REMEDY, format_size

DISK_FULL_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Error numbers of a full disk: no space left, the user's quota exceeded, the file-size limit exceeded."""


UNSUPPORTED_ERRORS = frozenset({errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EPERM, errno.EINVAL})
"""Error numbers with which file systems refuse what they lack: symbolic links, and syncing a folder (SMB, FAT, exFAT, FUSE)."""


def write_atomic(path: Path, data: bytes | bytearray, *, durable: bool = True, own_path: bool = False) -> None:
    """Write a file so that a reader sees either all of it or the old one: temporary name, fsync, rename.

    Parameters
    ----------
    path, data : Path, bytes
        The file and its content.
    durable : bool
        Does the file survive a power cut?  False for dispensable files that are checked on reading: they are not synced.
    own_path : bool
        The path is one of the work folder's own names: a folder in its place is removed.

    Raises OSError; for a full disk, its message states the space needed and the space free.
    """
    # in the same folder, so that the rename stays within one file system; hidden, with a random part that no other writer has
    temporary = path.with_name(f".{path.name}.{os.urandom(8).hex()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as file:
            file.write(data)
            if durable:
                # the content reaches the disk before the rename does: otherwise a power cut could leave an empty file
                file.flush()
                os.fsync(file.fileno())
        if own_path and path.is_dir() and not path.is_symlink():
            clear(path)
        temporary.replace(path)
        if durable:
            sync_folder(path.parent)
    except BaseException as error:  # an interrupt, too, must leave nothing half-written
        with contextlib.suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError) and error.errno in DISK_FULL_ERRORS:
            message = f"the disk is full: {format_size(len(data))} needed, {format_size(free_bytes(path.parent))} free"
            raise OSError(error.errno, message, str(path)) from None
        raise


def clear(path: Path) -> None:
    """Remove whatever is at a path: a file, a link (never its target), a pipe, or a folder with all its content."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Make renames in a folder survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in UNSUPPORTED_ERRORS:
            raise
    finally:
        os.close(descriptor)


def free_bytes(folder: Path) -> int:
    """Return the free bytes on the file system of a folder, which need not exist yet."""
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free


def disk_fault(error: OSError, place: Path | str) -> WbflowError:
    """Return the error to show to the user when a file or folder cannot be read or written."""
    remedy = DISK_FULL_REMEDY if error.errno in DISK_FULL_ERRORS else "check the rights on the work folder and its file system"
    return WbflowError(f"{error.filename or place}: {error.strerror or error}", remedy=remedy)

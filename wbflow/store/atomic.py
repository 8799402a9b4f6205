"""Files that are either there as a whole or not at all, whenever the power goes."""

from __future__ import annotations

import os
import shutil
import uuid
from pathlib import Path

from .room import told_full


def write_atomic(path: Path, data: bytes | bytearray, *, settle: bool = True, ours: bool = False) -> None:
    """Write a file so that a reader, or the next boot, sees all of it or the old one: temporary name, fsync, rename.

    Parameters
    ----------
    path : Path
        Where.
    data : bytes
        What.
    settle : bool
        Make the rename last, too; not needed where another file is written to the same folder right after.
    ours : bool
        The place is one of the work folder's own: a folder that somebody has put there gives way.

    Raises
    ------
    OSError
        One of a full disk says how much was needed, and how much is free.
    """
    temporary = _beside(path)
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if ours and path.is_dir() and not path.is_symlink():
            clear(path)
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise told_full(error, path, len(data)) from None
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    if settle:
        sync_folder(path.parent)


def copy_atomic(path: Path, name: Path) -> None:
    """Put a copy of a file in the place of what bears a name there: what happens to one does not happen to the other.

    Raises
    ------
    OSError
        One of a full disk says how much was needed, and how much is free.
    """
    temporary = _beside(name)
    try:
        shutil.copyfile(path, temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        if name.is_dir() and not name.is_symlink():
            clear(name)
        temporary.replace(name)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise told_full(error, name, path.stat().st_size) from None


def clear(path: Path) -> None:
    """Whatever bears a name of the work folder goes: a file, a link (never what is behind it), a pipe, a folder."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Make renames in a folder last through a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _beside(path: Path) -> Path:
    """A name in the same folder that nobody else has; the folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path.with_name(f".{path.name}.{os.getpid()}.{uuid.uuid4().hex[:8]}.tmp")

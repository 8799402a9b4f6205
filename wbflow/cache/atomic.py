"""Files that are either there as a whole or not at all, whenever the power goes."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .room import told_full

if TYPE_CHECKING:
    import ctypes
    from collections.abc import Iterable

_PIECE = 1 << 20
_MINE = os.urandom(4).hex()
"""Tells this process from those of other machines that have its number."""
_NUMBERS = itertools.count()


def write_atomic(
    path: Path | str, data: bytes | bytearray, *, settle: bool = True, lasts: bool = True, ours: bool = False
) -> None:
    """Write a file so that a reader, or the next boot, sees all of it or the old one: temporary name, fsync, rename.

    Parameters
    ----------
    path : Path or str
        Where.
    data : bytes
        What.
    settle : bool
        Make the rename last, too; not needed where another file is written to the same folder right after.
    lasts : bool
        After the power went, the file must not be there in part.  False where that would be noticed, and it can be made again.
    ours : bool
        The place is one of the work folder's own: a folder that somebody has put there gives way.

    Raises
    ------
    OSError
        One of a full disk says how much was needed, and how much is free.
    """
    put(prepare(path, data, lasts=lasts), ours=ours)
    if settle and lasts:
        sync_folder(os.path.dirname(path) or ".")  # noqa: PTH120


@dataclass(frozen=True)
class Prepared:
    """A file that is written, and not yet in its place."""

    temporary: str
    path: Path | str
    size: int

    def drop(self) -> None:
        """It is not wanted any more."""
        _drop(self.temporary)


def prepare(path: Path | str, data: bytes | bytearray, *, lasts: bool = False) -> Prepared:
    """Write a file under a temporary name beside its place, on a disk that has room for it; `put` is the rest.

    lasts: see `write_atomic`.  Raises OSError.
    """
    temporary = _beside(path)
    try:
        _fill(_opened(temporary), [data], lasts)
    except OSError as error:
        _drop(temporary)
        raise told_full(error, path, len(data)) from None
    except BaseException:
        _drop(temporary)
        raise
    return Prepared(temporary, path, len(data))


def put(prepared: Prepared, *, ours: bool = False) -> None:
    """Put a file into its place with one rename.  ours: see `write_atomic`.  Raises OSError."""
    try:
        _into_place(prepared.temporary, prepared.path, ours)
    except OSError as error:
        prepared.drop()
        raise told_full(error, prepared.path, prepared.size) from None
    except BaseException:
        prepared.drop()
        raise


def copy_atomic(path: Path | str, name: Path | str, *, lasts: bool = True) -> None:
    """Put a copy of a file in the place of what bears a name there: what happens to one does not happen to the other.

    Parameters
    ----------
    path, name : Path or str
        From where to where.
    lasts : bool
        The power may go any moment.  False where the caller makes many copies last at once (see `sync_all`).

    Raises
    ------
    OSError
        One of a full disk says how much was needed, and how much is free.
    """
    temporary = _beside(name)
    try:
        _copy(path, _opened(temporary), lasts)
        _into_place(temporary, name, gives_way=True)
    except OSError as error:
        _drop(temporary)
        raise told_full(error, name, os.stat(path).st_size) from None  # noqa: PTH116


def copy_new(path: Path | str, name: Path | str) -> None:
    """Put a copy of a file where nobody looks for one before something else says so; the caller makes it last (`sync_all`).

    It is not there as a whole or not at all, unless something was there before.  Raises OSError.
    """
    try:
        target = _opened(name, os.O_EXCL)
    except FileExistsError:  # of an earlier time, and somebody may look for it
        copy_atomic(path, name, lasts=False)
        return
    try:
        _copy(path, target)
    except OSError as error:
        _drop(name)
        raise told_full(error, name, os.stat(path).st_size) from None  # noqa: PTH116


def _copy(path: Path | str, target: int, lasts: bool = False) -> None:
    """Copy a file into a new one, and close that."""
    try:
        source = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        os.close(target)
        raise
    try:
        _fill(target, iter(lambda: os.read(source, _PIECE), b""), lasts)
    finally:
        os.close(source)


def _fill(target: int, pieces: Iterable[bytes | bytearray], lasts: bool = False) -> None:
    """Write all of it to a new file, and close that.  (Descriptors: a file object takes three more calls of the kernel.)"""
    try:
        for piece in pieces:
            written = os.write(target, piece)
            while written < len(piece):  # no more than 2 GB at once, and less where the disk is nearly full
                written += os.write(target, memoryview(piece)[written:])
        if lasts:
            os.fsync(target)
    finally:
        os.close(target)


def sync_all(folder: Path) -> None:
    """Make all that was written to the file system of a folder last: many files at once cost what one does."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        syncfs = getattr(_libc(), "syncfs", None)
        if syncfs is None:  # not Linux
            os.sync()
        elif syncfs(descriptor) != 0:
            from ctypes import get_errno

            raise OSError(get_errno(), os.strerror(get_errno()), str(folder))
    finally:
        os.close(descriptor)


@functools.cache
def _libc() -> ctypes.CDLL:
    import ctypes  # here: it takes a while, and a night with nothing to do syncs no file system

    return ctypes.CDLL(None, use_errno=True)


def clear(path: Path) -> None:
    """Whatever bears a name of the work folder goes: a file, a link (never what is behind it), a pipe, a folder."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def sync_folder(folder: Path | str) -> None:
    """Make renames in a folder last through a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _beside(path: Path | str) -> str:
    """A name in the same folder that nobody else has."""
    folder, _, name = os.fspath(path).rpartition("/")
    return f"{folder or '.'}/.{name}.{os.getpid()}.{_MINE}.{next(_NUMBERS)}.tmp"


def _opened(name: Path | str, flag: int = 0) -> int:
    """A new file, as a descriptor; its folder is made where there is none."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC | flag
    try:
        return os.open(name, flags, 0o666)
    except FileNotFoundError:
        _make_folder(os.fspath(name).rpartition("/")[0])
        return os.open(name, flags, 0o666)


def _make_folder(folder: str) -> None:
    """With those around it, of which most are there: each task has a folder."""
    try:
        os.mkdir(folder)  # noqa: PTH102 (hot path)
    except FileNotFoundError:
        os.makedirs(folder, exist_ok=True)  # noqa: PTH103
    except FileExistsError:  # somebody else has just made it
        return


def _into_place(temporary: str, path: Path | str, gives_way: bool) -> None:
    """The last step; a folder that stands in the place gives way, where it may."""
    try:
        os.replace(temporary, path)  # noqa: PTH105 (hot path)
    except IsADirectoryError:
        if not gives_way:
            raise
        clear(Path(path))
        os.replace(temporary, path)  # noqa: PTH105


def _drop(temporary: Path | str) -> None:
    with contextlib.suppress(FileNotFoundError):
        os.unlink(temporary)  # noqa: PTH108

"""The only place that opens files from outside: captures, masks, site files, calibrations.

Anything may lie in the folders that are searched for captures.  Only regular files are opened (a pipe or a device is refused
at once instead of blocking the reader), only up to a sensible size, and no folder is searched twice, even if links lead back
to it.
"""

from __future__ import annotations

import errno
import fnmatch
import os
import re
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

from ..errors import WbflowError

MOST_CAPTURE_BYTES = 1_000_000_000
"""Largest size of an image file or mask."""
MOST_TEXT_BYTES = 50_000_000
"""Largest size of a site file or calibration."""
MOST_ENTRIES = 1_000_000
"""Most directory entries that one search for captures may visit."""

NOBODYS = (
    ".*",
    # Synology, QNAP: thumbnails, waste baskets, snapshots, indices
    *("@eaDir", "@Recycle", "@Recently-Snapshot", "@tmp", "@SynoResource", "#recycle", "#snapshot", "SYNOPHOTO_*", "SYNOINDEX_*"),
    # Windows, macOS, ext4
    *("$RECYCLE.BIN", "System Volume Information", "Thumbs.db", "ehthumbs.db", "desktop.ini", "__MACOSX", "lost+found"),
)
"""Names of files and folders that disks and their servers keep for themselves, in any case; they are nobody's captures."""
_NOBODYS = re.compile("|".join(fnmatch.translate(name) for name in NOBODYS), re.IGNORECASE)

_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
}


class Unreadable(WbflowError, OSError):
    """A file cannot be read, or is refused; `what` is the reason, without the file's name."""


def read_untrusted(path: Path | str, most: int = MOST_CAPTURE_BYTES) -> bytes:
    """Return all bytes of a file.  Raises Unreadable if it is missing, not a regular file or too large, or if the disk fails."""
    with os.fdopen(open_untrusted(path, most), "rb") as file:
        try:
            size = os.fstat(file.fileno()).st_size
            data = file.read(size + 1)
        except OSError as error:
            raise Unreadable(f"cannot be read: {error.strerror or error}") from None
    if len(data) > size:
        raise Unreadable("grows while it is read")
    return data


def open_untrusted(path: Path | str, most: int = MOST_CAPTURE_BYTES) -> int:
    """Return a file descriptor, which the caller closes.  Raises Unreadable, as `read_untrusted` does."""
    try:
        _check_file(os.stat(path), most)  # noqa: PTH116  (before it is opened: opening some devices has side effects)
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except Unreadable:
        raise
    except (OSError, ValueError) as error:
        raise Unreadable(f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    try:
        _check_file(os.fstat(descriptor), most)  # the file may have been replaced since the first check
    except Unreadable:
        os.close(descriptor)
        raise
    return descriptor


def is_file(path: Path) -> bool:
    """Is there a regular file?  Never raises, not even for an invalid path."""
    return os.path.isfile(path)  # noqa: PTH113  (Path.is_file raises for names that are too long)


def is_folder(path: Path) -> bool:
    """Is there a folder?  Never raises."""
    return os.path.isdir(path)  # noqa: PTH112


def is_nobodys(name: str) -> bool:
    """Is a file or folder of this name kept by a disk or its server for itself, such as thumbnails, or hidden?"""
    return _NOBODYS.match(name) is not None


def find_untrusted(pattern: str, unreadable: Callable[[OSError], None] | None = None) -> Iterator[str]:
    """Yield the paths that a pattern matches, as `glob` does (`*`, `?`, `[...]`, `**` for nested folders).

    Unlike `glob`, wildcards match nobody's files (`is_nobodys`), the case of the last suffix is ignored (cameras write .JPG and
    .jpg), and each folder is visited only once, however many links lead to it.  Raises Unreadable beyond `MOST_ENTRIES` entries.

    unreadable: called for each folder that is there and cannot be read, with an error whose `filename` is the folder; such
    folders are passed over.
    """
    search = _Search(unreadable or (lambda error: None))
    parts = Path(pattern).parts
    if Path(pattern).is_absolute():
        yield from search.below(parts[0], parts[1:])
    else:
        yield from search.below("", parts)


class _Search:
    """One search; counts the directory entries that it visits."""

    def __init__(self, unreadable: Callable[[OSError], None]) -> None:
        self._unreadable = unreadable
        self._entry_count = 0

    def below(self, folder: str, parts: tuple[str, ...]) -> Iterator[str]:
        """Yield the paths in a folder that match the remaining parts of a pattern."""
        if not parts:
            if self._is_there(folder):
                yield folder
            return
        first = parts[0]
        rest = parts[1:]
        if first == "**":
            # any number of folders, none included: the rest is looked for in each
            for inner, files in self._folders(folder):
                if rest:
                    yield from self.below(inner, rest)
                else:
                    yield inner
                    yield from files
        elif not any(wildcard in first for wildcard in "*?["):
            # a plain name need not be looked up in a listing; only that of a file may differ in case
            path = os.path.join(folder, first)  # noqa: PTH118  (names need not be valid text)
            if rest:
                if self._is_folder(path):
                    yield from self.below(path, rest)
                return
            for name in _in_any_case(folder, first):
                yield from self.below(os.path.join(folder, name), rest)  # noqa: PTH118
        else:
            matches = _matcher(first, is_last=not rest)
            for entry in self._entries(folder):
                if not matches(entry.name) or (is_nobodys(entry.name) and not first.startswith(".")):
                    continue
                if not rest or _is_dir(entry):
                    yield from self.below(entry.path, rest)

    def _folders(self, top: str) -> Iterator[tuple[str, list[str]]]:
        """Yield a folder and all folders below it, each once, and the files in each.  Symbolic links are followed last."""
        seen: set[tuple[int, int]] = set()  # device and inode, which links cannot hide
        # links wait: a folder is found under its own path if it has one here, and under a link only otherwise
        folders = [top]
        linked: list[str] = []
        while folders or linked:
            folder = (folders or linked).pop(0)
            try:
                status = os.stat(folder or ".")  # noqa: PTH116
            except OSError as error:
                self._pass_over(folder, error)
                continue
            if (status.st_dev, status.st_ino) in seen:
                continue
            seen.add((status.st_dev, status.st_ino))
            files = []
            for entry in self._entries(folder):
                if is_nobodys(entry.name):
                    continue
                if _is_dir(entry):
                    (linked if entry.is_symlink() else folders).append(entry.path)
                else:
                    files.append(entry.path)
            yield folder, files

    def _entries(self, folder: str) -> list[os.DirEntry[str]]:
        """Entries of a folder by name, none if it cannot be read.  Raises Unreadable beyond `MOST_ENTRIES` in all."""
        try:
            with os.scandir(folder or ".") as iterator:
                entries = sorted(iterator, key=lambda entry: entry.name)
        except OSError as error:
            self._pass_over(folder, error)
            return []
        self._entry_count += len(entries)
        if self._entry_count > MOST_ENTRIES:
            remedy = "name the folders in captures.pattern instead of using ** or *"
            raise Unreadable(f"more than {MOST_ENTRIES:,} files would have to be looked at", where=folder, remedy=remedy)
        return entries

    def _is_folder(self, path: str) -> bool:
        """Is there a folder that can be entered?  What is in its place is reported."""
        try:
            status = os.stat(path)  # noqa: PTH116
        except OSError as error:
            # the right that is missing is that to look into the folder above
            self._pass_over(os.path.dirname(path) if isinstance(error, PermissionError) else path, error)  # noqa: PTH120
            return False
        except ValueError:  # a zero byte
            return False
        if not stat.S_ISDIR(status.st_mode):
            self._pass_over(path, NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)))
            return False
        return True

    def _is_there(self, path: str) -> bool:
        """Is there anything of this name, be it a link that leads nowhere?"""
        try:
            os.lstat(path)
        except OSError as error:
            self._pass_over(os.path.dirname(path), error)  # noqa: PTH120
            return False
        except ValueError:
            return False
        return True

    def _pass_over(self, folder: str, error: OSError) -> None:
        """Report a folder that is there and cannot be read."""
        if not isinstance(error, FileNotFoundError):
            self._unreadable(type(error)(error.errno, error.strerror, folder or "."))


def _matcher(part: str, is_last: bool) -> Callable[[str], object]:
    """A function that says whether a name matches one part of a pattern; the case of a file's suffix does not matter."""
    stem, dot, suffix = part.rpartition(".")
    if is_last and dot and suffix.isalnum():
        # jpg becomes [jJ][pP][gG]: only the suffix ignores case
        either_case = [f"[{letter.lower()}{letter.upper()}]" if letter.isalpha() else letter for letter in suffix]
        part = f"{stem}.{''.join(either_case)}"
    return re.compile(fnmatch.translate(part)).match


def _in_any_case(folder: str, name: str) -> list[str]:
    """The names of files in a folder that differ from this one at most in the case of their suffix; else the name itself.

    On a disk that ignores case, several names lead to one file, which is listed once.
    """
    stem, dot, suffix = name.rpartition(".")
    if not dot:
        return [name]
    found: dict[tuple[int, int], str] = {}
    for variant in dict.fromkeys((suffix, suffix.lower(), suffix.upper(), suffix.capitalize())):
        candidate = f"{stem}.{variant}"
        try:
            status = os.lstat(os.path.join(folder, candidate))  # noqa: PTH118
        except (OSError, ValueError):
            continue
        found.setdefault((status.st_dev, status.st_ino), candidate)
    return list(found.values()) or [name]


def _is_dir(entry: os.DirEntry[str]) -> bool:
    """Is it a folder, or a link to one?  A link that leads nowhere or in a circle is not."""
    try:
        return entry.is_dir()
    except OSError:
        return False


def _check_file(status: os.stat_result, most_bytes: int) -> None:
    """Raise Unreadable for what is not a regular file, and for one that is too large."""
    if not stat.S_ISREG(status.st_mode):
        raise Unreadable(f"is {_KINDS.get(stat.S_IFMT(status.st_mode), 'no file')}, not a file")
    if status.st_size > most_bytes:
        raise Unreadable(f"has {status.st_size:,} bytes, {most_bytes:,} are the most that such a file may have")

"""Memos that persist between runs: digests of files, valid while a file does not change, and captures of earlier nights.

A file younger than two seconds is always read again: it may change once more within the resolution of its time stamp.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..errors import WbflowError
from .checksum import Damaged, file_digest, read_checksummed, write_checksummed

_STABLE_NS = 2_000_000_000
"""Digests of files younger than this (nanoseconds) are not reused: see the module's docstring."""
_FORMER = 2000
"""Number of digests that are kept for files which this run has not looked up."""
NIGHTS = 60
"""Number of nights whose captures are remembered, per camera."""


class ChangedFile(WbflowError):
    """The content of a file from outside has changed since its digest was taken."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} has changed while the night was being worked on")
        self.path = path


class Memo:
    """A dictionary that is kept between runs in a file with a checksum."""

    def __init__(self, path: Path | None, of: str, cost: str) -> None:
        """path: None keeps nothing.  cost: in words, the consequence of a damaged file."""
        self._path = path
        self._of = of
        self.damage: str | None = None
        """What was wrong with the file, in words; None if it was intact."""
        self.entries: dict[str, Any] = {}
        if path:
            try:
                self.entries = read_checksummed(path, of) or {}
            except Damaged as damage:
                self.damage = f"{damage.what}: {cost}"
        self._changed = self.damage is not None  # a damaged file is written again

    def save(self) -> None:
        """Write the file, if anything has changed.  Raises OSError."""
        if self._path and self._changed:
            write_checksummed(self._path, self._of, self.entries)
            self._changed = False


class Digests(Memo):
    """Digests of files by path, size, time stamps and inode."""

    def __init__(self, memo: Path | None) -> None:
        super().__init__(memo, "digests of captures", "captures are read again")
        self._files: dict[str, list[Any]] = self.entries.setdefault("files", {})
        self._used: dict[str, None] = {}

    def of(self, path: Path) -> str:
        """Return the content digest of a file.  Raises OSError."""
        name = str(path)
        status = path.stat()
        self._used[name] = None
        stamp = _stamp(status)
        known_entry = self._files.get(name)  # the stamp of the file when it was read, and its digest
        is_stable = time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) > _STABLE_NS
        if known_entry and known_entry[:-1] == stamp and is_stable:
            return str(known_entry[-1])
        digest = file_digest(path)
        if is_stable and _stamp(path.stat()) == stamp:  # unchanged while it was read
            self._files[name] = [*stamp, digest]
            self._changed = True
        return digest

    def forget(self, path: Path) -> None:
        """Forget the digest of a file, so that it is read again."""
        self._changed |= self._files.pop(str(path), None) is not None

    def save(self) -> None:
        # files of this run last: the oldest are at the front, and are dropped first
        unused = [name for name in self._files if name not in self._used]
        used = [name for name in self._used if name in self._files]
        self._files = {name: self._files[name] for name in [*unused[-_FORMER:], *used]}
        self.entries["files"] = self._files
        super().save()


def file_stamp(path: Path | str) -> list[int] | None:
    """Return a stamp that differs once a file has been modified or replaced; None if there is no file."""
    try:
        return _stamp(os.stat(path))  # noqa: PTH116 (strings are accepted, too: faster for many files)
    except OSError:
        return None


def _stamp(status: os.stat_result) -> list[int]:
    """Return size, mtime_ns, ctime_ns and inode."""
    return [status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino]


class EarlierCaptures(Memo):
    """Digests of captures by camera and night (ISO 8601)."""

    def __init__(self, memo: Path) -> None:
        cost = "the record of what cameras delivered before tonight is lost"
        super().__init__(memo, "captures of earlier nights", cost)
        self._cameras: dict[str, dict[str, list[str]]] = self.entries.setdefault("cameras", {})

    def last_delivered(self, camera: str, night: str) -> dict[str, str]:
        """Return, for each digest that a camera delivered before `night`, the newest such night."""
        newest: dict[str, str] = {}
        for date, digests in sorted(self._cameras.get(camera, {}).items()):
            if date < night:
                newest |= dict.fromkeys(digests, date)  # later nights replace earlier ones
        return newest

    def note(self, camera: str, night: str, digests: Iterable[str]) -> None:
        """Remember what a camera delivered in a night.  If the night is run again, the new digests replace the old ones."""
        nights = self._cameras.setdefault(camera, {})
        delivered = sorted({digest for digest in digests if digest})
        if delivered and nights.get(night) != delivered:
            nights[night] = delivered
            self._cameras[camera] = {date: nights[date] for date in sorted(nights)[-NIGHTS:]}
            self._changed = True

"""What was learnt of files, remembered from run to run: digests, for as long as a file does not change, and earlier captures.

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

_SETTLED_NS = 2_000_000_000
"""A file younger than this may change again within its time stamp's resolution."""
_FORMER = 2000
"""So many files that were not looked up this time are remembered besides those that were."""
NIGHTS = 60
"""So many nights of captures are remembered."""


class ChangedFile(WbflowError):
    """A file from outside does not hold any more what it held when its digest was taken."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} has changed while the night was being worked on")
        self.path = path

    def __reduce__(self) -> tuple[type[ChangedFile], tuple[Path]]:  # it comes back from worker processes
        return type(self), (self.path,)


class Memo:
    """A file with a checksum of what was learnt, kept between runs."""

    def __init__(self, path: Path | None, of: str, cost: str) -> None:
        """path: None keeps nothing.  cost: what it means, in words, when the file is damaged."""
        self._path, self._of = path, of
        self.damage: str | None = None
        """What was wrong with the file, if anything was."""
        self.entries: dict[str, Any] = {}
        try:
            self.entries = (read_checksummed(path, of) if path else None) or {}
        except Damaged as damage:
            self.damage = f"{damage.what}: {cost}"
        self._changed = self.damage is not None

    def save(self) -> None:
        """Keep what was learnt.  Raises OSError."""
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
        """The content digest of a file.  Raises OSError."""
        name, status = str(path), path.stat()
        self._used[name] = None
        before, known = _stamp(status), self._files.get(name)
        settled = time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) > _SETTLED_NS
        if known and known[:-1] == before and settled:
            return str(known[-1])
        digest = file_digest(path)
        if settled and _stamp(path.stat()) == before:  # the file is the one that was looked at before it was read
            self._files[name] = [*before, digest]
            self._changed = True
        return digest

    def forget(self, path: Path) -> None:
        """What is remembered of a file is wrong: it is read again."""
        self._changed |= self._files.pop(str(path), None) is not None

    def save(self) -> None:
        former = [name for name in self._files if name not in self._used][-_FORMER:]
        kept = [*former, *(name for name in self._used if name in self._files)]
        self._files = self.entries["files"] = {name: self._files[name] for name in kept}
        super().save()


def file_stamp(path: Path | str) -> list[int] | None:
    """What tells that a file has been touched, or replaced; None where there is none."""
    try:
        return _stamp(os.stat(path))  # noqa: PTH116 (a string where many are looked at)
    except OSError:
        return None


def _stamp(status: os.stat_result) -> list[int]:
    """Size, last change of its content and of anything, inode."""
    return [status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino]


class EarlierCaptures(Memo):
    """Digests of captures by camera and night (ISO 8601)."""

    def __init__(self, memo: Path) -> None:
        cost = "what cameras have delivered before tonight is forgotten"
        super().__init__(memo, "captures of earlier nights", cost)
        self._cameras: dict[str, dict[str, list[str]]] = self.entries.setdefault("cameras", {})

    def before(self, camera: str, night: str) -> dict[str, str]:
        """The newest earlier night of each digest that a camera has delivered."""
        earlier = sorted((date, found) for date, found in self._cameras.get(camera, {}).items() if date < night)
        return {digest: date for date, found in earlier for digest in found}

    def note(self, camera: str, night: str, digests: Iterable[str]) -> None:
        """Remember what a camera delivers tonight.  A night that is run again is remembered as it is now."""
        nights = self._cameras.setdefault(camera, {})
        found = sorted({digest for digest in digests if digest})
        if found and nights.get(night) != found:
            nights[night] = found
            self._cameras[camera] = {date: nights[date] for date in sorted(nights)[-NIGHTS:]}
            self._changed = True

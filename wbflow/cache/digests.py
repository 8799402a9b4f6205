"""Digests of files from outside, remembered from run to run as long as a file does not change."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from ..errors import WbflowError
from .artifact import file_digest
from .signed import Damaged, read_signed, write_signed

_SETTLED_NS = 2_000_000_000  # a file younger than this may change again within its time stamp's resolution
_OF = "digests of captures"
_FORMER = 2000
"""So many files that were not asked for this time are remembered besides those that were."""


class ChangedFile(WbflowError):
    """A file from outside does not hold any more what it held when its digest was taken."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} has changed while the night was being worked on")
        self.path = path

    def __reduce__(self) -> tuple[type[ChangedFile], tuple[Path]]:  # it comes back from worker processes
        return type(self), (self.path,)


class Stamp(NamedTuple):
    """What tells that a file has been touched."""

    size: int
    mtime_ns: int
    """Last change of its content."""
    ctime_ns: int
    """Last change of anything."""
    inode: int


@dataclass
class Digests:
    """Digests of files by path, size, time stamps and inode, kept in a signed file between runs."""

    memo: Path | None
    damage: str | None = None
    """What was wrong with the memo, if anything was: then every file is read again."""
    _known: dict[str, list[int | str]] = field(default_factory=dict)
    _asked: dict[str, None] = field(default_factory=dict)
    _changed: bool = False

    def __post_init__(self) -> None:
        try:
            known = read_signed(self.memo, _OF) if self.memo else None
        except Damaged as damage:
            self.damage = f"{damage.what}: captures are read again"
            self._changed = True
            known = None
        self._known = dict(known.get("files", {})) if known else {}

    def of(self, path: Path) -> str:
        """The content digest of a file.  Raises OSError."""
        name = str(path)
        self._asked[name] = None
        status = os.stat(name)  # noqa: PTH116 (hot path)
        stamp = list(stamp_of(status))
        known = self._known.get(name)
        settled = is_settled(status.st_mtime_ns, status.st_ctime_ns)
        if known and known[:-1] == stamp and settled:
            return str(known[-1])
        digest = file_digest(path)
        # remembered only if the file is the one that was looked at before it was read
        if settled and list(stamp_of(path.stat())) == stamp:
            self._known[name] = [*stamp, digest]
            self._changed = True
        return digest

    def forget(self, path: Path) -> None:
        """What is remembered of a file is wrong: it is read again."""
        self._changed |= self._known.pop(str(path), None) is not None

    def save(self) -> None:
        """Keep what was learnt.  Raises OSError."""
        if self.memo and self._changed:
            former = [name for name in self._known if name not in self._asked][-_FORMER:]
            kept = [*former, *(name for name in self._asked if name in self._known)]
            write_signed(self.memo, _OF, {"files": {name: self._known[name] for name in kept}})
            self._changed = False


def stamp_of(status: os.stat_result) -> Stamp:
    """What of a file's status tells that it has been touched."""
    return Stamp(status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino)


def stamp_at(path: str | Path) -> Stamp | None:
    """The stamp of what lies under a path; None where nothing does."""
    try:
        return stamp_of(os.stat(path))  # noqa: PTH116 (hot path)
    except (OSError, ValueError):
        return None


def is_settled(*times_ns: int) -> bool:
    """Do these times lie so far back that another change would show in them?"""
    return time.time_ns() - max(times_ns) > _SETTLED_NS


_OF = "captures of earlier nights"
NIGHTS = 60
"""So many are remembered."""


class Seen:
    """Digests of captures by camera and night (ISO 8601), kept in a signed file between runs."""

    def __init__(self, memo: Path) -> None:
        self._memo = memo
        self.damage: str | None = None
        """What was wrong with the memo, if anything was."""
        try:
            known = read_signed(memo, _OF)
        except Damaged as damage:
            self.damage = f"{damage.what}: what cameras have delivered before tonight is forgotten"
            known = None
        self._nights: dict[str, dict[str, list[str]]] = dict(known.get("cameras", {})) if known else {}
        self._changed = self.damage is not None

    def before(self, camera: str, night: str) -> dict[str, str]:
        """The newest earlier night of each digest that a camera has delivered."""
        earlier = sorted((date, found) for date, found in self._nights.get(camera, {}).items() if date < night)
        return {digest: date for date, found in earlier for digest in found}

    def note(self, camera: str, night: str, digests: Iterable[str]) -> None:
        """Remember what a camera delivers tonight.  A night that is run again is remembered as it is now."""
        nights = self._nights.setdefault(camera, {})
        found = sorted({digest for digest in digests if digest})
        if found and nights.get(night) != found:
            nights[night] = found
            self._nights[camera] = {date: nights[date] for date in sorted(nights)[-NIGHTS:]}
            self._changed = True

    def save(self) -> None:
        """Keep what was learnt.  Raises OSError."""
        if self._changed:
            write_signed(self._memo, _OF, {"cameras": self._nights})
            self._changed = False

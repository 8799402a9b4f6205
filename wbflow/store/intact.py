"""Files that were read once and found intact: they are not read again as long as nothing touches them.

A night in which nothing changed publishes the same cloud, of some hundred megabytes, once more.  What it holds was compared with
its digest when it was last read; size, times and inode tell whether anybody has written to it since.  `wbflow check` reads all of
it, whatever is remembered here.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from .artifact import digest
from .layout import WorkFolder
from .signed import Damaged, read_signed, write_signed

_OF = "files found intact"
_SETTLED_NS = 2_000_000_000  # a younger file may change again within its time stamp's resolution


@dataclass
class Intact:
    """What is remembered of artifacts that are published, and of the files that were made of them, in a signed file."""

    work: WorkFolder
    _artifacts: dict[str, list[int | str]] = field(default_factory=dict)
    _products: dict[str, list[int | str]] = field(default_factory=dict)
    _changed: bool = False

    def __post_init__(self) -> None:
        try:
            told = read_signed(self.work.intact_memo, _OF) or {}
        except Damaged:  # it costs reading the files once more
            told = {}
        self._artifacts, self._products = told.get("artifacts", {}), told.get("products", {})

    def holds(self, artifact: Path, sought: str) -> bool:
        """Is an artifact known to hold the bytes of a digest?"""
        stamp = _stamp(artifact)
        return stamp is not None and self._artifacts.get(self.work.place(artifact)) == [*stamp, sought]

    def read(self, artifact: Path, found: str) -> None:
        """An artifact was read just now, and its bytes have this digest."""
        if (stamp := _stamp(artifact)) is not None:
            self._artifacts[self.work.place(artifact)] = [*stamp, found]
            self._changed = True

    def product(self, name: str, of: str, runs: Iterable[str]) -> tuple[Path, str] | None:
        """A file of an earlier run that holds what is to be published, and its SHA-256; None where none is known to.

        Parameters
        ----------
        name : str
            Of the file.
        of : str
            What it is made of (see `made_of`).
        runs : iterable of str
            Where it is looked for.
        """
        known = self._products.get(name)
        if not known or known[-2] != of:
            return None
        for run in runs:
            path = self.work.run(run).folder / name
            if (stamp := _stamp(path, lasting=True)) is not None and _lasting(stamp) == known[:-2]:
                return path, str(known[-1])
        return None

    def published(self, path: Path, of: str, sha256: str) -> None:
        """A file of an earlier run was read just now, and holds what is to be published.

        Parameters
        ----------
        path : Path
            Which.
        of : str
            What it is made of.
        sha256 : str
            Of its bytes.
        """
        if (stamp := _stamp(path, lasting=True)) is not None:
            self._products[path.name] = [*_lasting(stamp), of, sha256]
            self._changed = True

    def save(self) -> None:
        """Keep what was learnt.  Raises OSError."""
        if self._changed:
            here = {place: entry for place, entry in self._artifacts.items() if (self.work.cache / place).exists()}
            write_signed(self.work.intact_memo, _OF, {"artifacts": here, "products": self._products})
            self._changed = False


def made_of(artifact: str, comments: Iterable[str]) -> str:
    """What a published file is made of, as a digest: an artifact by its digest, and comments that are added to it."""
    return digest(json.dumps([artifact, *comments]).encode())


def _stamp(path: Path, lasting: bool = False) -> tuple[int, int, int, int] | None:
    """Size, inode, time of the last change of content and of the last change of anything; None for a file that is not there, or
    so young that it may change again within them.

    lasting: only its content counts, it may have got another name just now.
    """
    try:
        status = os.stat(path)  # noqa: PTH116 (hot path)
    except OSError:
        return None
    youngest = status.st_mtime_ns if lasting else max(status.st_mtime_ns, status.st_ctime_ns)
    if time.time_ns() - youngest <= _SETTLED_NS:
        return None
    return status.st_size, status.st_ino, status.st_mtime_ns, status.st_ctime_ns


def _lasting(stamp: tuple[int, int, int, int]) -> list[int | str]:
    """Without the time of the last change of anything: a file that is published again gets one more name."""
    return list(stamp[:3])

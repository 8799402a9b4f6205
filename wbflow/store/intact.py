"""Files that were read once and found intact: they are not read again as long as nothing touches them.

A night in which nothing changed publishes the same cloud, of some hundred megabytes, once more.  What it holds was compared with
its digest when it was last read; size, times and inode tell whether anybody has written to it since.  `wbflow check` reads all of
it, whatever is remembered here.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

from .artifact import digest
from .digests import Stamp, is_settled, stamp_of
from .layout import WorkFolder
from .signed import Damaged, read_signed, write_signed

_OF = "files found intact"


@dataclass(frozen=True)
class _Product:
    """A published file, as it was when it was read."""

    size: int
    mtime_ns: int
    inode: int
    """Without the time of the last change of anything: a file that is published again gets one more name."""
    of: str
    sha256: str


@dataclass(frozen=True)
class Published:
    """A file of an earlier run that is as it was when it was read."""

    path: Path
    of: str
    """What it is made of (see `made_of`)."""
    sha256: str


@dataclass
class Intact:
    """What is remembered of artifacts that are published, and of the files that were made of them, in a signed file."""

    work: WorkFolder
    _artifacts: dict[str, list[int | str]] = field(default_factory=dict)
    """Stamp and digest by place."""
    _products: dict[str, _Product] = field(default_factory=dict)
    """By name."""
    _changed: bool = False

    def __post_init__(self) -> None:
        try:
            told = read_signed(self.work.intact_memo, _OF) or {}
            self._products = {name: _Product(**entry) for name, entry in told.get("products", {}).items()}
            self._artifacts = told.get("artifacts", {})
        except (Damaged, TypeError):  # it costs reading the files once more
            self._products = {}

    def holds(self, artifact: Path, sought: str) -> bool:
        """Is an artifact known to hold the bytes of a digest?"""
        stamp = _settled(artifact)
        return stamp is not None and self._artifacts.get(self.work.place(artifact)) == [*stamp, sought]

    def read(self, artifact: Path, found: str) -> None:
        """An artifact was read just now, and its bytes have this digest."""
        if (stamp := _settled(artifact)) is not None:
            self._artifacts[self.work.place(artifact)] = [*stamp, found]
            self._changed = True

    def earlier(self, name: str) -> Published | None:
        """The newest file of that name which is as it was when it was read; None where there is none in the last runs."""
        if known := self._products.get(name):
            for run in self._runs:
                path = self.work.run(run).folder / name
                if _product(path, known.of, known.sha256) == known:
                    return Published(path, known.of, known.sha256)
        return None

    @cached_property
    def _runs(self) -> list[str]:
        return self.work.newest_runs()

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
        if found := _product(path, of, sha256):
            self._products[path.name] = found
            self._changed = True

    def save(self) -> None:
        """Keep what was learnt.  Raises OSError."""
        if self._changed:
            here = {place: entry for place, entry in self._artifacts.items() if (self.work.cache / place).exists()}
            products = {name: asdict(product) for name, product in self._products.items()}
            write_signed(self.work.intact_memo, _OF, {"artifacts": here, "products": products})
            self._changed = False


def made_of(artifact: str, comments: Iterable[str]) -> str:
    """What a published file is made of, as a digest: an artifact by its digest, and comments that are added to it."""
    return digest(json.dumps([artifact, *comments]).encode())


def _settled(path: Path) -> Stamp | None:
    """The stamp of a file; None for one that is not there, or so young that it may change again within its times."""
    try:
        stamp = stamp_of(os.stat(path))  # noqa: PTH116 (hot path)
    except OSError:
        return None
    return stamp if is_settled(stamp.mtime_ns, stamp.ctime_ns) else None


def _product(path: Path, of: str, sha256: str) -> _Product | None:
    """A file as it is now; None for one that is not there, or whose content is so young that it may change again."""
    try:
        stamp = stamp_of(os.stat(path))  # noqa: PTH116 (hot path)
    except OSError:
        return None
    return _Product(stamp.size, stamp.mtime_ns, stamp.inode, of, sha256) if is_settled(stamp.mtime_ns) else None

"""The cache: one artifact and one receipt for each task and key.  A task without a receipt is not done.

A key is the hash of everything that determines an artifact.  Inputs enter by the digest of their content: if an upstream task
runs again and gives the same bytes, the tasks after it stay cached.
"""

from __future__ import annotations

import sys
from collections import UserDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import WbflowError
from ..task import Task
from . import artifact
from .atomic import clear, write_atomic
from .checksum import Damaged, content_digest, read_checksummed, write_checksummed
from .layout import WorkFolder
from .memo import file_stamp
from .receipt import Preimage, Receipt
from .untrusted import read_untrusted


class DamagedArtifact(WbflowError):
    """The bytes on disk do not match the digest in the receipt; the file, if there is one, has been moved to quarantine."""

    def __init__(self, what: str, task: Task) -> None:
        super().__init__(what, remedy="the next  wbflow run  makes it again")
        self.task = task


@dataclass(frozen=True)
class Damage:
    """A file of the work folder that differs from what was written, and is therefore not used."""

    what: str
    """The file, and what is wrong with it."""
    task: Task | None = None
    """The task that the file belongs to."""


@dataclass(frozen=True)
class _Known:
    """A receipt that has been read."""

    path: Path
    stamp: list[int]
    """The stamp of its file when it was read."""
    receipt: Receipt
    artifact: Path | None

    def is_unchanged(self) -> bool:
        """Is its file still the same, and its artifact there?"""
        return file_stamp(self.path) == self.stamp and (self.artifact is None or _size(self.artifact) == self.receipt.bytes)


@dataclass(frozen=True)
class Cache:
    """The cache of a work folder.  Many processes may use it at once."""

    work: WorkFolder
    _damages: list[Damage] = field(default_factory=list, compare=False, repr=False)
    _known: dict[tuple[Task, str], _Known] = field(default_factory=dict, compare=False, repr=False)
    """By task and key.  A run looks up each several times."""

    def __reduce__(self) -> tuple[Any, ...]:  # known receipts and damage found so far are not sent to worker processes
        return type(self), (self.work,)

    def by_key(self, task: Task, key: str) -> Receipt | None:
        """Return the receipt of a finished task, or None.  Checks the artifact's presence and size; `read` checks its digest."""
        known = self._known.get((task, key))
        if known and known.is_unchanged():
            return known.receipt
        path = self.work.receipt(task, key)
        stamp = file_stamp(path)  # before it is read: a later change shows as another stamp
        receipt = self._receipt(task, path)
        if receipt and stamp:
            self._known[task, key] = _Known(path, stamp, receipt, self.path(receipt) if receipt.file else None)
        return receipt

    def newest(self, task: Task) -> Receipt | None:
        """Return the most recent receipt of a task, whatever its key."""
        newest: Receipt | None = None
        for path in self.work.receipts(task):
            receipt = self._receipt(task, path)
            if receipt is not None and (newest is None or receipt.finished > newest.finished):
                newest = receipt
        return newest

    def receipts(self) -> Iterator[Receipt]:
        """Yield every intact receipt."""
        return (receipt for path in self.work.receipts() if (receipt := self._receipt(None, path)))

    def damages(self) -> list[Damage]:
        """Return the damage found since the last call."""
        noted = self._damages[:]
        del self._damages[: len(noted)]
        return noted

    def path(self, receipt: Receipt) -> Path:
        """Return the artifact's path.  Raises ValueError for a rejected task, which has none."""
        if receipt.file is None:
            raise ValueError(f"{receipt.task} left no artifact")
        return self.work.artifact(receipt.preimage.task, "", receipt.file)

    def read(self, task: Task, path: Path, digest: str) -> bytes:
        """Return the bytes of an artifact.

        If they are missing or do not match the digest, moves the file to quarantine and raises DamagedArtifact.
        """
        for _ in range(2):  # a second try, since another process may just have written the file again
            try:
                data = read_untrusted(path, most=sys.maxsize)
            except OSError:
                data = b""
            if content_digest(data) == digest:
                return data
        clear(self.work.receipt_of(path))  # the receipt goes first; the file is kept for investigation
        if not path.exists():
            raise DamagedArtifact(f"{path} is gone", task)
        target = self.work.quarantined(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        path.replace(target)
        raise DamagedArtifact(f"{path} is damaged: moved to quarantine", task)

    def load(self, task: Task, receipt: Receipt) -> Any:
        """Return the result that an artifact holds.  Raises DamagedArtifact, ArtifactError."""
        return artifact.result_of(self.read(task, self.path(receipt), receipt.digest), task.stage)

    def product_file(self, task: Task, key: str, name: str) -> bytes | None:
        """Return a product file of a result; None if it is missing or damaged."""
        receipt = self.by_key(task, key)
        if receipt is None or name not in receipt.product_files:
            return None
        try:
            data = read_untrusted(self.work.product_file(task, key, name))
        except OSError:
            return None
        return data if content_digest(data) == receipt.product_files[name] else None

    def write(self, receipt: Receipt, data: bytes | bytearray | None, product_files: Mapping[str, bytes] | None = None) -> None:
        """Write an artifact and its product files, and the receipt last.  Raises OSError."""
        task = receipt.preimage.task
        # a process that dies between these writes leaves files without a receipt, which do not count
        for name, product in (product_files or {}).items():
            write_atomic(self.work.product_file(task, receipt.key, name), product, durable=False, own_path=True)
        if data is not None:
            write_atomic(self.path(receipt), data, own_path=True)
        path = self.work.receipt(task, receipt.key)
        write_checksummed(path, self.work.identity_of(path), {**vars(receipt), "preimage": vars(receipt.preimage)})

    def _receipt(self, task: Task | None, path: Path) -> Receipt | None:
        """Return a receipt; None if it is missing or damaged.  Damage is noted, and the task runs again."""
        try:
            fields = read_checksummed(path, self.work.identity_of(path))
            if fields is None:
                return None
            preimage = fields["preimage"]
            preimage["subject"] = tuple(preimage["subject"])
            receipt = Receipt(**fields | {"preimage": Preimage(**preimage)})
            if receipt.file:
                _check_size(path.parent / receipt.file, receipt.bytes)
        except Damaged as damage:
            self._damages.append(Damage(damage.what, task))
            return None
        except (TypeError, KeyError):  # written by another version
            return None
        return receipt


def _check_size(path: Path, expected: int) -> None:
    """Raise Damaged if an artifact is missing or has the wrong size."""
    size = _size(path)
    if size is None:
        raise Damaged(f"{path} is gone")
    if size != expected:
        raise Damaged(f"{path} has {size:,} of {expected:,} bytes")


def _size(path: Path) -> int | None:
    try:
        return path.stat().st_size
    except OSError:
        return None


class OnDemand(UserDict[Any, Any]):
    """A mapping whose values are loaded on access, so that the artifacts of a night are never all in memory at once."""

    def __init__(self, items: dict[Any, Any], load: Callable[[Any], Any]) -> None:
        super().__init__(items)
        self._load = load

    def __getitem__(self, key: Any) -> Any:
        return self._load(self.data[key])

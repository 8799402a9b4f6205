"""The cache: one artifact and one receipt for each task and key.  No receipt, not done.

A key is the hash of all that determines an artifact; inputs enter by the digest of their content, so that an upstream task
that runs again and gives the same bytes stops there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ..errors import WbflowError
from ..task import Task
from . import artifact
from .atomic import write_atomic
from .layout import WorkFolder


class DamagedArtifact(WbflowError):
    """The bytes on disk are not those that the receipt promises; the file has been moved to quarantine."""

    def __init__(self, task: Task, path: Path) -> None:
        super().__init__(f"{path} is damaged: moved to quarantine", remedy="the next  wbflow run  makes it again")
        self.task = task
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:  # it comes back from worker processes
        return type(self), (self.task, self.path)


@dataclass(frozen=True)
class Preimage:
    """All that determines an artifact.  inputs: digest by input name, or by "name subject" for inputs that join many."""

    stage: str
    subject: tuple[str, ...]
    function: str
    code: str
    parameters: dict[str, Any]
    inputs: dict[str, str]

    @property
    def task(self) -> Task:
        """Whose artifact it determines."""
        return Task(self.stage, self.subject)

    def key(self) -> str:
        """32 hexadecimal digits.  The function counts by its code, not by its name."""
        determines = {name: value for name, value in asdict(self).items() if name != "function"}
        return artifact.digest(json.dumps(determines, sort_keys=True, separators=(",", ":")).encode())


@dataclass(frozen=True)
class Receipt:
    """What is known of a finished task."""

    task: str
    key: str
    outcome: str
    """ran, or rejected: then there is a reason, and no file."""
    preimage: Preimage
    digest: str
    """Of the artifact's bytes (see `artifact.digest`)."""
    parts: dict[str, str] = field(default_factory=dict)
    """Digests of what can be needed on its own (see `artifact.parts`)."""
    file: str | None = None
    """The artifact's name beside the receipt."""
    bytes: int = 0
    reason: str | None = None
    code: str | None = None
    """The reason as one word that can be counted."""
    figures: dict[str, Any] = field(default_factory=dict)
    """The artifact's scalars, or the numbers behind the reason."""
    wall: float = 0.0
    """Seconds."""
    cpu: float = 0.0
    """Seconds."""
    peak_rss_mb: float = 0.0
    """Of the worker."""
    finished: str = ""
    """ISO 8601, UTC."""


@dataclass(frozen=True)
class Cache:
    """The cache of a work folder.  Safe to use from many processes at once."""

    work: WorkFolder

    def find(self, preimage: Preimage, key: str) -> Receipt | None:
        """The receipt of a finished task, or None.  Checks the file's presence and size; who reads it checks its digest."""
        return self.by_key(preimage.task, key)

    def by_key(self, task: Task, key: str) -> Receipt | None:
        """The receipt of a task under a key that is known."""
        return _receipt(self.work.receipt(task, key))

    def newest(self, task: Task) -> Receipt | None:
        """The most recently finished receipt of a task, under whatever key."""
        receipts = [r for r in map(_receipt, self.work.receipts(task)) if r]
        return max(receipts, key=lambda r: r.finished, default=None)

    def receipts(self) -> Iterator[Receipt]:
        """Every intact receipt."""
        for path in self.work.receipts():
            if receipt := _receipt(path):
                yield receipt

    def path(self, receipt: Receipt) -> Path:
        """The artifact's file.  Raises ValueError for a rejected task, which has none."""
        if receipt.file is None:
            raise ValueError(f"{receipt.task} left no artifact")
        return self._beside(receipt, receipt.file)

    def read(self, task: Task, path: Path, digest: str) -> bytes:
        """The bytes of an artifact.

        Raises
        ------
        DamagedArtifact
            They are missing, or not what the receipt promised; the file is in quarantine and its receipt is gone.
        """
        try:
            data = path.read_bytes()
        except OSError:
            data = b""
        if artifact.digest(data) != digest:
            self.quarantine(path)
            raise DamagedArtifact(task, path)
        return data

    def load(self, task: Task, receipt: Receipt) -> Any:
        """The object that an artifact holds.  Raises DamagedArtifact, ArtifactError."""
        return artifact.decode(self.read(task, self.path(receipt), receipt.digest))

    def write(self, receipt: Receipt, data: bytes | bytearray | None) -> None:
        """Keep an artifact: its bytes first, the receipt last.  Raises OSError (disk full, no rights)."""
        if data is not None and receipt.file:
            write_atomic(self._beside(receipt, receipt.file), data, settle=False)
        place = self.work.receipt(receipt.preimage.task, receipt.key)
        write_atomic(place, json.dumps(asdict(receipt), separators=(",", ":")).encode())

    def quarantine(self, path: Path) -> None:
        """Take an artifact out of use: the receipt goes first, the file is kept for whoever wants to know why."""
        self.work.receipt_beside(path).unlink(missing_ok=True)
        if path.exists():
            target = self.work.quarantined(path)
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)

    def _beside(self, receipt: Receipt, name: str) -> Path:
        return self.work.task(receipt.preimage.task) / name


def _receipt(path: Path) -> Receipt | None:
    """None for one that is not there, or cut short by an earlier version or a failing disk: then the task is done again."""
    try:
        fields = json.loads(path.read_bytes())
        fields["preimage"]["subject"] = tuple(fields["preimage"]["subject"])
        receipt = Receipt(**{**fields, "preimage": Preimage(**fields["preimage"])})
        if receipt.file and os.stat(path.with_name(receipt.file)).st_size != receipt.bytes:  # noqa: PTH116 (hot path)
            return None
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return receipt

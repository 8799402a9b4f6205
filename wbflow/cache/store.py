"""The cache: one artifact and one receipt for each task and key.  No receipt, not done.

A key is the hash of all that determines an artifact; inputs enter by the digest of their content, so that an upstream task
that runs again and gives the same bytes stops there.
"""

from __future__ import annotations

import json
import os
import sys
from collections import UserDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
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
from .untrusted import read_untrusted


class DamagedArtifact(WbflowError):
    """The bytes on disk are not those that the receipt promises; the file, if there is one, has been moved to quarantine."""

    def __init__(self, task: Task, path: Path, gone: bool = False) -> None:
        what = f"{path} is gone" if gone else f"{path} is damaged: moved to quarantine"
        super().__init__(what, remedy="the next  wbflow run  makes it again")
        self.task = task
        self.path = path
        self.gone = gone

    def __reduce__(self) -> tuple[Any, ...]:  # it comes back from worker processes
        return type(self), (self.task, self.path, self.gone)


@dataclass(frozen=True)
class Damage:
    """Something in the work folder that was not as it had been written, and is not used."""

    what: str
    """Which file, and what is wrong with it."""
    task: Task | None = None
    """Whose it was."""


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
        determines = {name: value for name, value in vars(self).items() if name != "function"}
        return content_digest(json.dumps(determines, sort_keys=True, separators=(",", ":")).encode())


@dataclass(frozen=True)
class Receipt:
    """What is known of a finished task."""

    task: str
    key: str
    outcome: str
    """ran, or rejected: then there is a reason, and no file."""
    preimage: Preimage
    digest: str
    """Of the artifact's bytes (see `checksum.content_digest`)."""
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
    cpu: float = 0.0
    """Seconds."""
    peak_rss_mb: float = 0.0
    """MB (2^20 bytes) that the worker held for itself at most, while it was at this."""
    finished: str = ""
    """ISO 8601, UTC."""
    drawings: dict[str, str] = field(default_factory=dict)
    """Digests of what was drawn of the result for the report, by the name of the product."""


@dataclass(frozen=True)
class Cache:
    """The cache of a work folder.  Safe to use from many processes at once."""

    work: WorkFolder
    _damages: list[Damage] = field(default_factory=list, compare=False, repr=False)
    _known: dict[tuple[Task, str], tuple[str, str, list[int], Receipt]] = field(default_factory=dict, compare=False, repr=False)
    """By task and key: the receipt's file, the artifact's ("": none), the former's stamp when it was read, and the receipt.  A
    night looks up each receipt three times."""

    def __reduce__(self) -> tuple[Any, ...]:  # what was read and found damaged here is not sent to worker processes
        return type(self), (self.work,)

    def by_key(self, task: Task, key: str) -> Receipt | None:
        """The receipt of a finished task, or None.  Checks the artifact's presence and size; who reads it checks its digest."""
        receipt_file, artifact_file, then, receipt = self._known.get((task, key), ("", "", [], None))
        if receipt and file_stamp(receipt_file) == then and not (artifact_file and _wrong_size(artifact_file, receipt.bytes)):
            return receipt
        path = self.work.receipt(task, key)
        found = file_stamp(path)
        if (receipt := self._receipt(task, path)) and found:
            self._known[task, key] = str(path), f"{path.parent}/{receipt.file}" if receipt.file else "", found, receipt
        return receipt

    def newest(self, task: Task) -> Receipt | None:
        """The most recently finished receipt of a task, under whatever key."""
        receipts = [receipt for path in self.work.receipts(task) if (receipt := self._receipt(task, path))]
        return max(receipts, key=lambda receipt: receipt.finished, default=None)

    def receipts(self) -> Iterator[Receipt]:
        """Every intact receipt."""
        return (receipt for path in self.work.receipts() if (receipt := self._receipt(None, path)))

    def note(self, what: str, task: Task | None = None) -> None:
        """Note damage that was found, to be reported (see `damages`)."""
        self._damages.append(Damage(what, task))

    def damages(self) -> list[Damage]:
        """What was found damaged since the last call."""
        found = self._damages[:]
        del self._damages[: len(found)]
        return found

    def path(self, receipt: Receipt) -> Path:
        """The artifact's file.  Raises ValueError for a rejected task, which has none."""
        if receipt.file is None:
            raise ValueError(f"{receipt.task} left no artifact")
        return self.work.artifact(receipt.preimage.task, "", receipt.file)

    def read(self, task: Task, path: Path, digest: str) -> bytes:
        """The bytes of an artifact.

        Raises DamagedArtifact where they are missing, or not what the receipt promised; the file is in quarantine then.
        """
        for _ in range(2):  # a second look, since somebody else may just have made it again
            try:
                data = read_untrusted(path, most=sys.maxsize)
            except OSError:
                data = b""
            if content_digest(data) == digest:
                return data
        gone = not path.exists()
        clear(self.work.receipt_beside(path))  # the receipt goes first, the file is kept for whoever wants to know why
        if path.exists():
            target = self.work.quarantined(path)
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)
        raise DamagedArtifact(task, path, gone)

    def load(self, task: Task, receipt: Receipt) -> Any:
        """The result that an artifact holds.  Raises DamagedArtifact, ArtifactError."""
        return artifact.result_of(self.read(task, self.path(receipt), receipt.digest), task.stage)

    def drawing(self, task: Task, key: str, name: str) -> bytes | None:
        """What was drawn of a result; None where that is not there, or not as it was drawn."""
        receipt = self.by_key(task, key)
        if receipt is None or name not in receipt.drawings:
            return None
        try:
            data = read_untrusted(self.work.drawing(task, key, name))
        except OSError:
            return None
        return data if content_digest(data) == receipt.drawings[name] else None

    def write(self, receipt: Receipt, data: bytes | bytearray | None, drawings: Mapping[str, bytes] | None = None) -> None:
        """Keep an artifact and what was drawn of it: the bytes first, the receipt last.  Raises OSError."""
        task = receipt.preimage.task
        for name, drawing in (drawings or {}).items():
            write_atomic(self.work.drawing(task, receipt.key, name), drawing, fsync="none", ours=True)
        if data is not None:
            write_atomic(self.path(receipt), data, fsync="file", ours=True)
        path = self.work.receipt(task, receipt.key)
        write_checksummed(path, self.work.place(path), {**vars(receipt), "preimage": vars(receipt.preimage)})

    def tidy(self, tasks: Iterable[Task]) -> None:
        """Clear away what a worker that is gone has left half-written of some tasks."""
        for left in (path for task in tasks for path in self.work.half_written(task)):
            with suppress(OSError):
                left.unlink()

    def _receipt(self, task: Task | None, path: Path) -> Receipt | None:
        """None for one that is not there, or cannot be believed: then the damage is noted, and the task done again."""
        try:
            if (fields := read_checksummed(path, self.work.place(path))) is None:
                return None
            preimage = fields["preimage"]
            preimage["subject"] = tuple(preimage["subject"])
            receipt = Receipt(**fields | {"preimage": Preimage(**preimage)})
        except Damaged as damage:
            self.note(damage.what, task)
            return None
        except (TypeError, KeyError):  # of another version
            return None
        if receipt.file and (wrong := _wrong_size(f"{path.parent}/{receipt.file}", receipt.bytes)):
            self.note(wrong, task)
            return None
        return receipt


class OnDemand(UserDict[Any, Any]):
    """A mapping whose values are read when they are asked for, so that a night is never in memory at once."""

    def __init__(self, items: dict[Any, Any], load: Callable[[Any], Any]) -> None:
        super().__init__(items)
        self._load = load

    def __getitem__(self, key: Any) -> Any:
        return self._load(self.data[key])


def _wrong_size(path: Path | str, expected: int) -> str | None:
    """What is wrong with an artifact at first sight."""
    try:
        size = os.stat(path).st_size  # noqa: PTH116
    except OSError:
        return f"{path} is gone"
    return None if size == expected else f"{path} has {size:,} of {expected:,} bytes"

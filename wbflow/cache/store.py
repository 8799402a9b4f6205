"""The cache: one artifact and one receipt for each task and key.  No receipt, not done.

A key is the hash of all that determines an artifact; inputs enter by the digest of their content, so that an upstream task
that runs again and gives the same bytes stops there.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import WbflowError
from ..task import Task
from . import artifact
from .atomic import clear, write_atomic
from .digests import Stamp, stamp_at
from .layout import WorkFolder
from .signed import Damaged, read_signed, write_signed
from .untrusted import read_outside


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
        determines = {
            "stage": self.stage,
            "subject": self.subject,
            "code": self.code,
            "parameters": self.parameters,
            "inputs": self.inputs,
        }
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
    _known: dict[str, tuple[Stamp, Receipt]] = field(default_factory=dict, compare=False, repr=False)
    """Receipts that were read or written, by the file that they stand in, and how that was then."""

    def __reduce__(self) -> tuple[Any, ...]:  # what is known here is not sent to worker processes
        return type(self), (self.work,)

    def find(self, preimage: Preimage, key: str) -> Receipt | None:
        """The receipt of a finished task, or None.  Checks the file's presence and size; who reads it checks its digest."""
        return self.by_key(preimage.task, key)

    def by_key(self, task: Task, key: str) -> Receipt | None:
        """The receipt of a task under a key that is known."""
        return self._receipt(task, self.work.receipt_name(task, key))

    def newest(self, task: Task) -> Receipt | None:
        """The most recently finished receipt of a task, under whatever key."""
        receipts = [r for name in self.work.receipt_names(task) if (r := self._receipt(task, name))]
        return max(receipts, key=lambda r: r.finished, default=None)

    def receipts(self) -> Iterator[Receipt]:
        """Every intact receipt."""
        for path in self.work.receipts():
            if receipt := self._receipt(None, str(path)):
                yield receipt

    def note(self, what: str, task: Task | None = None) -> None:
        """Note damage that was found, for whoever tells of it."""
        self._damages.append(Damage(what, task))

    def damages(self) -> list[Damage]:
        """What was found damaged since the last time that somebody asked."""
        found = self._damages[:]
        del self._damages[: len(found)]
        return found

    def path(self, receipt: Receipt) -> Path:
        """The artifact's file.  Raises ValueError for a rejected task, which has none."""
        if receipt.file is None:
            raise ValueError(f"{receipt.task} left no artifact")
        return Path(self._name(receipt, receipt.file))

    def read(self, task: Task, path: Path | str, digest: str) -> bytes:
        """The bytes of an artifact.

        Raises
        ------
        DamagedArtifact
            They are missing, or not what the receipt promised; the file is in quarantine and its receipt is gone.
        """
        for _ in range(2):  # a second look, since somebody else may just have made it again
            try:
                data = read_outside(path, most=sys.maxsize)
            except OSError:
                data = b""
            if artifact.digest(data) == digest:
                return data
        gone = not os.path.exists(path)  # noqa: PTH110
        self.quarantine(Path(path))
        raise DamagedArtifact(task, Path(path), gone)

    def load(self, task: Task, receipt: Receipt) -> Any:
        """The object that an artifact holds.  Raises DamagedArtifact, ArtifactError."""
        return artifact.decode(self.read(task, self.path(receipt), receipt.digest))

    def drawing(self, task: Task, key: str, name: str) -> bytes | None:
        """What was drawn of a result; None where that is not there, or not as it was drawn."""
        receipt = self.by_key(task, key)
        if receipt is None or name not in receipt.drawings:
            return None
        try:
            data = read_outside(self.work.drawing(task, key, name))
        except OSError:
            return None
        return data if artifact.digest(data) == receipt.drawings[name] else None

    def write(self, receipt: Receipt, data: bytes | bytearray | None, drawings: Mapping[str, bytes] | None = None) -> None:
        """Keep an artifact and what was drawn of it: the bytes first, the receipt last.  Raises OSError."""
        task = receipt.preimage.task
        for name, drawing in (drawings or {}).items():
            write_atomic(self.work.drawing(task, receipt.key, name), drawing, settle=False, ours=True)
        if data is not None and receipt.file:
            write_atomic(self._name(receipt, receipt.file), data, settle=False, ours=True)
        write_signed(*self._told(receipt))

    def tidy(self, task: Task) -> None:
        """Clear away what a worker that is gone has left half-written of a task."""
        for left in self.work.half_written(task):
            with suppress(OSError):
                left.unlink()

    def _told(self, receipt: Receipt) -> tuple[str, str, dict[str, Any]]:
        """A receipt's file, what it is of, and what it says."""
        place = self.work.receipt_name(receipt.preimage.task, receipt.key)
        return place, self.work.place(place), {**vars(receipt), "preimage": vars(receipt.preimage)}

    def quarantine(self, path: Path) -> None:
        """Take an artifact out of use: the receipt goes first, the file is kept for whoever wants to know why."""
        clear(self.work.receipt_beside(path))
        if path.exists():
            target = self.work.quarantined(path)
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)

    def _name(self, receipt: Receipt, name: str) -> str:
        """A file beside a receipt."""
        return self.work.artifact_name(receipt.preimage.task, name)

    def learn(self, receipt: Receipt) -> None:
        """Somebody else has kept an artifact, and says with which receipt: it need not be read."""
        name = self.work.receipt_name(receipt.preimage.task, receipt.key)
        if (stamp := stamp_at(name)) is not None:
            self._known[name] = stamp, receipt

    def copies(self, task: Task, key: str, known: Receipt | None = None) -> list[str]:
        """Where the reference keeps the receipt and the artifact of a key that is known here.  known: a receipt of the task."""
        receipt, name = known if known and known.key == key else self.by_key(task, key), self.work.pinned_name(task, key)
        return [name, *([f"{name[: name.rindex('/')]}/{receipt.file}"] if receipt and receipt.file else [])]

    def _receipt(self, task: Task | None, name: str) -> Receipt | None:
        """None for one that is not there, or cannot be believed: then the damage is noted, and the task done again."""
        stamp = stamp_at(name)
        if stamp is None and not os.path.lexists(name):
            return None
        known = self._known.get(name)
        if known is not None and known[0] == stamp:
            receipt: Receipt | None = known[1]
        else:
            receipt = self._read(task, name)
            if receipt is not None and stamp is not None:
                self._known[name] = stamp, receipt
        if receipt and receipt.file and (wrong := _wrong_size(f"{name[: name.rindex('/')]}/{receipt.file}", receipt.bytes)):
            self.note(wrong, task)
            return None
        return receipt

    def _read(self, task: Task | None, name: str) -> Receipt | None:
        try:
            fields = read_signed(name, self.work.place(name))
            if fields is None:
                return None
            fields["preimage"]["subject"] = tuple(fields["preimage"]["subject"])
            return Receipt(**{**fields, "preimage": Preimage(**fields["preimage"])})
        except Damaged as damage:
            self.note(damage.what, task)
            return None
        except (TypeError, KeyError):  # of another version
            return None


def _wrong_size(path: str, expected: int) -> str | None:
    """What is wrong with an artifact at first sight."""
    try:
        size = os.stat(path).st_size  # noqa: PTH116 (hot path)
    except OSError:
        return f"{path} is gone"
    return None if size == expected else f"{path} has {size:,} of {expected:,} bytes"

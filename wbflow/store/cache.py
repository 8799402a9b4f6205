"""The cache: one artifact, one receipt and perhaps one picture for each task and key.  No receipt, not done.

    cache/<stage>/<subject>/<key>.wbf     the artifact (.ply for the cloud)
    cache/<stage>/<subject>/<key>.jpg     a picture of it, for the report
    cache/<stage>/<subject>/<key>.json    the receipt, written last

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

from . import artifact
from .atomic import write_atomic


class DamagedArtifact(Exception):
    """The bytes on disk are not those that the receipt promises; the file has been moved to quarantine."""

    def __init__(self, task: str, path: Path) -> None:
        super().__init__(f"{path} is damaged: moved to quarantine, made again")
        self.task = task
        self.path = path


@dataclass(frozen=True)
class Preimage:
    """All that determines an artifact.  inputs: digest by input name, or by "name subject" for inputs that join many."""

    stage: str
    subject: tuple[str, ...]
    function: str
    code: str
    parameters: dict[str, Any]
    inputs: dict[str, str]

    def key(self) -> str:
        """32 hexadecimal digits.  The function counts by its code, not by its name."""
        determines = {name: value for name, value in asdict(self).items() if name != "function"}
        return artifact.digest(json.dumps(determines, sort_keys=True, separators=(",", ":")).encode())


@dataclass(frozen=True)
class Receipt:
    """What is known of a finished task.

    outcome: "ran" or "rejected" (then `reason`, and no file); file: name beside the receipt; digest, parts: content digests
    (see `artifact.parts`); figures: the artifact's scalars; seconds of wall and cpu; peak_rss_mb of the worker.
    """

    task: str
    key: str
    outcome: str
    preimage: Preimage
    digest: str
    parts: dict[str, str] = field(default_factory=dict)
    file: str | None = None
    bytes: int = 0
    picture: str | None = None
    reason: str | None = None
    figures: dict[str, Any] = field(default_factory=dict)
    wall: float = 0.0
    cpu: float = 0.0
    peak_rss_mb: float = 0.0
    finished: str = ""


@dataclass(frozen=True)
class Cache:
    """The cache below `root` (the work folder's `cache/`).  Safe to use from many processes at once."""

    root: Path

    def folder(self, stage: str, subject: tuple[str, ...]) -> Path:
        """Where the artifacts of a task lie, whatever their key."""
        return self.root / stage / ("--".join(subject) or "site")

    def find(self, preimage: Preimage, key: str) -> Receipt | None:
        """The receipt of a finished task, or None.  Checks the file's presence and size; who reads it checks its digest."""
        return self.by_key(preimage.stage, preimage.subject, key)

    def by_key(self, stage: str, subject: tuple[str, ...], key: str) -> Receipt | None:
        """The receipt of a task under a key that is known."""
        return self._receipt(self.folder(stage, subject) / f"{key}.json")

    def newest(self, stage: str, subject: tuple[str, ...]) -> Receipt | None:
        """The most recently finished receipt of a task, under whatever key."""
        receipts = [r for r in map(self._receipt, self.folder(stage, subject).glob("*.json")) if r]
        return max(receipts, key=lambda r: r.finished, default=None)

    def receipts(self) -> Iterator[Receipt]:
        """Every intact receipt."""
        for path in sorted(self.root.glob("*/*/*.json")):
            if receipt := self._receipt(path):
                yield receipt

    def path(self, receipt: Receipt) -> Path:
        """The artifact's file.  Raises ValueError for a rejected task, which has none."""
        if receipt.file is None:
            raise ValueError(f"{receipt.task} left no artifact")
        return self.folder(receipt.preimage.stage, receipt.preimage.subject) / receipt.file

    def picture(self, receipt: Receipt) -> Path | None:
        """The picture of an artifact, if one was made and is still there."""
        path = self.folder(receipt.preimage.stage, receipt.preimage.subject) / receipt.picture if receipt.picture else None
        return path if path and path.is_file() else None

    def read(self, task: str, path: Path, digest: str) -> bytes:
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

    def write(self, receipt: Receipt, data: bytes | bytearray | None, picture: bytes | None = None) -> None:
        """Keep an artifact: its bytes first, the receipt last.  Raises OSError (disk full, no rights)."""
        folder = self.folder(receipt.preimage.stage, receipt.preimage.subject)
        if data is not None and receipt.file:
            write_atomic(folder / receipt.file, data, settle=False)
        if picture is not None and receipt.picture:
            write_atomic(folder / receipt.picture, picture, settle=False)
        write_atomic(folder / f"{receipt.key}.json", json.dumps(asdict(receipt), separators=(",", ":")).encode())

    def quarantine(self, path: Path) -> None:
        """Take an artifact out of use: the receipt goes first, the file is kept for whoever wants to know why."""
        path.with_suffix(".json").unlink(missing_ok=True)
        if path.exists():
            target = self.root.parent / "quarantine" / "--".join(path.relative_to(self.root).parts)
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)

    def _receipt(self, path: Path) -> Receipt | None:
        try:
            fields = json.loads(path.read_bytes())
            fields["preimage"]["subject"] = tuple(fields["preimage"]["subject"])
            receipt = Receipt(**{**fields, "preimage": Preimage(**fields["preimage"])})
            if receipt.file and os.stat(path.with_name(receipt.file)).st_size != receipt.bytes:  # noqa: PTH116 (hot path)
                return None
        except (OSError, ValueError, TypeError, KeyError):
            return None
        return receipt

"""The pinned reference of a work folder: which results of which run later nights are compared with, and copies of them.

`reference.json` says what is pinned, for people and programs; beside it lie copies of the artifacts, so that nothing that happens
to the cache takes them away.  The record is written last, by rename: at any moment there is the old reference or the new one.
All of it is there twice, the record as its twin, the artifacts in the cache: what one has lost is put back from the other.
No night changes what is pinned.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.atomic import copy_atomic, write_atomic
from ..cache.checksum import Damaged, read_checksummed, with_checksum
from ..cache.layout import WorkFolder
from ..cache.store import Cache, Receipt
from ..errors import WbflowError
from ..task import Task

_OF = "reference"

_ANEW = "wbflow pin SITE.yaml  makes it anew, from the last good run; so does the next good night"


class BadReference(WbflowError):
    """The record of the reference cannot be read."""


@dataclass(frozen=True)
class PinnedArtifact:
    """What a task made, or rejected, in the reference's run."""

    task: Task
    key: str
    outcome: str
    """ran or rejected."""
    digest: str
    """Of the artifact's bytes; "" where it was rejected."""


@dataclass(frozen=True)
class Reference:
    """What later nights are compared with."""

    run: str
    """Id of the run that it was taken from."""
    date: str
    """The night of its captures."""
    cameras: Mapping[str, Mapping[str, Any]]
    """The cameras of the site by id, each as the run has solved it (K, R, C, ...: see cameras.json); empty where it has not."""
    artifacts: Mapping[Task, PinnedArtifact] = field(default_factory=dict)
    automatic: bool = False
    """The first good run became it by itself."""

    @property
    def placed(self) -> frozenset[str]:
        """The cameras whose poses are known."""
        return frozenset(camera for camera, solved in self.cameras.items() if solved)

    def lines(self) -> list[str]:
        """What is pinned, for people."""
        how = "automatically" if self.automatic else "by hand"
        found = [f"run {self.run}, night of {self.date}, pinned {how}"]
        for subject in dict.fromkeys(task.subject for task in self.artifacts):
            pinned = [p for t, p in self.artifacts.items() if t.subject == subject]
            kept = ", ".join(p.task.stage for p in pinned if p.outcome != "rejected")
            lost = ", ".join(p.task.stage for p in pinned if p.outcome == "rejected")
            unsolved = " (not placed)" if subject and subject[0] in self.cameras and not self.cameras[subject[0]] else ""
            found.append(f"  {'--'.join(subject) or 'site':24} {kept}{f'; rejected: {lost}' if lost else ''}{unsolved}")
        return found

    def to_json(self) -> dict[str, Any]:
        """Return what reference.json holds."""
        artifacts = [vars(pinned) for pinned in self.artifacts.values()]
        pinned = "automatically" if self.automatic else "by hand"
        return {"run": self.run, "date": self.date, "pinned": pinned, "cameras": self.cameras, "artifacts": artifacts}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Reference:
        """Raises KeyError, TypeError or ValueError for what is no reference.json."""
        artifacts = {}
        for entry in data["artifacts"]:
            stage, subject = entry["task"]
            task = Task(stage, tuple(subject))
            artifacts[task] = PinnedArtifact(**entry | {"task": task})
        return Reference(data["run"], data["date"], data["cameras"], artifacts, data["pinned"] == "automatically")


def read_reference(work: WorkFolder) -> Reference | None:
    """The reference of a work folder, or None.  Raises BadReference where its record and the record's twin are damaged."""
    try:
        return read_record(work.reference_record) or read_record(work.reference_twin)
    except BadReference:
        if twin := read_record(work.reference_twin):
            return twin
        raise


def read_record(path: Path) -> Reference | None:
    try:
        data = read_checksummed(path, _OF)
        return Reference.from_json(data) if data else None
    except Damaged as damage:
        raise BadReference(damage.what, remedy=_ANEW) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadReference(f"{path} cannot be read: {type(error).__name__}: {error}", remedy=_ANEW) from None


def write_reference(cache: Cache, reference: Reference, receipts: Iterable[Receipt]) -> None:
    """Put a reference in the place of the one that is there.  The caller holds the lock.  Raises OSError.

    receipts: of its artifacts, which the cache holds.
    """
    work = cache.work
    kept, anew = {work.reference_record, work.reference_twin}, work.reference.exists()
    for receipt in receipts:
        for path in files_of(cache, receipt):
            copy_atomic(path, work.pinned(path), fsync="none")
            kept.add(work.pinned(path))
    os.sync()  # all of them at once: the record is the last to be there
    data = with_checksum(_OF, reference.to_json(), in_lines=True)
    for path in (work.reference_twin, work.reference_record):
        write_atomic(path, data, ours=True)
    if anew:
        _remove_all_but(work.reference, kept)


def _remove_all_but(reference: Path, kept: set[Path]) -> None:
    """What was there for an earlier reference goes."""
    for path in sorted(reference.rglob("*"), reverse=True):  # what is in a folder before the folder
        if path.is_dir() and not path.is_symlink():
            with contextlib.suppress(OSError):  # not empty
                path.rmdir()
        elif path not in kept:
            path.unlink()


def drop_reference(work: WorkFolder) -> bool:
    """Forget the reference; False where there is none.  The caller holds the lock."""
    there = work.reference_record.exists() or work.reference_twin.exists()
    for path in (work.reference_twin, work.reference_record):
        path.unlink(missing_ok=True)
    if work.reference.exists():
        shutil.rmtree(work.reference)
    return there


def files_of(cache: Cache, receipt: Receipt) -> list[Path]:
    """An artifact, if there is one, and its receipt."""
    artifact = [cache.path(receipt)] if receipt.file else []
    return [*artifact, cache.work.receipt(receipt.preimage.task, receipt.key)]

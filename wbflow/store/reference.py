"""The pinned reference of a work folder: which results of which run later nights are compared with, and copies of them.

`reference.json` says what is pinned, for people and programs; beside it lie the artifacts, as hard links to those of the cache,
so that nothing that happens to the cache takes them away.  The record is written last, by rename: at any moment there is the old
reference or the new one.  No night writes here.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import WbflowError
from ..task import Subject, Task
from .artifact import file_digest
from .atomic import link_atomic, sync_folder, write_atomic
from .cache import Cache, Receipt
from .layout import WorkFolder
from .signed import Damaged, read_signed, signed

_OF = "reference"


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

    def to_json(self) -> dict[str, str]:
        return {"task": str(self.task), "key": self.key, "outcome": self.outcome, "digest": self.digest}


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
    """Nobody has asked for it: the first good run became it."""

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
        """Artifacts stand with what they are of: a camera, a pair, the site."""
        of: dict[tuple[str, ...], list[dict[str, str]]] = {}
        for task, pinned in self.artifacts.items():
            of.setdefault(task.subject, []).append(pinned.to_json())
        cameras = [{"id": c, "camera": solved, "artifacts": of.pop((c,), [])} for c, solved in self.cameras.items()]
        pairs = [{"left": s[0], "right": s[1], "artifacts": of.pop(s)} for s in [s for s in of if len(s) == 2]]
        site = [entry for entries in of.values() for entry in entries]
        how = "automatically" if self.automatic else "by hand"
        return {"run": self.run, "date": self.date, "pinned": how, "cameras": cameras, "pairs": pairs, "site": site}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Reference:
        """Raises KeyError, TypeError or ValueError for what is no reference.json."""
        artifacts: dict[Task, PinnedArtifact] = {}
        groups: list[tuple[Subject | None, Any]] = [((c["id"],), c["artifacts"]) for c in data["cameras"]]
        groups += [((p["left"], p["right"]), p["artifacts"]) for p in data["pairs"]]
        groups += [(None, data["site"])]
        for subject, entries in groups:
            for entry in entries:
                stage, _, name = entry["task"].partition(" ")
                task = Task(stage, subject if subject is not None else (name,) if name else ())
                artifacts[task] = PinnedArtifact(task, entry["key"], entry["outcome"], entry["digest"])
        cameras = {camera["id"]: dict(camera["camera"]) for camera in data["cameras"]}
        return Reference(data["run"], data["date"], cameras, artifacts, data["pinned"] == "automatically")


def read_reference(work: WorkFolder) -> Reference | None:
    """The reference of a work folder, or None.

    Raises
    ------
    BadReference
        Its record is damaged.
    """
    try:
        told = read_signed(work.reference_record, _OF)
        return Reference.from_json(told) if told else None
    except Damaged as damage:
        raise BadReference(damage.what, remedy="wbflow pin SITE.yaml  makes it anew, from the last good run") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        what = f"{work.reference_record} cannot be read: {type(error).__name__}: {error}"
        raise BadReference(what, remedy="wbflow pin SITE.yaml  makes it anew, from the last good run") from None


def write_reference(work: WorkFolder, reference: Reference, receipts: Iterable[Receipt]) -> None:
    """Put a reference in the place of the one that is there.  The caller holds the lock.

    Parameters
    ----------
    work : WorkFolder
        Whose.
    reference : Reference
        What it is.
    receipts : iterable of Receipt
        Of its artifacts, which the cache holds.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    kept = {work.reference_record}
    for receipt in receipts:
        for path in _files(work, receipt):
            copy = work.pinned(path)
            link_atomic(path, copy)
            kept.add(copy)
    for folder in {path.parent for path in kept if path.parent.is_dir()}:
        sync_folder(folder)
    write_atomic(work.reference_record, signed(_OF, reference.to_json(), indent=1))
    for path in work.reference.rglob("*"):
        if path.is_file() and path not in kept:
            path.unlink()
    _remove_empty(work.reference)


def drop_reference(work: WorkFolder) -> bool:
    """Forget the reference; False where there is none.  The caller holds the lock."""
    there = work.reference_record.exists()
    work.reference_record.unlink(missing_ok=True)
    if work.reference.exists():
        shutil.rmtree(work.reference)
    return there


def restore(work: WorkFolder, reference: Reference) -> list[str]:
    """Put back into the cache what it has lost of the reference; returns what cannot be, in words.  The caller holds the lock."""
    cache = Cache(work)
    lost = []
    for task, pinned in reference.artifacts.items():
        if cache.by_key(task, pinned.key):
            continue
        receipt = work.receipt(task, pinned.key)
        copies = sorted(work.pinned(receipt).parent.glob(f"{pinned.key}.*"), key=lambda p: p.suffix == receipt.suffix)
        artifacts = [copy for copy in copies if copy.suffix != receipt.suffix]
        if not work.pinned(receipt).is_file() or (pinned.digest and [file_digest(copy) for copy in artifacts] != [pinned.digest]):
            lost.append(f"'{task}' of the reference is damaged, or gone")
            continue
        for copy in copies:  # the receipt last
            link_atomic(copy, receipt.with_suffix(copy.suffix))
    return lost


def _files(work: WorkFolder, receipt: Receipt) -> list[Path]:
    """An artifact, if there is one, and its receipt."""
    artifact = [Cache(work).path(receipt)] if receipt.file else []
    return [*artifact, work.receipt(receipt.preimage.task, receipt.key)]


def _remove_empty(folder: Path) -> None:
    for inner in sorted((p for p in folder.rglob("*") if p.is_dir()), reverse=True):
        if not any(inner.iterdir()):
            inner.rmdir()

"""The pinned reference of a work folder: the run and results that later nights are compared with, and copies of these results.

`reference.json` lists what is pinned, for people and programs; the same folder has copies of the artifacts, so that no change of
the cache affects them.  The record is written last, by rename: at any moment, either the old or the new reference is in force.
Everything exists twice, the record as its twin and the artifacts in the cache: each copy can be restored from the other.
A night never changes the pinned reference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.checksum import Damaged, read_checksummed
from ..cache.layout import WorkFolder
from ..errors import WbflowError
from ..task import Subject, Task

IDENTITY = "reference"
"""What the checksummed record says that it is."""

_PIN_AGAIN = "wbflow pin SITE.yaml  creates it again from the last good run; so does the next good night"


class BadReference(WbflowError):
    """The record of the reference cannot be read."""


@dataclass(frozen=True)
class PinnedArtifact:
    """The result of a task in the reference's run, or its rejection."""

    task: Task
    key: str
    outcome: str
    """ran or rejected."""
    digest: str
    """Digest of the artifact's bytes; "" if the task was rejected."""


@dataclass(frozen=True)
class Reference:
    """The reference that later nights are compared with."""

    run: str
    """Id of the run that was pinned."""
    date: str
    """The night of its captures."""
    cameras: Mapping[str, Mapping[str, Any]]
    """The cameras of the site by id, as the run solved them (K, R, C, ...: see cameras.json); an unsolved camera is empty."""
    artifacts: Mapping[Task, PinnedArtifact] = field(default_factory=dict)
    automatic: bool = False
    """Was it pinned automatically, rather than by the user?"""

    @property
    def placed(self) -> frozenset[str]:
        """The cameras that have a pose in the reference."""
        return frozenset(camera for camera, solved in self.cameras.items() if solved)

    def lines(self) -> list[str]:
        """Return what is pinned as text lines."""
        usable: dict[Subject, list[str]] = {}  # names of stages by subject
        rejected: dict[Subject, list[str]] = {}
        for task, pinned in self.artifacts.items():
            usable.setdefault(task.subject, [])
            if pinned.outcome == "rejected":
                rejected.setdefault(task.subject, []).append(task.stage)
            else:
                usable[task.subject].append(task.stage)
        how = "automatically" if self.automatic else "by hand"
        lines = [f"run {self.run}, night of {self.date}, pinned {how}"]
        for subject, stages in usable.items():
            line = f"  {'--'.join(subject) or 'site':24} {', '.join(stages)}"
            if subject in rejected:
                line += f"; rejected: {', '.join(rejected[subject])}"
            if subject and self.cameras.get(subject[0]) == {}:
                line += " (not placed)"
            lines.append(line)
        return lines

    def to_json(self) -> dict[str, Any]:
        """Return the content of reference.json."""
        artifacts = [vars(pinned) for pinned in self.artifacts.values()]
        pinned = "automatically" if self.automatic else "by hand"
        return {"run": self.run, "date": self.date, "pinned": pinned, "cameras": self.cameras, "artifacts": artifacts}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Reference:
        """Return the reference from the content of reference.json.  Raises KeyError, TypeError or ValueError if it is invalid."""
        artifacts = {}
        for entry in data["artifacts"]:
            stage, subject = entry["task"]
            task = Task(stage, tuple(subject))
            artifacts[task] = PinnedArtifact(**entry | {"task": task})
        return Reference(data["run"], data["date"], data["cameras"], artifacts, data["pinned"] == "automatically")


def read_reference(work: WorkFolder) -> Reference | None:
    """Return the reference of a work folder, or None.  Raises BadReference if neither the record nor its twin can be used."""
    try:
        return read_record(work.reference_record) or read_record(work.reference_twin)
    except BadReference:
        twin = read_record(work.reference_twin)
        if twin:
            return twin
        raise


def read_record(path: Path) -> Reference | None:
    """Return the reference in a file, the record or its twin; None if there is none.  Raises BadReference."""
    try:
        data = read_checksummed(path, IDENTITY)
        if not data:
            return None
        return Reference.from_json(data)
    except Damaged as damage:
        raise BadReference(damage.what, remedy=_PIN_AGAIN) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadReference(f"{path} cannot be read: {type(error).__name__}: {error}", remedy=_PIN_AGAIN) from None

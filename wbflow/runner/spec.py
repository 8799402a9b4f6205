"""What a worker is told: a task, its function and parameters, and where its inputs come from."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache import artifact
from ..cache.store import Preimage, Receipt
from ..pipeline.stages import SITE_TYPES, PointTable, Source, Stage
from ..site.models import Camera, Site, plain
from ..task import Subject, Task
from .captures import CaptureFile


@dataclass(frozen=True)
class Value:
    """An input given by the site file: a dataclass of the stages made from plain values."""

    kind: str
    """Dotted name of the dataclass."""
    plain: dict[str, Any]
    """Its fields, as far as they are stated."""

    def digest(self) -> str:
        return artifact.digest(json.dumps([self.kind, self.plain], sort_keys=True).encode())


@dataclass(frozen=True)
class Files:
    """An input read from files as they are."""

    kind: str
    files: tuple[CaptureFile, ...]
    single: bool = False
    """One file rather than a list."""

    def digest(self) -> str:
        return artifact.digest(json.dumps([f.digest for f in self.files]).encode())


@dataclass(frozen=True)
class Part:
    """A part of an artifact that can be needed on its own (see `artifact.parts`)."""

    field: str
    """A field of the artifact."""
    entry: str | None = None
    """The entry of a mapping field: a camera's id, or "left--right"; None: all of it."""

    def __str__(self) -> str:
        return f"{self.field}[{self.entry}]" if self.entry is not None else self.field

    def of(self, result: Any) -> Any:
        """The part of an artifact."""
        value = getattr(result, self.field)
        return value if self.entry is None else value[self.entry]


@dataclass(frozen=True)
class Stored:
    """An input made by another task: an artifact on disk, or a part of it."""

    task: Task
    part: Part | None = None
    file: str = ""
    """Its name beside the receipt; "" while a task of the same lane makes it."""
    file_digest: str = ""
    content: str = ""
    """Digest of the artifact, or of the part."""

    def digest(self) -> str:
        return self.content

    def resolved(self, receipt: Receipt) -> Stored:
        """The same input, now that its task is done."""
        content = receipt.parts[str(self.part)] if self.part else receipt.digest
        return Stored(self.task, self.part, receipt.file or "", receipt.digest, content)


@dataclass(frozen=True)
class Joined:
    """An input that maps each subject to its own (camera id, or a pair of ids)."""

    items: dict[Subject, Value | Stored]


@dataclass(frozen=True)
class Absent:
    """An optional input that is not there."""


Input = Value | Files | Stored | Joined | Absent


@dataclass(frozen=True)
class Drawing:
    """What is drawn of a task's result for the report.  It is no part of the task's key."""

    name: str
    """Of the product (see `Products.drawings`)."""
    function: str
    inputs: dict[str, Input]
    """What the function is handed besides the result, by argument name."""


@dataclass(frozen=True)
class TaskSpec:
    """All that a worker needs to do a task."""

    task: Task
    function: str
    code: str
    parameters: dict[str, Any]
    inputs: dict[str, Input]
    table: PointTable | None = None
    """How the result is kept, where not as an artifact of arrays."""
    drawings: tuple[Drawing, ...] = ()
    force: bool = False
    left_to_function: dict[str, str] = field(default_factory=dict)
    """Parameters whose defaults the function works out itself: source text by name.  Not passed, but part of the key."""
    folder: Path | None = None
    """Where modules that are not installed may lie: beside the site file."""

    @property
    def suffix(self) -> str:
        """Of the artifact's file."""
        return self.table.suffix if self.table else ".wbf"

    def preimage(self) -> Preimage:
        """All that determines the artifact; every input must be resolved."""
        parameters = {**self.parameters, **self.left_to_function}
        digests = input_digests(self.inputs)
        return Preimage(self.task.stage, self.task.subject, self.function, self.code, parameters, digests)


def input_digests(inputs: dict[str, Input]) -> dict[str, str]:
    """Digest by input name, or by "name subject" for inputs that join many."""
    digests: dict[str, str] = {}
    for name, value in inputs.items():
        if isinstance(value, Joined):
            digests |= {f"{name} {'--'.join(subject)}": item.digest() for subject, item in value.items.items()}
        else:
            digests[name] = "" if isinstance(value, Absent) else value.digest()
    return digests


def stated(camera: Camera, what: str) -> Value:
    """What the site file says of a camera: `LENS`, `PRIVACY` or `PLACEMENT`."""
    if what == "privacy":
        return Value(SITE_TYPES[what], plain(camera.privacy))
    return Value(SITE_TYPES[what], plain(camera.lens if what == "lens" else camera.placement))


def stated_of_site(site: Site, what: str) -> Value | Joined:
    """The same of all cameras, by id; or the `SURVEY`."""
    if what == "survey":
        return Value(SITE_TYPES[what], plain(site.survey))
    return Joined({(camera.id,): stated(camera, what) for camera in site.views})


def side(need: Source, task: Task) -> Subject:
    """The left or right camera of a pair, where one of them is meant."""
    return {"left": task.subject[:1], "right": task.subject[1:]}.get(need.of, ())


def subject_of(origin: Stage, need: Source, task: Task) -> Subject:
    """Of which subject an input is that is not joined."""
    if origin.scope == "site":
        return ()
    return task.subject if need.of == "own" else side(need, task)

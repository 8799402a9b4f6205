"""What a worker is handed to do a task: its function, parameters and inputs, and the preimage of its key."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.checksum import content_digest
from ..cache.store import Preimage, Receipt
from ..pipeline.stages import SITE_TYPES, Source, Stage
from ..site.captures import CaptureFile
from ..site.models import Camera, Site, stated_fields
from ..task import Subject, Task


@dataclass(frozen=True)
class Value:
    """An input given by the site file: a dataclass of the stages made from plain values."""

    kind: str
    """Dotted name of the dataclass."""
    plain: dict[str, Any]
    """Its fields, as far as they are stated."""

    def digest(self) -> str:
        return content_digest(json.dumps([self.kind, self.plain], sort_keys=True).encode())


@dataclass(frozen=True)
class Files:
    """An input read from files as they are."""

    files: tuple[CaptureFile, ...]
    single: bool = False
    """One file rather than a list."""

    def digest(self) -> str:
        return content_digest(json.dumps([f.digest for f in self.files]).encode())


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
    """Its name beside the receipt; "" while a task of the same chain makes it."""
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
    drawings: tuple[Drawing, ...] = ()
    force: bool = False
    left_to_function: dict[str, str] = field(default_factory=dict)
    """Parameters whose defaults the function works out itself: source text by name.  Not passed, but part of the key."""
    folder: Path | None = None
    """Where modules that are not installed may lie: beside the site file."""

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


def site_input(camera: Camera, what: str) -> Value:
    """What the site file says of a camera: `LENS`, `PRIVACY` or `PLACEMENT`."""
    if what == "privacy":
        corners = [corner for polygon in camera.privacy for corner in polygon]
        return Value(SITE_TYPES[what], {"corners": corners, "counts": [float(len(polygon)) for polygon in camera.privacy]})
    return Value(SITE_TYPES[what], stated_fields(camera.lens if what == "lens" else camera.placement))


def site_inputs(site: Site, what: str) -> Value | Joined:
    """The same of all cameras, by id; or the `SURVEY`."""
    if what == "survey":
        return Value(SITE_TYPES[what], stated_fields(site.survey))
    return Joined({(camera.id,): site_input(camera, what) for camera in site.views})


def subject_of(origin: Stage, need: Source, task: Task) -> Subject:
    """The subject of an input that is not joined: the task's own, or the left or right camera of its pair."""
    return () if origin.scope == "site" else own_subject(need, task)


def own_subject(need: Source, task: Task) -> Subject:
    """The same where the input is an entry of a site-wide result."""
    return {"left": task.subject[:1], "right": task.subject[1:]}.get(need.of, task.subject)

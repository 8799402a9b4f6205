"""The description of a task for a worker: its function, parameters and inputs, and the preimage of its cache key."""

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
    """An input from plain values, mostly of the site file: they become a dataclass of `wbflow_stages`."""

    kind: str
    """Dotted name of the dataclass."""
    plain: dict[str, Any]
    """The fields that are stated."""

    def digest(self) -> str:
        return content_digest(json.dumps([self.kind, self.plain], sort_keys=True).encode())


@dataclass(frozen=True)
class Files:
    """An input with the content of files."""

    files: tuple[CaptureFile, ...]
    single: bool = False
    """The function gets one file instead of a list."""

    def digest(self) -> str:
        return content_digest(json.dumps([f.digest for f in self.files]).encode())


@dataclass(frozen=True)
class Part:
    """A part of an artifact that an input can consist of (see `artifact.parts`)."""

    field: str
    """Name of a field of the artifact."""
    entry: str | None = None
    """Key of an entry in a mapping field: a camera's id, or "left--right"; None: the whole field."""

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
    """Name of the artifact's file, in the folder of the receipt; "" until an earlier task of the same chain has made it."""
    file_digest: str = ""
    content: str = ""
    """Digest of the artifact, or of the part; it enters the cache key."""

    def digest(self) -> str:
        return self.content

    def resolved(self, receipt: Receipt) -> Stored:
        """The same input with file and digests, once its task is done."""
        content = receipt.parts[str(self.part)] if self.part else receipt.digest
        return Stored(self.task, self.part, receipt.file or "", receipt.digest, content)


@dataclass(frozen=True)
class Joined:
    """An input that is a mapping, by subject: a camera's id, or a pair of ids."""

    items: dict[Subject, Value | Stored]


@dataclass(frozen=True)
class Absent:
    """An optional input that is missing."""


Input = Value | Files | Stored | Joined | Absent


@dataclass(frozen=True)
class Drawing:
    """A drawing of a task's result for the report.  It is not part of the task's cache key."""

    name: str
    """Name of the drawing (see `Products.drawings`)."""
    function: str
    inputs: dict[str, Input]
    """Arguments of the function besides the result, by name."""


@dataclass(frozen=True)
class TaskSpec:
    """All that a worker needs to run a task."""

    task: Task
    function: str
    code: str
    parameters: dict[str, Any]
    inputs: dict[str, Input]
    drawings: tuple[Drawing, ...] = ()
    force: bool = False
    left_to_function: dict[str, str] = field(default_factory=dict)
    """Defaults that only the function can evaluate, as source text by parameter: not passed, but part of the cache key."""
    folder: Path | None = None
    """The site file's folder, which may contain modules that are not installed."""

    def preimage(self) -> Preimage:
        """Everything that determines the artifact; all inputs must be resolved."""
        parameters = {**self.parameters, **self.left_to_function}
        digests = input_digests(self.inputs)
        return Preimage(self.task.stage, self.task.subject, self.function, self.code, parameters, digests)


def input_digests(inputs: dict[str, Input]) -> dict[str, str]:
    """Digests by input name, or by "name subject" for mapping inputs."""
    digests: dict[str, str] = {}
    for name, value in inputs.items():
        if isinstance(value, Joined):
            digests |= {f"{name} {'--'.join(subject)}": item.digest() for subject, item in value.items.items()}
        else:
            digests[name] = "" if isinstance(value, Absent) else value.digest()
    return digests


def site_input(camera: Camera, what: str) -> Value:
    """The site file's entry for a camera, as an input: "lens", "privacy" or "placement"."""
    if what == "privacy":
        corners = [corner for polygon in camera.privacy for corner in polygon]
        return Value(SITE_TYPES[what], {"corners": corners, "counts": [float(len(polygon)) for polygon in camera.privacy]})
    return Value(SITE_TYPES[what], stated_fields(camera.lens if what == "lens" else camera.placement))


def site_inputs(site: Site, what: str) -> Value | Joined:
    """The inputs `site_input` of all cameras, by id; or the "survey"."""
    if what == "survey":
        return Value(SITE_TYPES[what], stated_fields(site.survey))
    return Joined({(camera.id,): site_input(camera, what) for camera in site.views})


def subject_of(origin: Stage, need: Source, task: Task) -> Subject:
    """The subject of an input that is not a mapping: the task's own, the left or right camera of its pair, or the site."""
    return () if origin.scope == "site" else own_subject(need, task)


def own_subject(need: Source, task: Task) -> Subject:
    """The task's own subject, or the left or right camera of its pair: also the entry to take from a site-wide result."""
    return {"left": task.subject[:1], "right": task.subject[1:]}.get(need.of, task.subject)

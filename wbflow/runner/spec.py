"""The description of a task for a worker: its function, parameters and inputs, and the preimage of its cache key."""

from __future__ import annotations

import json
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ..cache.checksum import content_digest
from ..cache.receipt import Preimage, Receipt
from ..pipeline.stages import SITE_TYPES, Source, stage_named
from ..site.capture_files import CaptureFile
from ..site.models import Camera, Site, stated_fields
from ..site.observation_tables import ObservationTable, SurveyTable
from ..task import Subject, Task


@dataclass(frozen=True)
class Value:
    """An input from plain values, mostly of the site file: they become a dataclass of `wbflow_stages`."""

    kind: str
    """Dotted name of the dataclass."""
    plain: dict[str, Any]
    """The fields that are stated."""

    @property
    def digest(self) -> str:
        return content_digest(json.dumps([self.kind, self.plain], sort_keys=True).encode())


@dataclass(frozen=True)
class Table:
    """An input from a table that the site file names: its columns become arrays of a dataclass of `wbflow_stages`."""

    kind: str
    """Dotted name of the dataclass."""
    plain: dict[str, Any]
    """The other fields."""
    columns: Mapping[str, array[Any]]
    """Columns by field."""
    widths: Mapping[str, int] = field(default_factory=dict)
    """Number of values in each row of a field, for fields that have several."""

    @cached_property
    def digest(self) -> str:
        """Digest of the content: many rows are not written as text for it."""
        columns = [[name, column.typecode, content_digest(column.tobytes())] for name, column in self.columns.items()]
        return content_digest(json.dumps([self.kind, self.plain, columns], sort_keys=True).encode())


@dataclass(frozen=True)
class Files:
    """An input with the content of files."""

    files: tuple[CaptureFile, ...]
    single: bool = False
    """The function gets one file instead of a list."""

    @property
    def digest(self) -> str:
        return content_digest(json.dumps([f.digest for f in self.files]).encode())


@dataclass(frozen=True)
class Stored:
    """An input made by another task: an artifact on disk, or a part of it (see `artifact.parts`)."""

    task: Task
    field: str = ""
    """Name of the field of the artifact that the input is; "": the whole artifact."""
    entry: str | None = None
    """Key of an entry in this field, a mapping: a camera's id, or "left--right"; None: the whole field."""
    file: str = ""
    """Name of the artifact's file, in the folder of the receipt; "" until an earlier task of the same chain has made it."""
    file_digest: str = ""
    digest: str = ""
    """Digest of the artifact, or of the part; it enters the cache key."""

    def resolved(self, receipt: Receipt | None) -> Stored | None:
        """The same input with file and digests, once its task is done; None if its artifact does not exist or lacks the part."""
        if receipt is None or receipt.file is None:
            return None
        # the digest of the part alone enters the key: other parts of the artifact may change
        part = self.field if self.entry is None else f"{self.field}[{self.entry}]"
        if not part:
            digest = receipt.digest
        elif part in receipt.parts:
            digest = receipt.parts[part]
        else:
            return None
        return Stored(self.task, self.field, self.entry, receipt.file, receipt.digest, digest)

    def part_of(self, artifact: Any) -> Any:
        """The input itself, from the artifact that contains it."""
        if not self.field:
            return artifact
        field = getattr(artifact, self.field)
        if self.entry is None:
            return field
        return field[self.entry]


@dataclass(frozen=True)
class Joined:
    """An input that is a mapping, by subject: a camera's id, or a pair of ids."""

    items: Mapping[Subject, Value | Stored]


Input = Value | Table | Files | Stored | Joined | None
"""None: an optional input that is missing."""


@dataclass(frozen=True)
class ProductFile:
    """A product file of a task's result for the report.  It is not part of the task's cache key."""

    name: str
    """Name of the product file (see `Products.product_files`)."""
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
    method: str = ""
    """Dotted name of the method that the function calls; "" if it has no choice."""
    product_files: tuple[ProductFile, ...] = ()
    force: bool = False
    left_to_function: dict[str, str] = field(default_factory=dict)
    """Defaults that only the function can evaluate, as source text by parameter: not passed, but part of the cache key."""
    folder: Path | None = None
    """The site file's folder, which may contain modules that are not installed."""

    def preimage(self) -> Preimage:
        """Everything that determines the artifact; all inputs must be resolved."""
        # defaults that are not passed determine the result all the same
        parameters = {**self.parameters, **self.left_to_function}
        digests = input_digests(self.inputs)
        return Preimage(self.task.stage, self.task.subject, self.function, self.code, parameters, digests)


def input_digests(inputs: dict[str, Input]) -> dict[str, str]:
    """Digests by input name, or by "name subject" for mapping inputs."""
    digests: dict[str, str] = {}
    for name, value in inputs.items():
        if value is None:
            digests[name] = ""
        elif isinstance(value, Joined):
            # one entry each, so that `status` can say which of them has changed
            for subject, item in value.items.items():
                digests[f"{name} {'--'.join(subject)}"] = item.digest
        else:
            digests[name] = value.digest
    return digests


def site_input(site: Site, need: Source, task: Task) -> Value | Table | Joined | None:
    """What the site file states: "lens", "privacy" or "placement" of the task's camera or of every camera, the "survey",
    "observations" and their "thing_survey"."""
    if need.name == "survey":
        return Value(SITE_TYPES[need.name], stated_fields(site.survey))
    if need.name == "observations":
        return _table(need.name, site.observations, {"xy": 2})
    if need.name == "thing_survey":
        return _table(need.name, site.thing_survey, {"position": 3})
    if need.of == "cameras":
        return Joined({(camera.id,): _stated_value(camera, need.name) for camera in site.cameras})
    if need.of == "every":
        return Joined({(view.id,): _stated_value(view, need.name) for view in site.views})
    for view in site.views:
        if (view.id,) != task.subject:
            continue
        if need.name == "privacy" and not view.privacy:
            return None
        return _stated_value(view, need.name)
    return None


def _table(name: str, table: ObservationTable | SurveyTable | None, widths: Mapping[str, int]) -> Table | None:
    """The rows of a table; None if the site has none.  widths: of fields with several values in a row."""
    if table is None:
        return None
    columns = {}
    plain = {}
    for key, value in vars(table.rows).items():
        if isinstance(value, array):
            columns[key] = value
        else:
            plain[key] = value
    return Table(SITE_TYPES[name], plain, columns, widths)


def _stated_value(camera: Camera, name: str) -> Value:
    """The lens, the placement or the privacy areas of a camera or view."""
    if name == "lens":
        return Value(SITE_TYPES[name], stated_fields(camera.lens))
    if name == "placement":
        return Value(SITE_TYPES[name], stated_fields(camera.placement))
    # polygons of any length in two flat lists: all corners, and how many of them each polygon has
    corners = []
    counts = []
    for polygon in camera.privacy:
        corners.extend(polygon)
        counts.append(float(len(polygon)))
    return Value(SITE_TYPES[name], {"corners": corners, "counts": counts})


def stored_input(need: Source, task: Task) -> Stored:
    """The input, not yet resolved, that is the result of one other task or, by `need.part`, a field of it.

    The result is that of the task's own subject, or of the left or right camera of its pair.  If it is of the whole site, a task
    of a camera or pair gets only the entry for its subject in that field.
    """
    subject = task.subject
    if need.of == "left":
        subject = subject[:1]
    elif need.of == "right":
        subject = subject[1:]
    if stage_named(need.name).scope != "site":
        return Stored(Task(need.name, subject), need.part)
    entry = None
    if need.part and stage_named(task.stage).scope != "site":
        entry = "--".join(subject)
    return Stored(Task(need.name), need.part, entry)

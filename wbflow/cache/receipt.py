"""The record of a finished task, and everything that determined its artifact: the preimage of its key."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

from ..task import Task
from .checksum import content_digest


@dataclass(frozen=True)
class Preimage:
    """Everything that determines an artifact.  inputs: digests by input name, or by "name subject" if an input joins several."""

    stage: str
    subject: tuple[str, ...]
    function: str
    code: str
    parameters: dict[str, Any]
    inputs: dict[str, str]

    @property
    def task(self) -> Task:
        """The task whose artifact it determines."""
        return Task(self.stage, self.subject)

    def key(self) -> str:
        """Return the cache key: 32 hexadecimal digits.  The function enters by its code, not by its name."""
        hashed = {name: value for name, value in vars(self).items() if name != "function"}
        return content_digest(json.dumps(hashed, sort_keys=True, separators=(",", ":")).encode())


@dataclass(frozen=True)
class Receipt:
    """The record of a finished task."""

    task: str
    key: str
    outcome: str
    """ran, or rejected: a rejected task has a reason and no file."""
    preimage: Preimage
    digest: str
    """Digest of the artifact's bytes (see `checksum.content_digest`)."""
    parts: dict[str, str] = field(default_factory=dict)
    """Digests of the parts that a task can need on their own (see `artifact.parts`)."""
    file: str | None = None
    """The artifact's file name, in the folder of the receipt."""
    bytes: int = 0
    reason: str | None = None
    code: str | None = None
    """The reason as one word, for statistics."""
    figures: dict[str, Any] = field(default_factory=dict)
    """The artifact's scalars, or the numbers behind the reason."""
    wall: float = 0.0
    cpu: float = 0.0
    """Wall and CPU time in seconds."""
    peak_rss_mb: float = 0.0
    """Peak private memory of the worker during the task, in MB (2^20 bytes)."""
    finished: str = ""
    """Time of completion, ISO 8601, UTC."""
    product_files: dict[str, str] = field(default_factory=dict)
    """Digests of the result's product files for the report, by name (see `Products.product_files`)."""

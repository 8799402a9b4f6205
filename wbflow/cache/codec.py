"""Results of stages as the cache keeps them: a table of points where the row says so, else an artifact."""

from __future__ import annotations

from typing import Any

from ..pipeline.stages import PointTable
from . import artifact
from .plugins import load
from .ply import columns_of, ply_bytes


def result_bytes(result: Any, table: PointTable | None) -> bytes | bytearray:
    """A result as the cache keeps it."""
    if table:
        return ply_bytes(load(table.columns)(result), comments=("made by wbflow",))
    return artifact.encode(result)


def result_of(data: bytes, table: PointTable | None) -> Any:
    """The result that bytes of the cache hold.  Raises ArtifactError, ValueError."""
    return load(table.restore)(columns_of(data)) if table else artifact.decode(data)

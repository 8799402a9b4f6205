"""Points for the 3-D view, made once of each result: streams that the vision packs and the browser unpacks."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ...errors import WbflowError
from ...graph.codec import result_of
from ...graph.functions import FunctionReader
from ...graph.pipeline import STAGES
from ...graph.rows import Stage
from ...store.artifact import digest
from ...store.atomic import write_atomic
from ...store.cache import Cache
from ...store.layout import WorkFolder
from ...task import Task
from ..artifacts import function


@dataclass(frozen=True)
class Points:
    """A stream of points."""

    name: str
    """Of the stage whose result they are of."""
    data: bytes = field(repr=False)

    @property
    def head(self) -> Mapping[str, Any]:
        """What the stream says of itself."""
        (length,) = struct.unpack_from("<I", self.data)
        told: dict[str, Any] = json.loads(self.data[4 : 4 + length])
        return told


def points_of(work: WorkFolder, keys: Mapping[Task, str], reader: FunctionReader) -> list[Points]:
    """The streams of a run's results, the product first.

    Parameters
    ----------
    work : WorkFolder
        Whose cache holds results and streams; what is not there any more is passed over.
    keys : mapping
        Key of the result of each task.
    reader : FunctionReader
        Knows whether a stream was made by the function as it is now.
    """
    found = []
    for stage in STAGES:
        task = Task(stage.name)
        if stage.view and task in keys and (data := _stream(work, stage, task, keys[task], reader)):
            found.append(Points(stage.name, data))
    return found


def _stream(work: WorkFolder, stage: Stage, task: Task, key: str, reader: FunctionReader) -> bytes | None:
    path, code = work.view(task, key), reader.read(stage.view).code.encode()
    try:
        kept = path.read_bytes()
        told, _, data = kept.partition(b"\n")
        if told == code + b" " + digest(data).encode():
            return data
    except OSError:
        pass
    cache = Cache(work)
    receipt = cache.by_key(task, key)
    try:
        if receipt is None or receipt.file is None:
            return None
        result = result_of(cache.read(task, cache.path(receipt), receipt.digest), stage.table)
        made = bytes(function(stage.view)(result))
        write_atomic(path, b"%s %s\n%s" % (code, digest(made).encode(), made), settle=False)
        return made
    except (WbflowError, ValueError, LookupError, TypeError, ArithmeticError, ImportError, OSError):
        return None  # the page does without

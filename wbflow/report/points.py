"""Points for the 3-D view: streams that the vision packs and the browser unpacks."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..pipeline.stages import STAGES
from ..task import Task
from .made import Maker


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


def points_of(maker: Maker, keys: Mapping[Task, str]) -> list[Points]:
    """The streams of a run's results, the product first; what is not there any more is passed over.

    keys: of the result of each task.
    """
    found = []
    for stage in STAGES:
        task = Task(stage.name)
        if stage.view and task in keys and (data := maker.made(stage.view, task, keys[task])):
            found.append(Points(stage.name, data))
    return found

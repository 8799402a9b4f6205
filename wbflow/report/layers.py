"""Pictures that lie on the map.

A layer comes as the length of a JSON head (uint32, little-endian), the head, and a picture: `corners` are its top left, top right
and bottom left ones in the world, `legend` what its colours say, `words` what it shows.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..pipeline.stages import STAGES
from ..task import Task
from .made import Maker
from .map import Plan
from .place import Layout


@dataclass(frozen=True)
class Layer:
    """A picture on the map."""

    name: str
    """Of the stage."""
    words: str
    legend: tuple[tuple[str, str], ...]
    """What a colour says, and the colour."""
    data: str
    """A data URL."""
    matrix: tuple[float, ...]
    """From its unit square to the drawing, as CSS and canvases have it: a, b, c, d, e, f."""


def layers(maker: Maker, keys: Mapping[Task, str], layout: Layout, plan: Plan) -> list[Layer]:
    """The layers that a run's results give.

    Parameters
    ----------
    maker : Maker
        Makes them of results.
    keys : mapping
        Key of the result of each task.
    layout : Layout
        Where the world lies in the frame of the page.
    plan : Plan
        Where that lies in the drawing.
    """
    found = []
    for stage in STAGES:
        task = Task(stage.name)
        if stage.layer and task in keys and (data := maker.made(stage.layer, task, keys[task])):
            (length,) = struct.unpack_from("<I", data)
            head: dict[str, Any] = json.loads(data[4 : 4 + length])
            picture = f"data:image/png;base64,{base64.b64encode(data[4 + length :]).decode()}"
            (x, y), right, down = (plan.spot(layout.to(corner)) for corner in head["corners"])
            matrix = (right[0] - x, right[1] - y, down[0] - x, down[1] - y, x, y)
            legend = tuple((name, colour) for name, colour in head["legend"])
            found.append(Layer(stage.name, head["words"], legend, picture, matrix))
    return found

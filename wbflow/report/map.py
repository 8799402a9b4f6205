"""The map of the report: the site from above, with cameras, pairs, and layers such as the coverage of the ground."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..pipeline.stages import STAGES
from ..records.record import PairRecord
from ..task import Task
from .data import ReportData
from .pictures import data_url, split
from .scene import Scene, SceneCamera

WIDTH = 1000.0
_LONGEST = 900.0
"""Largest height."""
_MARGIN = 70.0
_REACH = 0.16
"""Length of a drawn field of view, as a share of the larger side of the map."""
_FEW = 24
"""Up to this number of cameras, each camera's name is placed above it."""
_LETTER, _LINE = 6.0, 11.0
"""Width of a letter and height of a line, if there are many names."""
_WIDEST = 5.0
"""Extra width of the line of the pair with the most inliers; other usable pairs get a share of it."""


class Map:
    """The site seen from above, in units of the drawing, whose y axis points down."""

    width = WIDTH

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        wide, high = (max(scene.high[k] - scene.low[k], 1e-9) for k in (0, 1))
        self.scale = min((WIDTH - 2 * _MARGIN) / wide, (_LONGEST - 2 * _MARGIN) / high)
        """Units of the drawing per unit of the page's frame."""
        self.height = min(_LONGEST, max(360.0, high * self.scale + 2 * _MARGIN))
        self.left = (scene.low[0] + scene.high[0]) / 2 - WIDTH / 2 / self.scale
        self.top = (scene.low[1] + scene.high[1]) / 2 + self.height / 2 / self.scale
        self.many = len(scene.cameras) > _FEW
        self.standing = {camera.id: self.at(camera.C) for camera in scene.cameras}
        self.labels = (
            _outside(scene.cameras, self.standing) if self.many else dict.fromkeys(self.standing, (0.0, -14.0, "middle"))
        )
        """Offset and anchor of the name of each camera that has room for it."""

    def at(self, place: Sequence[float]) -> tuple[float, float]:
        """Return the position in the drawing of a point in the page's frame."""
        return (place[0] - self.left) * self.scale, (self.top - place[1]) * self.scale

    def field_of_view(self, camera: SceneCamera) -> str:
        """Return the corners of its outline, bounded by the camera's two outermost rays; "" if its direction is unknown."""
        level = [(r[0], r[1]) for r in camera.rays if math.hypot(r[0], r[1]) > 1e-9]
        if len(level) < 2 or math.hypot(camera.ahead[0], camera.ahead[1]) < 0.1:
            return ""
        middle = math.atan2(camera.ahead[1], camera.ahead[0])
        turns = [(math.atan2(y, x) - middle + math.pi) % (2 * math.pi) - math.pi for x, y in level]
        angles = [middle + min(turns) + (max(turns) - min(turns)) * k / 8 for k in range(9)]
        reach, (x, y) = _REACH * max(WIDTH, self.height), self.standing[camera.id]
        corners = [(x, y), *((x + reach * math.cos(a), y - reach * math.sin(a)) for a in angles)]
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in corners)

    def lines(self, pairs: Sequence[PairRecord]) -> Iterator[tuple[PairRecord, float, str]]:
        """Yield the pairs whose cameras are on the map, with line width and label; usable pairs come last, so they are on top."""
        most = max((pair.figures.inliers or 0 for pair in pairs), default=0) or 1
        for pair in sorted(pairs, key=lambda pair: pair.ok):
            if self.standing.keys() >= {*pair.cameras}:
                count = pair.figures.inliers or 0
                words = f"{count:,} inliers" if pair.ok else f"{pair.outcome}: {pair.reason or ''}"
                yield pair, 1 + _WIDEST * math.sqrt(count / most) if pair.ok else 1.5, words

    @property
    def bar(self) -> float:
        """The length of the scale bar in the page's frame: 1, 2 or 5 times a power of ten, at most a fifth of the map."""
        longest = 0.2 * WIDTH / self.scale
        power = 10.0 ** math.floor(math.log10(max(longest, 1e-12)))
        return max(step * power for step in (1, 2, 5) if step * power <= longest * 1.0001)

    @property
    def north_deg(self) -> float:
        """Direction of the world's y axis, clockwise from the top."""
        return math.degrees(math.atan2(self.scene.rows[0][1], self.scene.rows[1][1]))


def _outside(cameras: Sequence[SceneCamera], at: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float, str]]:
    """Place names on the side of each camera that faces away from the middle of all cameras, which often surround the scene.

    Names that would overlap others are left out (hovering shows them); cameras whose state is not good have priority.
    """
    x, y = (sum(values) / len(at) for values in zip(*at.values(), strict=True))
    taken: list[tuple[float, float, float]] = []
    found = {}
    for camera in sorted(cameras, key=lambda camera: camera.state == "good"):
        across, down = at[camera.id][0] - x, at[camera.id][1] - y
        if abs(across) > 0.6 * abs(down):
            label = (math.copysign(9.0, across), 4.0, "start" if across > 0 else "end")
        else:
            label = (0.0, 18.0 if down > 0 else -10.0, "middle")
        half = _LETTER * len(camera.id) / 2
        middle = at[camera.id][0] + label[0] + {"start": half, "middle": 0.0, "end": -half}[label[2]]
        line = at[camera.id][1] + label[1]
        if not any(abs(middle - a) < half + b and abs(line - c) < _LINE for a, b, c in taken):
            taken.append((middle, half, line))
            found[camera.id] = label
    return found


def layers_of(data: ReportData, drawn: Map) -> list[dict[str, Any]]:
    """Return the pictures on the map; each head contains the top left, top right and bottom left corner in world coordinates.

    Their matrices map the unit square to the drawing, in the order of CSS: a, b, c, d, e, f.
    """
    found = []
    for stage in STAGES:
        if layer := data.drawing(Task(stage.name), "layer"):
            head, picture = split(layer)
            (x, y), right, down = (drawn.at(drawn.scene.to(corner)) for corner in head["corners"])
            matrix = (right[0] - x, right[1] - y, down[0] - x, down[1] - y, x, y)
            words = {"name": stage.name, "words": head["words"], "legend": head["legend"]}
            found.append({**words, "data": data_url(picture, "image/png"), "matrix": matrix})
    return found

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
_MOST_HEIGHT = 900.0
"""Largest height of the map."""
_MARGIN = 70.0
_VIEW_LENGTH = 0.16
"""Length of a drawn field of view, as a share of the larger side of the map."""
_MOST_LABELLED = 24
"""Up to this number of cameras, each camera's name is placed above it."""
_LETTER_WIDTH, _LINE_HEIGHT = 6.0, 11.0
"""Size of a name's letters, to find names that would overlap (only if there are many cameras)."""
_MOST_EXTRA_WIDTH = 5.0
"""Extra width of the line of the pair with the most inliers; other usable pairs get a share of it."""


class Map:
    """The site seen from above, in units of the drawing, whose y axis points down."""

    width = WIDTH

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        width, height = (max(scene.high[k] - scene.low[k], 1e-9) for k in (0, 1))
        self.scale = min((WIDTH - 2 * _MARGIN) / width, (_MOST_HEIGHT - 2 * _MARGIN) / height)
        """Units of the drawing per unit of the page's frame."""
        self.height = min(_MOST_HEIGHT, max(360.0, height * self.scale + 2 * _MARGIN))
        self.left = (scene.low[0] + scene.high[0]) / 2 - WIDTH / 2 / self.scale
        self.top = (scene.low[1] + scene.high[1]) / 2 + self.height / 2 / self.scale
        self.is_crowded = len(scene.cameras) > _MOST_LABELLED
        self.positions = {camera.id: self.at(camera.C) for camera in scene.cameras}
        above = dict.fromkeys(self.positions, (0.0, -14.0, "middle"))
        self.labels = _place_labels(scene.cameras, self.positions) if self.is_crowded else above
        """Offset and anchor of the name of each camera that has room for it."""

    def at(self, place: Sequence[float]) -> tuple[float, float]:
        """Return the position in the drawing of a point in the page's frame."""
        return (place[0] - self.left) * self.scale, (self.top - place[1]) * self.scale

    def field_of_view(self, camera: SceneCamera) -> str:
        """Return the corners of its outline, between the camera's outermost rays; "" if the direction is unknown or too steep."""
        horizontal = [(r[0], r[1]) for r in camera.rays if math.hypot(r[0], r[1]) > 1e-9]
        if len(horizontal) < 2 or math.hypot(camera.ahead[0], camera.ahead[1]) < 0.1:
            return ""
        heading = math.atan2(camera.ahead[1], camera.ahead[0])
        offsets = [(math.atan2(y, x) - heading + math.pi) % (2 * math.pi) - math.pi for x, y in horizontal]
        angles = [heading + min(offsets) + (max(offsets) - min(offsets)) * k / 8 for k in range(9)]
        reach, (x, y) = _VIEW_LENGTH * max(WIDTH, self.height), self.positions[camera.id]
        corners = [(x, y), *((x + reach * math.cos(a), y - reach * math.sin(a)) for a in angles)]
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in corners)

    def lines(self, pairs: Sequence[PairRecord]) -> Iterator[tuple[PairRecord, float, str]]:
        """Yield the pairs whose cameras are on the map, with line width and label; usable pairs come last, so they are on top."""
        most_inliers = max((pair.figures.inliers or 0 for pair in pairs), default=0) or 1
        for pair in sorted(pairs, key=lambda pair: pair.ok):
            if self.positions.keys() >= {*pair.cameras}:
                count = pair.figures.inliers or 0
                label = f"{count:,} inliers" if pair.ok else f"{pair.outcome}: {pair.reason or ''}"
                yield pair, 1 + _MOST_EXTRA_WIDTH * math.sqrt(count / most_inliers) if pair.ok else 1.5, label

    @property
    def bar(self) -> float:
        """The length of the scale bar in the page's frame: 1, 2 or 5 times a power of ten, at most a fifth of the map."""
        longest = 0.2 * WIDTH / self.scale
        power = 10.0 ** math.floor(math.log10(max(longest, 1e-12)))
        return max(step * power for step in (1, 2, 5) if step * power <= longest * 1.0001)

    @property
    def north_deg(self) -> float:
        """Direction of the world's y axis, clockwise from the top."""
        return math.degrees(math.atan2(self.scene.axes.rows[0][1], self.scene.axes.rows[1][1]))


def _place_labels(cameras: Sequence[SceneCamera], at: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float, str]]:
    """Place names on the side of each camera that faces away from the middle of all cameras, which often surround the scene.

    Names that would overlap others are left out (hovering shows them); cameras whose state is not good have priority.
    """
    x, y = (sum(values) / len(at) for values in zip(*at.values(), strict=True))
    placed: list[tuple[float, float, float]] = []
    labels = {}
    for camera in sorted(cameras, key=lambda camera: camera.state == "good"):
        dx, dy = at[camera.id][0] - x, at[camera.id][1] - y
        if abs(dx) > 0.6 * abs(dy):
            label = (math.copysign(9.0, dx), 4.0, "start" if dx > 0 else "end")
        else:
            label = (0.0, 18.0 if dy > 0 else -10.0, "middle")
        half_width = _LETTER_WIDTH * len(camera.id) / 2
        label_x = at[camera.id][0] + label[0] + {"start": half_width, "middle": 0.0, "end": -half_width}[label[2]]
        label_y = at[camera.id][1] + label[1]
        if not any(abs(label_x - x2) < half_width + half2 and abs(label_y - y2) < _LINE_HEIGHT for x2, half2, y2 in placed):
            placed.append((label_x, half_width, label_y))
            labels[camera.id] = label
    return labels


def layers_of(data: ReportData, drawn: Map) -> list[dict[str, Any]]:
    """Return the pictures on the map; the stored head of each has its top left, top right and bottom left corner in the world.

    Their matrices map the unit square to the drawing, in the order of CSS: a, b, c, d, e, f.
    """
    layers = []
    for stage in STAGES:
        if layer := data.product_file(Task(stage.name), "layer"):
            head, picture = split(layer)
            (x, y), right, down = (drawn.at(drawn.scene.axes.place(corner)) for corner in head["corners"])
            matrix = (right[0] - x, right[1] - y, down[0] - x, down[1] - y, x, y)
            texts = {"name": stage.name, "words": head["words"], "legend": head["legend"]}
            layers.append({**texts, "data": data_url(picture, "image/png"), "matrix": matrix})
    return layers

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
"""Width of the map, in units of the drawing."""
_MOST_HEIGHT = 900.0
"""Largest height of the map."""
_LEAST_HEIGHT = 360.0
"""Smallest height of the map: the names of cameras in a row need room."""
_MARGIN = 70.0
"""Width of the margin around everything that is drawn: room for names."""
_LEAST_EXTENT = 1e-9
"""Smallest extent of the scene: a single camera must not divide by zero."""
_VIEW_LENGTH = 0.16
"""Length of a drawn field of view, as a share of the larger side of the map."""
_ARC_STEPS = 8
"""Number of straight lines that draw the arc of a field of view."""
_LEAST_HORIZONTAL = 0.1
"""A camera whose direction has a smaller horizontal part looks straight up or down, and has no field of view on the map."""
_MOST_LABELLED = 24
"""Up to this number of cameras, each camera's name is placed above it."""
_RIGHT = (9.0, 4.0, "start")
_LEFT = (-9.0, 4.0, "end")
_BELOW = (0.0, 18.0, "middle")
_ABOVE = (0.0, -10.0, "middle")
"""Offset and anchor of a name beside its camera, clear of the dot."""
_LETTER_WIDTH = 6.0
_LINE_HEIGHT = 11.0
"""Size of a name's letters, to find names that would overlap (only if there are many cameras)."""
_SIDEWAYS = 0.6
"""A name is beside its camera, not above or below, if its direction from the middle is at most this steep."""
_MOST_EXTRA_WIDTH = 5.0
"""Extra width of the line of the pair with the most inliers; other usable pairs get a share of it."""
_UNUSABLE_WIDTH = 1.5
"""Width of the line of a pair that is not usable."""
_BAR_SHARE = 0.2
"""Largest length of the scale bar, as a share of the map's width."""


class Map:
    """The site seen from above, in units of the drawing, whose y axis points down."""

    width = WIDTH

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        # 1. The largest scale at which everything fits in the margins.
        width = max(scene.high[0] - scene.low[0], _LEAST_EXTENT)
        height = max(scene.high[1] - scene.low[1], _LEAST_EXTENT)
        self.scale = min((WIDTH - 2 * _MARGIN) / width, (_MOST_HEIGHT - 2 * _MARGIN) / height)
        """Units of the drawing per unit of the page's frame."""
        self.height = min(_MOST_HEIGHT, max(_LEAST_HEIGHT, height * self.scale + 2 * _MARGIN))

        # 2. The middle of the scene is in the middle of the map.
        self.left = (scene.low[0] + scene.high[0]) / 2 - WIDTH / 2 / self.scale
        self.top = (scene.low[1] + scene.high[1]) / 2 + self.height / 2 / self.scale

        # 3. The cameras and their names.
        self.is_crowded = len(scene.cameras) > _MOST_LABELLED
        self.positions: dict[str, tuple[float, float]] = {}
        for camera in scene.cameras:
            self.positions[camera.id] = self.at(camera.C)
        self.labels: dict[str, tuple[float, float, str]] = dict.fromkeys(self.positions, (0.0, -14.0, "middle"))
        """Offset and anchor of the name of each camera that has room for it."""
        if self.is_crowded:
            self.labels = _place_labels(scene.cameras, self.positions)

    def at(self, place: Sequence[float]) -> tuple[float, float]:
        """Return the position in the drawing of a point in the page's frame."""
        return (place[0] - self.left) * self.scale, (self.top - place[1]) * self.scale

    def field_of_view(self, camera: SceneCamera) -> str:
        """Return the corners of its outline, between the camera's outermost rays; "" if the direction is unknown or too steep."""
        horizontal = [(ray[0], ray[1]) for ray in camera.rays if math.hypot(ray[0], ray[1]) > _LEAST_EXTENT]
        if len(horizontal) < 2 or math.hypot(camera.ahead[0], camera.ahead[1]) < _LEAST_HORIZONTAL:
            return ""
        # Angles of the rays from the heading, between -pi and pi, so that a view to the west is not cut in two.
        heading = math.atan2(camera.ahead[1], camera.ahead[0])
        offsets = []
        for x, y in horizontal:
            offsets.append((math.atan2(y, x) - heading + math.pi) % (2 * math.pi) - math.pi)
        first = min(offsets)
        opening = max(offsets) - first

        # The camera, and an arc around it.
        reach = _VIEW_LENGTH * max(WIDTH, self.height)
        x, y = self.positions[camera.id]
        corners = [f"{x:.1f},{y:.1f}"]
        for k in range(_ARC_STEPS + 1):
            angle = heading + first + opening * k / _ARC_STEPS
            corners.append(f"{x + reach * math.cos(angle):.1f},{y - reach * math.sin(angle):.1f}")
        return " ".join(corners)

    def lines(self, pairs: Sequence[PairRecord]) -> Iterator[tuple[PairRecord, float, str]]:
        """Yield the pairs whose cameras are on the map, with line width and label; usable pairs come last, so they are on top."""
        most_inliers = max((pair.figures.inliers or 0 for pair in pairs), default=0) or 1
        for pair in sorted(pairs, key=lambda pair: pair.ok):
            if not self.positions.keys() >= {*pair.cameras}:
                continue
            if pair.ok:
                count = pair.figures.inliers or 0
                # the root, so that the area of a line's end grows with its evidence
                yield pair, 1 + _MOST_EXTRA_WIDTH * math.sqrt(count / most_inliers), f"{count:,} inliers"
            else:
                yield pair, _UNUSABLE_WIDTH, f"{pair.outcome}: {pair.reason or ''}"

    @property
    def bar(self) -> float:
        """The length of the scale bar in the page's frame: 1, 2 or 5 times a power of ten, at most a fifth of the map."""
        longest = _BAR_SHARE * WIDTH / self.scale
        power = 10.0 ** math.floor(math.log10(max(longest, 1e-12)))
        # 1 power always fits; the tolerance is for rounding in the logarithm
        return max(step * power for step in (1, 2, 5) if step * power <= longest * 1.0001)

    @property
    def north_deg(self) -> float:
        """Direction of the world's y axis, clockwise from the top."""
        right, away, _ = self.scene.axes.rows
        return math.degrees(math.atan2(right[1], away[1]))


def _place_labels(cameras: Sequence[SceneCamera], at: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float, str]]:
    """Place names on the side of each camera that faces away from the middle of all cameras, which often surround the scene.

    Names that would overlap others are left out (hovering shows them); cameras whose state is not good have priority.
    """
    middle_x, middle_y = (sum(values) / len(at) for values in zip(*at.values(), strict=True))
    placed: list[tuple[float, float, float]] = []  # middle x, half width and y of the names so far
    labels = {}
    for camera in sorted(cameras, key=lambda camera: camera.state == "good"):
        x, y = at[camera.id]
        dx = x - middle_x
        dy = y - middle_y
        is_beside = abs(dx) > _SIDEWAYS * abs(dy)
        if is_beside and dx > 0:
            label = _RIGHT
        elif is_beside:
            label = _LEFT
        elif dy > 0:
            label = _BELOW
        else:
            label = _ABOVE

        # the anchor says which point of the name the offset places
        half_width = _LETTER_WIDTH * len(camera.id) / 2
        from_anchor = {"start": half_width, "middle": 0.0, "end": -half_width}
        label_x = x + label[0] + from_anchor[label[2]]
        label_y = y + label[1]
        if not _overlaps(label_x, half_width, label_y, placed):
            placed.append((label_x, half_width, label_y))
            labels[camera.id] = label
    return labels


def _overlaps(x: float, half_width: float, y: float, placed: Sequence[tuple[float, float, float]]) -> bool:
    """Return whether a name overlaps one of those that are placed."""
    for other_x, other_half_width, other_y in placed:
        if abs(x - other_x) < half_width + other_half_width and abs(y - other_y) < _LINE_HEIGHT:
            return True
    return False


def layers_of(data: ReportData, drawn: Map) -> list[dict[str, Any]]:
    """Return the pictures on the map; the stored head of each has its top left, top right and bottom left corner in the world.

    Their matrices map the unit square to the drawing, in the order of CSS: a, b, c, d, e, f.
    """
    layers: list[dict[str, Any]] = []
    for stage in STAGES:
        layer = data.product_file(Task(stage.name), "layer")
        if not layer:
            continue
        head, picture = split(layer)
        axes = drawn.scene.axes
        (x, y), right, down = (drawn.at(axes.place(corner)) for corner in head["corners"])
        layers.append(
            {
                "name": stage.name,
                "words": head["words"],
                "legend": head["legend"],
                "data": data_url(picture, "image/png"),
                "matrix": (right[0] - x, right[1] - y, down[0] - x, down[1] - y, x, y),
            }
        )
    return layers

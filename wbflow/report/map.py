"""The map: cameras, their fields of view, pairs and objects from above, in the frame of the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..records.record import PairRecord
from .data import ReportData
from .scene import Scene, SceneCamera

WIDTH = 1000.0
_LONGEST = 900.0
"""Largest height."""
_MARGIN = 70.0
_REACH = 0.16
"""Length of a field of view, as a share of the map."""
_FEW = 24
"""Names of so many cameras have room above them."""
_LETTER, _LINE = 6.0, 11.0
"""Width of a letter and height of a line, where there are many names."""
_WIDEST = 5.0
"""Width of a pair's line."""


@dataclass(frozen=True)
class Dot:
    """A camera on the map."""

    id: str
    state: str
    x: float
    y: float
    view: str
    """Corners of the field of view; "" where its direction is not known."""
    title: str
    label: tuple[float, float, str] = (0.0, -14.0, "middle")
    """Offset and anchor of its name."""
    named: bool = True
    """Whether there is room for its name."""


@dataclass(frozen=True)
class Line:
    """A pair on the map."""

    name: str
    outcome: str
    x1: float
    y1: float
    x2: float
    y2: float
    width: float
    title: str


@dataclass(frozen=True)
class Spot:
    """An object on the map."""

    name: str
    kind: str
    x: float
    y: float
    r: float
    known: bool


@dataclass(frozen=True)
class Map:
    """The drawing, in its own units."""

    width: float
    height: float
    left: float
    """Left and top of the drawing in the frame of the page."""
    top: float
    scale: float
    """Units of the drawing for one of the page's frame."""
    dots: tuple[Dot, ...]
    lines: tuple[Line, ...]
    spots: tuple[Spot, ...]
    bar: float
    """Length of the scale bar."""
    bar_words: str
    north_deg: float
    """Clockwise from the top."""
    north: str
    absent: tuple[str, ...]
    """Cameras without a known place."""

    @property
    def many(self) -> bool:
        """Whether cameras are drawn small."""
        return len(self.dots) > _FEW

    def spot(self, at: Sequence[float]) -> tuple[float, float]:
        """Return a place of the page's frame in the drawing."""
        return (at[0] - self.left) * self.scale, (self.top - at[1]) * self.scale


def map_of(data: ReportData, scene: Scene) -> Map:
    """Return the map of a run."""
    spans = [max(scene.high[k] - scene.low[k], 1e-9) for k in (0, 1)]
    scale = min((WIDTH - 2 * _MARGIN) / spans[0], (_LONGEST - 2 * _MARGIN) / spans[1])
    height = min(_LONGEST, max(360.0, spans[1] * scale + 2 * _MARGIN))
    left = (scene.low[0] + scene.high[0]) / 2 - WIDTH / 2 / scale
    top = (scene.low[1] + scene.high[1]) / 2 + height / 2 / scale

    def spot(at: tuple[float, ...]) -> tuple[float, float]:
        return (at[0] - left) * scale, (top - at[1]) * scale

    reach = _REACH * max(WIDTH, height) / scale
    standing = {camera.id: camera for camera in scene.cameras}
    words = {camera.id: camera.reason or (camera.health.text if camera.health else "") for camera in data.record.cameras}
    dots = []
    for camera in scene.cameras:
        x, y = spot(camera.C)
        view = " ".join(f"{a:.1f},{b:.1f}" for a, b in map(spot, _field_of_view(camera, reach)))
        title = "; ".join(filter(None, (words[camera.id], camera.note)))
        dots.append(Dot(camera.id, camera.state, x, y, view, title))
    if len(dots) > _FEW:
        dots = _outside(dots)
    most = max((pair.figures.inliers or 0 for pair in data.record.pairs), default=0) or 1
    lines = [
        _line(pair, spot(standing[pair.cameras[0]].C), spot(standing[pair.cameras[1]].C), most)
        for pair in sorted(data.record.pairs, key=lambda pair: pair.ok)
        if standing.keys() >= {*pair.cameras}
    ]
    spots = [Spot(m.name, m.kind, *spot(m.at), max(10.0, 0.5 * m.size * scale), m.known) for m in scene.objects]
    bar = _round_length(0.2 * WIDTH / scale)
    east, north = scene.northward
    absent = tuple(camera.id for camera in data.record.cameras if camera.id not in standing)
    turned = math.degrees(math.atan2(east, north))
    words_of_bar = f"{bar:g} {scene.unit or 'units'}"
    drawn = tuple(dots), tuple(lines), tuple(spots)
    return Map(WIDTH, height, left, top, scale, *drawn, bar * scale, words_of_bar, turned, scene.north, absent)


def _outside(dots: list[Dot]) -> list[Dot]:
    """Place names away from the middle of all cameras, which often stand around something."""
    x, y = (sum(values) / len(dots) for values in ([d.x for d in dots], [d.y for d in dots]))
    found = []
    for dot in dots:
        across, down = dot.x - x, dot.y - y
        if abs(across) > 0.6 * abs(down):
            label = (math.copysign(9.0, across), 4.0, "start" if across > 0 else "end")
        else:
            label = (0.0, 18.0 if down > 0 else -10.0, "middle")
        found.append(replace(dot, label=label))
    return _apart(found)


def _apart(dots: list[Dot]) -> list[Dot]:
    """Leave out names that lie over others (the pointer shows them); those of cameras to look at come first."""
    taken: list[tuple[float, float, float]] = []
    bare = set()
    for dot in sorted(dots, key=lambda dot: dot.state == "good"):
        across, down, anchor = dot.label
        half = _LETTER * len(dot.id) / 2
        x = dot.x + across + {"start": half, "middle": 0.0, "end": -half}[anchor]
        y = dot.y + down
        if any(abs(x - a) < half + b and abs(y - c) < _LINE for a, b, c in taken):
            bare.add(dot.id)
        else:
            taken.append((x, half, y))
    return [replace(dot, named=dot.id not in bare) for dot in dots]


def _field_of_view(camera: SceneCamera, reach: float) -> list[tuple[float, float]]:
    """Return the corners of a camera's field of view on the ground; the widest two of its rays bound it."""
    level = [(r[0], r[1]) for r in camera.rays if math.hypot(r[0], r[1]) > 1e-9]
    if len(level) < 2 or math.hypot(camera.ahead[0], camera.ahead[1]) < 0.1:
        return []
    middle = math.atan2(camera.ahead[1], camera.ahead[0])
    turns = [(math.atan2(y, x) - middle + math.pi) % (2 * math.pi) - math.pi for x, y in level]
    first, last = min(turns), max(turns)
    angles = [middle + first + (last - first) * k / 8 for k in range(9)]
    at = camera.C
    return [(at[0], at[1]), *((at[0] + reach * math.cos(a), at[1] + reach * math.sin(a)) for a in angles)]


def _line(pair: PairRecord, start: tuple[float, float], end: tuple[float, float], most: float) -> Line:
    share = math.sqrt((pair.figures.inliers or 0) / most)
    note = f"{pair.figures.inliers or 0:,} inliers" if pair.ok else f"{pair.outcome}: {pair.reason or ''}"
    return Line(pair.name, pair.outcome, *start, *end, 1 + _WIDEST * share if pair.ok else 1.5, note)


def _round_length(length: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not longer."""
    power = 10.0 ** math.floor(math.log10(max(length, 1e-12)))
    return max(step * power for step in (1, 2, 5) if step * power <= length * 1.0001)

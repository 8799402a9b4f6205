"""Cameras and objects in one frame for the 3-D view and the map: right, away from the first view, and up."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..pipeline.stages import STAGES
from ..records.record import CameraRecord, PairRecord
from ..site.cameras import origin_of
from ..task import Task
from .data import ReportData, objects_of, since_last_good, state_of
from .pictures import data_url, split

Vector = tuple[float, float, float]
Matrix = Sequence[Sequence[float]]

_UPRIGHT = 0.5
"""The world's z is up where it agrees so well with every camera's."""
_TRIMMED, _GROWN = 0.1, 0.13
"""Share of the points that the extent leaves out at each end, and by which it grows again: far points don't shrink the site."""


@dataclass(frozen=True)
class SceneCamera:
    """A camera in the frame of the page."""

    id: str
    C: Vector
    rays: tuple[Vector, ...]
    """Through the four corners of its picture, of depth 1; () where its direction is not known."""
    ahead: Vector
    fov: float
    """Vertical, radians."""
    state: str
    note: str
    """Where its place is from, if not from tonight."""
    words: str
    """How it is, and that."""


@dataclass(frozen=True)
class Scene:
    """The frame of the page, and what stands in it."""

    rows: tuple[Vector, Vector, Vector]
    """Right, away and up, in the world."""
    origin: Vector
    cameras: tuple[SceneCamera, ...]
    objects: tuple[dict[str, Any], ...]
    """Those that stages report, such as changes, and whether each is known: was there on the last good night."""
    low: Vector
    """Corners of the box around most points and all cameras, in the frame of the page."""
    high: Vector
    middle: Vector
    """Of the points."""
    radius: float
    unit: str
    """m, or "" where the scale is not known."""
    north: str
    """Name of the direction of the world's y."""
    place: list[float] | None
    """Latitude, longitude and height of the world's origin, where the site is on the map."""

    def to(self, point: Sequence[float]) -> Vector:
        """Return a point of the world in the frame of the page."""
        return _times(self.rows, _minus(point, self.origin))

    def to_json(self) -> dict[str, Any]:
        """Return the input of the 3-D view."""
        cameras = [vars(camera) for camera in self.cameras]
        axes = {"rows": self.rows, "origin": self.origin, "unit": self.unit, "place": self.place}
        box = {"low": self.low, "high": self.high, "middle": self.middle, "radius": self.radius, "heading": -math.pi / 2}
        return {"axes": axes, **box, "north": self.north, "cameras": cameras, "marks": self.objects}


def scene_of(data: ReportData, sample: list[Vector]) -> Scene | None:
    """Return the frame of a run's page; None where no place is known.  sample: some points of the cloud.

    Up is the world's z where every camera agrees, else against the mean of the cameras' y axes; the first view goes from the
    cameras to the points, along an axis of the map where the site is on one.
    """
    record = data.record
    placed = {camera.id: place for camera in record.cameras if (place := data.placement(camera.id))}
    if not (sample or placed):
        return None
    centres: list[Vector] = [tuple(entry["C"]) for entry, _ in placed.values()]
    rotations: list[Matrix] = [entry["R"] for entry, _ in placed.values() if entry.get("R")]
    points = sample or _last_cloud(data)
    around = points or centres
    origin = _sum(points, 1 / len(points)) if points and not sample else _median(sample or centres)
    crs = record.poses.crs if record.poses else ""
    rows = _axes(_up(rotations), centres, origin, [R[2] for R in rotations], on_map=bool(crs))
    cameras = tuple(_camera(data, camera, placed[camera.id], rows, origin) for camera in record.cameras if camera.id in placed)
    objects = tuple(_objects(data, rows, origin))
    low, high = _box([_times(rows, _minus(point, origin)) for point in around], _TRIMMED if sample else 0.0)
    middle, radius = _sum((low, high), 0.5), max(math.dist(low, high) / 2, 1e-6)
    everything = list(zip(low, high, *(c.C for c in cameras), *(thing["at"] for thing in objects), strict=True))
    unit = "m" if not record.poses or record.poses.metric else ""
    extent = _vector(map(min, everything)), _vector(map(max, everything))
    return Scene(rows, origin, cameras, objects, *extent, middle, radius, unit, "N" if crs else "y", origin_of(crs))


def _last_cloud(data: ReportData) -> list[Vector]:
    """Return the corners of the last cloud: a night without one shows the same place from the same side."""
    for record in data.earlier:
        if record.cloud and record.poses and record.poses.metric:
            return [(x, y, z) for x, y, z in itertools.product(*zip(*record.cloud.bounds, strict=True))]
    return []


def _up(rotations: Sequence[Matrix]) -> Vector:
    if all(-R[1][2] > _UPRIGHT for R in rotations):
        return 0.0, 0.0, 1.0
    total = _sum([R[1] for R in rotations], -1.0)
    return _unit(total if math.hypot(*total) > 1e-6 else _sum([rotations[0][1]], -1.0))


def _axes(
    up: Vector, centres: Sequence[Vector], middle: Vector, looks: Sequence[Sequence[float]], on_map: bool
) -> tuple[Vector, Vector, Vector]:
    """Return right, away and up: away from where most cameras stand, else where they look."""
    ways = [_minus(middle, C) for C in centres]
    spread = sum(math.hypot(*way) for way in ways)
    away: Vector = (1.0, 0.0, 0.0)
    for way, enough in ((_sum(ways), 0.25 * spread), (_sum(looks), 0.1 * len(looks)), ((0.0, 1.0, 0.0), 0.0)):
        level = _minus(way, _sum([up], _dot(way, up)))
        if math.hypot(*level) > max(enough, 1e-6):
            away = _unit(level)
            break
    if on_map:
        x, y, _ = away
        away = (math.copysign(1, x), 0.0, 0.0) if abs(x) > abs(y) else (0.0, math.copysign(1, y), 0.0)
    right = (away[1] * up[2] - away[2] * up[1], away[2] * up[0] - away[0] * up[2], away[0] * up[1] - away[1] * up[0])
    return right, away, up


def _camera(
    data: ReportData, camera: CameraRecord, place: tuple[Mapping[str, Any], str], rows: Matrix, origin: Vector
) -> SceneCamera:
    entry, note = place
    C, state = _times(rows, _minus(entry["C"], origin)), state_of(camera, data.record)
    words = "; ".join(filter(None, (camera.reason or (camera.health.text if camera.health else ""), note)))
    if not entry.get("R"):
        return SceneCamera(camera.id, C, (), (0.0, 1.0, 0.0), 0.0, state, note, words)
    R, K = entry["R"], entry.get("K")
    width, height = entry.get("width") or 4, entry.get("height") or 3
    fx, fy, cx, cy = (K[0][0], K[1][1], K[0][2], K[1][2]) if K else (width, width, width / 2, height / 2)
    corners = ((0, 0), (width, 0), (width, height), (0, height))
    columns = list(zip(*R, strict=True))
    rays = tuple(_times(rows, _times(columns, ((x - cx) / fx, (y - cy) / fy, 1.0))) for x, y in corners)
    return SceneCamera(camera.id, C, rays, _times(rows, R[2]), 2 * math.atan(height / 2 / fy), state, note, words)


def _objects(data: ReportData, rows: Matrix, origin: Vector) -> Iterator[dict[str, Any]]:
    for stage in data.record.results:
        since = since_last_good(data, stage)
        for name, thing in objects_of(data.record, stage).items():
            at = _times(rows, _minus((thing.x, thing.y, thing.z), origin))
            size = math.hypot(thing.length or 0.0, thing.width or 0.0)
            known = since is not None and name in since.known
            yield {"name": name, "kind": thing.kind, "at": at, "size": size, "known": known}


def _box(points: Sequence[Vector], trimmed: float) -> tuple[Vector, Vector]:
    """Return the corners of the box around points, without a share of them at each end, but grown again."""
    ordered, skipped = [sorted(values) for values in zip(*points, strict=True)], int(trimmed * (len(points) - 1))
    low, high = (_vector(values[k] for values in ordered) for k in (skipped, len(points) - 1 - skipped))
    margin = _sum([_minus(high, low)], _GROWN if trimmed else 0.0)
    return _minus(low, margin), _sum((high, margin))


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _times(rows: Matrix, point: Sequence[float]) -> Vector:
    return _vector(_dot(row, point) for row in rows)


def _minus(a: Sequence[float], b: Sequence[float]) -> Vector:
    return _vector(x - y for x, y in zip(a, b, strict=True))


def _sum(vectors: Sequence[Sequence[float]], times: float = 1.0) -> Vector:
    return _vector(times * sum(vector[k] for vector in vectors) for k in range(3))


def _median(points: Sequence[Vector]) -> Vector:
    return _vector(sorted(values)[len(values) // 2] for values in zip(*points, strict=True))


def _unit(a: Vector) -> Vector:
    return _sum([a], 1 / (math.hypot(*a) or 1.0))


def _vector(values: Iterable[float]) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


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


class Map:
    """The site from above, in units of the drawing; its y axis points down."""

    width = WIDTH

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        wide, high = (max(scene.high[k] - scene.low[k], 1e-9) for k in (0, 1))
        self.scale = min((WIDTH - 2 * _MARGIN) / wide, (_LONGEST - 2 * _MARGIN) / high)
        """Units of the drawing for one of the page's frame."""
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
        """Return a place of the page's frame in the drawing."""
        return (place[0] - self.left) * self.scale, (self.top - place[1]) * self.scale

    def field_of_view(self, camera: SceneCamera) -> str:
        """Return its corners on the ground; "" where its direction is not known.  The widest two of its rays bound it."""
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
        """Yield the pairs whose cameras have a place, with the width of their lines and their words; usable ones come last."""
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
        """Where the world's y points, clockwise from the top."""
        return math.degrees(math.atan2(self.scene.rows[0][1], self.scene.rows[1][1]))


def _outside(cameras: Sequence[SceneCamera], at: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float, str]]:
    """Place names away from the middle of all cameras, which often stand around something.

    Those that lie over others are left out (the pointer shows them); those of cameras to look at come first.
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
    """Return the pictures on the map; the head of each names its top left, top right and bottom left corner in the world.

    Their matrices go from the unit square to the drawing, as CSS has it: a, b, c, d, e, f.
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

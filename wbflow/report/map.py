"""Cameras and objects in one frame for the 3-D view and the map: right, away from the first view, and up."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..pipeline.stages import STAGES
from ..records.record import CameraRecord, PairRecord
from ..site.geodesy import origin_of
from ..task import Task
from .data import ReportData, objects_of, since_last_good, state_of
from .pictures import data_url, split

Vector = tuple[float, float, float]
Array = NDArray[np.float64]

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
class SceneObject:
    """An object that a stage reports, such as a change."""

    name: str
    kind: str
    at: Vector
    size: float
    known: bool
    """Whether it was there on the last good night."""


@dataclass(frozen=True)
class Scene:
    """The frame of the page, and what stands in it."""

    rows: Array
    """Right, away and up, in the world."""
    origin: Array
    cameras: tuple[SceneCamera, ...]
    objects: tuple[SceneObject, ...]
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
        return _vector(self.rows @ (np.array(point) - self.origin))

    def to_json(self) -> dict[str, Any]:
        """Return the input of the 3-D view."""
        cameras, marks = [vars(camera) for camera in self.cameras], [vars(thing) for thing in self.objects]
        axes = {"rows": self.rows.tolist(), "origin": self.origin.tolist(), "unit": self.unit, "place": self.place}
        box = {"low": self.low, "high": self.high, "middle": self.middle, "radius": self.radius, "heading": -math.pi / 2}
        return {"axes": axes, **box, "north": self.north, "cameras": cameras, "marks": marks}


def scene_of(data: ReportData, sample: list[Vector]) -> Scene | None:
    """Return the frame of a run's page; None where no place is known.  sample: some points of the cloud.

    Up is the world's z where every camera agrees, else against the mean of the cameras' y axes; the first view goes from the
    cameras to the points, along an axis of the map where the site is on one.
    """
    record = data.record
    placed = {camera.id: place for camera in record.cameras if (place := data.placement(camera.id))}
    if not (sample or placed):
        return None
    centres = np.array([entry["C"] for entry, _ in placed.values()]).reshape(-1, 3)
    rotations = np.array([entry["R"] for entry, _ in placed.values() if entry.get("R")]).reshape(-1, 3, 3)
    points = np.array(sample or _last_cloud(data)).reshape(-1, 3)
    around = points if sample else centres
    origin = points.mean(axis=0) if len(points) and not sample else np.sort(around, axis=0)[len(around) // 2]
    crs = record.poses.crs if record.poses else ""
    rows = _axes(_up(rotations), centres, origin, rotations[:, 2], on_map=bool(crs))
    cameras = tuple(_camera(data, camera, placed[camera.id], rows, origin) for camera in record.cameras if camera.id in placed)
    objects = tuple(_objects(data, rows, origin))
    low, high = _box(((points if len(points) else centres) - origin) @ rows.T, _TRIMMED if sample else 0.0)
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-6)
    everything = np.array([low, high, *(c.C for c in cameras), *(o.at for o in objects)])
    unit = "m" if not record.poses or record.poses.metric else ""
    extent = _vector(everything.min(axis=0)), _vector(everything.max(axis=0))
    return Scene(rows, origin, cameras, objects, *extent, _vector(middle), radius, unit, "N" if crs else "y", origin_of(crs))


def _last_cloud(data: ReportData) -> list[Vector]:
    """Return the corners of the last cloud: a night without one shows the same place from the same side."""
    for record in data.earlier:
        if record.cloud and record.poses and record.poses.metric:
            return [(x, y, z) for x, y, z in itertools.product(*zip(*record.cloud.bounds, strict=True))]
    return []


def _up(rotations: Array) -> Array:
    if np.all(-rotations[:, 1, 2] > _UPRIGHT):
        return np.array([0.0, 0.0, 1.0])
    total = -rotations[:, 1].sum(axis=0)
    return _unit(total if np.linalg.norm(total) > 1e-6 else -rotations[0, 1])


def _axes(up: Array, centres: Array, middle: Array, looks: Array, on_map: bool) -> Array:
    """Return right, away and up: away from where most cameras stand, else where they look."""
    spread = np.linalg.norm(middle - centres, axis=1).sum()
    ways = ((middle - centres).sum(axis=0), 0.25 * spread), (looks.sum(axis=0), 0.1 * len(looks)), (np.eye(3)[1], 0.0)
    away = np.eye(3)[0]
    for way, enough in ways:
        level = way - (way @ up) * up
        if np.linalg.norm(level) > max(enough, 1e-6):
            away = _unit(level)
            break
    if on_map:
        k = 0 if abs(away[0]) > abs(away[1]) else 1
        away = math.copysign(1, away[k]) * np.eye(3)[k]
    return np.array([np.cross(away, up), away, up])


def _camera(
    data: ReportData, camera: CameraRecord, place: tuple[Mapping[str, Any], str], rows: Array, origin: Array
) -> SceneCamera:
    entry, note = place
    C, state = _vector(rows @ (np.array(entry["C"]) - origin)), state_of(camera, data.record)
    words = "; ".join(filter(None, (camera.reason or (camera.health.text if camera.health else ""), note)))
    if not entry.get("R"):
        return SceneCamera(camera.id, C, (), (0.0, 1.0, 0.0), 0.0, state, note, words)
    R, K = np.array(entry["R"]), entry.get("K")
    width, height = entry.get("width") or 4, entry.get("height") or 3
    fx, fy, cx, cy = (K[0][0], K[1][1], K[0][2], K[1][2]) if K else (width, width, width / 2, height / 2)
    corners = ((0, 0), (width, 0), (width, height), (0, height))
    rays = tuple(_vector(rows @ R.T @ ((x - cx) / fx, (y - cy) / fy, 1.0)) for x, y in corners)
    return SceneCamera(camera.id, C, rays, _vector(rows @ R[2]), 2 * math.atan(height / 2 / fy), state, note, words)


def _objects(data: ReportData, rows: Array, origin: Array) -> Iterator[SceneObject]:
    for stage in data.record.results:
        since = since_last_good(data, stage)
        for name, thing in objects_of(data.record, stage).items():
            at = _vector(rows @ (np.array([thing.x, thing.y, thing.z]) - origin))
            size = math.hypot(thing.length or 0.0, thing.width or 0.0)
            yield SceneObject(name, thing.kind, at, size, since is not None and name in since.known)


def _box(points: Array, trimmed: float) -> tuple[Array, Array]:
    """Return the corners of the box around points, without a share of them at each end, but grown again."""
    ordered, skipped = np.sort(points, axis=0), int(trimmed * (len(points) - 1))
    low, high = ordered[skipped], ordered[len(points) - 1 - skipped]
    margin = (_GROWN if trimmed else 0.0) * (high - low)
    return low - margin, high + margin


def _unit(a: Array) -> Array:
    return a / (np.linalg.norm(a) or 1.0)


def _vector(a: Array) -> Vector:
    x, y, z = a.tolist()
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
        return math.degrees(math.atan2(self.scene.rows[0, 1], self.scene.rows[1, 1]))


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


@dataclass(frozen=True)
class Layer:
    """A picture on the map."""

    name: str
    """Of the stage."""
    words: str
    legend: Sequence[tuple[str, str]]
    """Meaning of each colour."""
    data: str
    """A data URL."""
    matrix: tuple[float, ...]
    """From the unit square to the drawing, as CSS has it: a, b, c, d, e, f."""


def layers_of(data: ReportData, drawn: Map) -> list[Layer]:
    """Return the pictures on the map; the head of each names its top left, top right and bottom left corner in the world."""
    found = []
    for stage in STAGES:
        if layer := data.drawing(Task(stage.name), "layer"):
            head, picture = split(layer)
            (x, y), right, down = (drawn.at(drawn.scene.to(corner)) for corner in head["corners"])
            matrix = (right[0] - x, right[1] - y, down[0] - x, down[1] - y, x, y)
            found.append(Layer(stage.name, head["words"], head["legend"], data_url(picture, "image/png"), matrix))
    return found

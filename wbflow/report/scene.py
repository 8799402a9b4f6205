"""Cameras, objects and points in one frame for the 3-D view and the map: right, away from the first view, and up."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .data import ReportData, objects_of, since_last_good, state_of

Vector = tuple[float, float, float]
Rows = tuple[Vector, Vector, Vector]

_UPRIGHT = 0.5
"""The world's z is up where it agrees so well with every camera's."""
_TRIMMED, _GROWN = 0.1, 0.13
"""Share of the points that the extent leaves out at each end, and by which it grows again: far points don't shrink the site."""


@dataclass(frozen=True)
class SceneCamera:
    """A camera in the frame of the page."""

    id: str
    at: Vector
    rays: tuple[Vector, ...]
    """Through the four corners of its picture, of depth 1; () where its direction is not known."""
    ahead: Vector
    fov: float
    """Vertical, radians."""
    state: str
    note: str
    """Where its place is from, if not from tonight."""


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

    rows: Rows
    """Right, away and up, in the world."""
    origin: Vector
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

    def to(self, point: Sequence[float]) -> Vector:
        """Return a point of the world in the frame of the page."""
        return _turned(self.rows, tuple(p - o for p, o in zip(point, self.origin, strict=True)))

    @property
    def northward(self) -> tuple[float, float]:
        """The world's y (or what comes nearest to it) on the map."""
        return self.rows[0][1], self.rows[1][1]

    def to_json(self) -> dict[str, Any]:
        """Return the input of the 3-D view."""
        cameras = [
            {"id": c.id, "C": c.at, "rays": c.rays, "ahead": c.ahead, "fov": c.fov, "state": c.state, "note": c.note}
            for c in self.cameras
        ]
        marks = [{"name": m.name, "kind": m.kind, "at": m.at, "size": m.size} for m in self.objects]
        axes = {"rows": self.rows, "origin": self.origin, "unit": self.unit}
        box = {"low": self.low, "high": self.high, "middle": self.middle, "radius": self.radius, "heading": -math.pi / 2}
        return {"axes": axes, **box, "north": self.north, "northward": self.northward, "cameras": cameras, "marks": marks}


def scene_of(data: ReportData, sample: list[Vector]) -> Scene | None:
    """Return the frame of a run's page; None where no place is known.  sample: some points of the cloud.

    Up is the world's z where every camera agrees, else against the mean of the cameras' y axes; the first view goes from the
    cameras to the points, along an axis of the map where the site is on one.
    """
    record = data.record
    stood = {camera.id: place for camera in record.cameras if (place := data.placement(camera.id))}
    centres: list[Vector] = [tuple(entry["C"]) for entry, _ in stood.values()]
    if not (sample or centres):
        return None
    up = _up([entry["R"] for entry, _ in stood.values() if entry.get("R")])
    before = [] if sample else _last_cloud(data)
    origin = _between(before[0], before[-1]) if before else _median(sample or centres)
    crs = record.poses.crs if record.poses else ""
    looks = [tuple(entry["R"][2]) for entry, _ in stood.values() if entry.get("R")]
    rows = _rows(up, centres, origin, looks, on_map=bool(crs))
    cameras = tuple(_camera(data, camera, stood[camera.id], rows, origin) for camera in record.cameras if camera.id in stood)
    objects = tuple(_objects(data, rows, origin))
    near = [_turned(rows, _less(p, origin)) for p in sample or before]
    box = _grown(_box(near, _TRIMMED)) if sample else _box(near or [c.at for c in cameras], 0.0)
    middle = _between(*box)
    radius = max(math.dist(*box) / 2, 1e-6)
    low, high = _box([*box, *(c.at for c in cameras), *(m.at for m in objects)], 0.0)
    unit = "m" if not record.poses or record.poses.metric else ""
    north = "N" if crs else "y"
    return Scene(rows, origin, cameras, objects, low, high, middle, radius, unit, north)


def _last_cloud(data: ReportData) -> list[Vector]:
    """Return the corners of the last cloud: a night without one shows the same place from the same side."""
    for record in data.earlier:
        if record.cloud and record.poses and record.poses.metric:
            return [(x, y, z) for x, y, z in itertools.product(*zip(*record.cloud.bounds, strict=True))]
    return []


def _up(rotations: list[Any]) -> Vector:
    if not rotations or all(-R[1][2] > _UPRIGHT for R in rotations):
        return 0.0, 0.0, 1.0
    total = tuple(-sum(R[1][k] for R in rotations) for k in range(3))
    return _unit(total) if math.hypot(*total) > 1e-6 else _unit(tuple(-v for v in rotations[0][1]))


def _rows(up: Vector, centres: list[Vector], middle: Vector, looks: list[Vector], on_map: bool) -> Rows:
    """Return right, away and up: away from where most cameras stand, else where they look."""
    towards = tuple(sum(middle[k] - c[k] for c in centres) for k in range(3))
    along = tuple(sum(look[k] for look in looks) for k in range(3))
    away = (0.0, 0.0, 0.0)
    spread = sum(math.dist(middle, c) for c in centres)
    for way, enough in ((towards, 0.25 * spread), (along, 0.1 * len(looks)), ((0.0, 1.0, 0.0), 0.0), ((1.0, 0.0, 0.0), 0.0)):
        level = _less(way, tuple(_dot(way, up) * u for u in up))
        if math.hypot(*level) > max(enough, 1e-6):
            away = _unit(level)
            break
    if on_map:
        away = (math.copysign(1, away[0]), 0.0, 0.0) if abs(away[0]) > abs(away[1]) else (0.0, math.copysign(1, away[1]), 0.0)
    right = (away[1] * up[2] - away[2] * up[1], away[2] * up[0] - away[0] * up[2], away[0] * up[1] - away[1] * up[0])
    return right, away, up


def _camera(data: ReportData, camera: Any, place: tuple[Mapping[str, Any], str], rows: Rows, origin: Vector) -> SceneCamera:
    entry, note = place
    R, K, at = entry.get("R"), entry.get("K"), _turned(rows, _less(entry["C"], origin))
    rays: tuple[Vector, ...] = ()
    ahead, fov = (0.0, 1.0, 0.0), 0.0
    if R:
        ahead = _turned(rows, R[2])
        width, height = entry.get("width") or 4, entry.get("height") or 3
        fx, fy, cx, cy = (K[0][0], K[1][1], K[0][2], K[1][2]) if K else (width, width, width / 2, height / 2)
        corners = ((0, 0), (width, 0), (width, height), (0, height))
        through = (((x - cx) / fx, (y - cy) / fy, 1.0) for x, y in corners)
        rays = tuple(_turned(rows, tuple(sum(R[i][k] * d[i] for i in range(3)) for k in range(3))) for d in through)
        fov = 2 * math.atan(height / 2 / fy)
    return SceneCamera(camera.id, at, rays, ahead, fov, state_of(camera, data.record), note)


def _objects(data: ReportData, rows: Rows, origin: Vector) -> Iterable[SceneObject]:
    for stage, figures in data.record.later.items():
        since = since_last_good(data, stage)
        for name, thing in objects_of(figures).items():
            at = _turned(rows, _less((thing["x"], thing["y"], thing["z"]), origin))
            size = math.hypot(thing.get("length") or 0, thing.get("width") or 0)
            yield SceneObject(name, str(thing.get("kind") or ""), at, size, since is not None and name in since.known)


def _turned(rows: Rows, v: Sequence[float]) -> Vector:
    return _dot(rows[0], v), _dot(rows[1], v), _dot(rows[2], v)


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _less(a: Sequence[float], b: Sequence[float]) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _between(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2


def _unit(a: Sequence[float]) -> Vector:
    length = math.hypot(*a) or 1.0
    return a[0] / length, a[1] / length, a[2] / length


def _median(points: Sequence[Vector]) -> Vector:
    x, y, z = (sorted(p[k] for p in points)[len(points) // 2] for k in range(3))
    return x, y, z


def _grown(box: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
    low, high = box
    margin = tuple(_GROWN * (b - a) for a, b in zip(low, high, strict=True))
    return _less(low, margin), _less(high, tuple(-m for m in margin))


def _box(points: Sequence[Vector], trimmed: float) -> tuple[Vector, Vector]:
    ordered = [sorted(p[k] for p in points) for k in range(3)]
    least, most = int(trimmed * (len(points) - 1)), len(points) - 1 - int(trimmed * (len(points) - 1))
    return tuple(v[least] for v in ordered), tuple(v[most] for v in ordered)  # type: ignore[return-value]

"""Cameras and objects in the coordinate frame of the 3-D view and the map: right, away from the first view, and up."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ..records.record import CameraRecord
from ..site.geodesy import origin_of
from .data import ReportData, state_of

Vector = tuple[float, float, float]
Matrix = Sequence[Sequence[float]]

_LEAST_UPRIGHT = 0.5
"""The world's z axis is up if the cosine of its angle with the upward (-y) axis of every camera is above this."""
_TRIMMED_SHARE, _MARGIN_SHARE = 0.1, 0.13
"""Share of points left out of the extent at each end of an axis (far ones would shrink the site), and the margin then added."""


@dataclass(frozen=True)
class Axes:
    """The coordinate frame of the page."""

    rows: tuple[Vector, Vector, Vector]
    """Right, away and up, in world coordinates."""
    origin: Vector

    def place(self, point: Sequence[float]) -> Vector:
        """Return a world point in the frame of the page."""
        return _rotate(self.rows, _minus(point, self.origin))


@dataclass(frozen=True)
class SceneCamera:
    """A camera in the frame of the page."""

    id: str
    C: Vector
    rays: tuple[Vector, ...]
    """Rays of depth 1 through the four corners of its picture; () if its rotation is unknown."""
    ahead: Vector
    fov: float
    """Vertical field of view, radians."""
    state: str
    note: str
    """Source of its pose; "" if it is from tonight."""
    words: str
    """Its state in words, followed by `note`."""


@dataclass(frozen=True)
class Scene:
    """Cameras and objects in the frame of the page."""

    axes: Axes
    cameras: tuple[SceneCamera, ...]
    objects: tuple[dict[str, Any], ...]
    """Objects that stages report, such as changes; `known` means that the object was there on the last good night."""
    low: Vector
    """Lower corner of the box around most points, all cameras and all objects, in the frame of the page; `high`: the other."""
    high: Vector
    middle: Vector
    """Centre of the box around most points; `radius` is half its diagonal."""
    radius: float
    unit: str
    """m, or "" if the scale is unknown."""
    north: str
    """Name of the direction of the world's y axis."""
    place: list[float] | None
    """Latitude, longitude and height of the world's origin; None if the site is not georeferenced."""

    def to_json(self) -> dict[str, Any]:
        """Return the input of the 3-D view."""
        cameras = [vars(camera) for camera in self.cameras]
        axes = {**vars(self.axes), "unit": self.unit, "place": self.place}
        box = {"low": self.low, "high": self.high, "middle": self.middle, "radius": self.radius, "heading": -math.pi / 2}
        return {"axes": axes, **box, "north": self.north, "cameras": cameras, "marks": self.objects}


def scene_of(data: ReportData, sample: list[Vector]) -> Scene | None:
    """Return the frame of a run's page; None without a sample and camera positions.  sample: some points of the cloud.

    Up is the world's z axis if it agrees with every camera's, else the opposite of the cameras' mean y axis.  The first view
    looks from the cameras to the points, along a world axis if the site is georeferenced.
    """
    record, placements = data.record, data.placements
    placed = [camera for camera in record.cameras if camera.id in placements]
    if not (sample or placed):
        return None
    entries = [placements[camera.id][0] for camera in placed]
    centres: list[Vector] = [tuple(entry["C"]) for entry in entries]
    rotations: list[Matrix] = [entry["R"] for entry in entries if entry.get("R")]
    if sample:
        points, origin = sample, _median(sample)
    elif points := _last_cloud(data):
        origin = _sum(points, 1 / len(points))
    else:
        points, origin = centres, _median(centres)
    crs = record.poses.crs if record.poses else ""
    axes = Axes(_rows(rotations, centres, origin, on_map=bool(crs)), origin)
    cameras = tuple(_camera(data, camera, axes) for camera in placed)
    objects = tuple(_objects(data, axes))
    low, high = _box([axes.place(point) for point in points], _TRIMMED_SHARE if sample else 0.0)
    middle, radius = _sum((low, high), 0.5), max(math.dist(low, high) / 2, 1e-6)
    coordinates = list(zip(low, high, *(c.C for c in cameras), *(item["at"] for item in objects), strict=True))
    extent = _vector(map(min, coordinates)), _vector(map(max, coordinates))
    return Scene(axes, cameras, objects, *extent, middle, radius, data.unit, "N" if crs else "y", origin_of(crs))


def _last_cloud(data: ReportData) -> list[Vector]:
    """Return the corners of the last cloud, so that a night without a cloud shows the same place from the same side."""
    for record in data.earlier:
        if record.cloud and record.poses and record.poses.metric:
            return [(x, y, z) for x, y, z in itertools.product(*zip(*record.cloud.bounds, strict=True))]
    return []


def _up(rotations: Sequence[Matrix]) -> Vector:
    if all(-R[1][2] > _LEAST_UPRIGHT for R in rotations):
        return 0.0, 0.0, 1.0
    total = _sum([R[1] for R in rotations], -1.0)
    return _unit(total if math.hypot(*total) > 1e-6 else _sum([rotations[0][1]], -1.0))


def _rows(rotations: Sequence[Matrix], centres: Sequence[Vector], middle: Vector, on_map: bool) -> tuple[Vector, Vector, Vector]:
    """Return right, away and up: away points from the cameras to the middle, else where they look, else along y."""
    up, view_axes = _up(rotations), [R[2] for R in rotations]
    to_middle = [_minus(middle, C) for C in centres]
    spread = sum(math.hypot(*vector) for vector in to_middle)
    away: Vector = (1.0, 0.0, 0.0)
    for vector, least in ((_sum(to_middle), 0.25 * spread), (_sum(view_axes), 0.1 * len(view_axes)), ((0.0, 1.0, 0.0), 0.0)):
        horizontal = _minus(vector, _sum([up], _dot(vector, up)))
        if math.hypot(*horizontal) > max(least, 1e-6):
            away = _unit(horizontal)
            break
    if on_map:
        x, y, _ = away
        away = (math.copysign(1, x), 0.0, 0.0) if abs(x) > abs(y) else (0.0, math.copysign(1, y), 0.0)
    right = (away[1] * up[2] - away[2] * up[1], away[2] * up[0] - away[0] * up[2], away[0] * up[1] - away[1] * up[0])
    return right, away, up


def _camera(data: ReportData, camera: CameraRecord, axes: Axes) -> SceneCamera:
    entry, note = data.placements[camera.id]
    C, state = axes.place(entry["C"]), state_of(camera, data.record)
    words = "; ".join(filter(None, (camera.reason or (camera.health.text if camera.health else ""), note)))
    if not entry.get("R"):
        return SceneCamera(camera.id, C, (), (0.0, 1.0, 0.0), 0.0, state, note, words)
    R, K = entry["R"], entry.get("K")
    width, height = entry.get("width") or 4, entry.get("height") or 3
    fx, fy, cx, cy = (K[0][0], K[1][1], K[0][2], K[1][2]) if K else (width, width, width / 2, height / 2)
    corners = ((0, 0), (width, 0), (width, height), (0, height))
    columns = list(zip(*R, strict=True))
    rays = tuple(_rotate(axes.rows, _rotate(columns, ((x - cx) / fx, (y - cy) / fy, 1.0))) for x, y in corners)
    return SceneCamera(camera.id, C, rays, _rotate(axes.rows, R[2]), 2 * math.atan(height / 2 / fy), state, note, words)


def _objects(data: ReportData, axes: Axes) -> Iterator[dict[str, Any]]:
    since = data.since_last_good
    for name, change in data.record.changes.items():
        at, size = axes.place((change.x, change.y, change.z)), math.hypot(change.length or 0.0, change.width or 0.0)
        yield {"name": name, "kind": change.kind, "at": at, "size": size, "known": since is not None and name in since.known}


def _box(points: Sequence[Vector], share: float) -> tuple[Vector, Vector]:
    """Return two corners of the box around points; if a share is trimmed at each end of the axes, a margin is added."""
    ordered, skipped = [sorted(values) for values in zip(*points, strict=True)], int(share * (len(points) - 1))
    low, high = (_vector(values[k] for values in ordered) for k in (skipped, len(points) - 1 - skipped))
    margin = _sum([_minus(high, low)], _MARGIN_SHARE if share else 0.0)
    return _minus(low, margin), _sum((high, margin))


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _rotate(rows: Matrix, point: Sequence[float]) -> Vector:
    return _vector(_dot(row, point) for row in rows)


def _minus(a: Sequence[float], b: Sequence[float]) -> Vector:
    return _vector(x - y for x, y in zip(a, b, strict=True))


def _sum(vectors: Sequence[Sequence[float]], factor: float = 1.0) -> Vector:
    return _vector(factor * sum(vector[k] for vector in vectors) for k in range(3))


def _median(points: Sequence[Vector]) -> Vector:
    return _vector(sorted(values)[len(values) // 2] for values in zip(*points, strict=True))


def _unit(a: Vector) -> Vector:
    return _sum([a], 1 / (math.hypot(*a) or 1.0))


def _vector(values: Iterable[float]) -> Vector:
    x, y, z = map(float, values)
    return x, y, z

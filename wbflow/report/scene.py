"""Cameras, objects and points in one frame for the 3-D view and the map: right, away from the first view, and up."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .data import ReportData, objects_of, since_last_good, state_of

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

    def to(self, point: Sequence[float]) -> Vector:
        """Return a point of the world in the frame of the page."""
        return _vector(self.rows @ (np.array(point) - self.origin))

    @property
    def northward(self) -> tuple[float, float]:
        """The world's y (or what comes nearest to it) on the map."""
        return float(self.rows[0, 1]), float(self.rows[1, 1])

    def to_json(self) -> dict[str, Any]:
        """Return the input of the 3-D view."""
        cameras, marks = [vars(camera) for camera in self.cameras], [vars(thing) for thing in self.objects]
        axes = {"rows": self.rows.tolist(), "origin": self.origin.tolist(), "unit": self.unit}
        box = {"low": self.low, "high": self.high, "middle": self.middle, "radius": self.radius, "heading": -math.pi / 2}
        return {"axes": axes, **box, "north": self.north, "northward": self.northward, "cameras": cameras, "marks": marks}


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
    return Scene(rows, origin, cameras, objects, *extent, _vector(middle), radius, unit, "N" if crs else "y")


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


def _camera(data: ReportData, camera: Any, place: tuple[Mapping[str, Any], str], rows: Array, origin: Array) -> SceneCamera:
    entry, note = place
    C, state = _vector(rows @ (np.array(entry["C"]) - origin)), state_of(camera, data.record)
    if not entry.get("R"):
        return SceneCamera(camera.id, C, (), (0.0, 1.0, 0.0), 0.0, state, note)
    R, K = np.array(entry["R"]), entry.get("K")
    width, height = entry.get("width") or 4, entry.get("height") or 3
    fx, fy, cx, cy = (K[0][0], K[1][1], K[0][2], K[1][2]) if K else (width, width, width / 2, height / 2)
    corners = ((0, 0), (width, 0), (width, height), (0, height))
    rays = tuple(_vector(rows @ R.T @ ((x - cx) / fx, (y - cy) / fy, 1.0)) for x, y in corners)
    return SceneCamera(camera.id, C, rays, _vector(rows @ R[2]), 2 * math.atan(height / 2 / fy), state, note)


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

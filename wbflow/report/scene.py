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
"""The world's z axis is up if the cosine of its angle with the upward (-y) axis of every camera is above this.

Larger: cameras that look steeply down tilt the world.  Smaller: a world that lies on its side counts as upright."""
_LEAST_VECTOR = 1e-6
"""Vectors shorter than this have no direction."""
_LEAST_ALIKE = 0.25
"""The directions from the cameras to the middle of the scene have a common one if their sum is at least this share of the sum of
their lengths: cameras all around a scene have none."""
_LEAST_VIEW_ALIKE = 0.1
"""The same for the directions in which the cameras look."""
_TRIMMED_SHARE = 0.1
"""Share of the points that is left out of the extent at each end of an axis: far ones would make the site small."""
_MARGIN_SHARE = 0.13
"""Margin that is then added at each end, as a share of the extent."""
_DEFAULT_SIZE = (4, 3)
"""Width and height of the picture of a camera for which they are not known: only their ratio matters."""


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
        return {
            "axes": {**vars(self.axes), "unit": self.unit, "place": self.place},
            "low": self.low,
            "high": self.high,
            "middle": self.middle,
            "radius": self.radius,
            "heading": -math.pi / 2,
            "north": self.north,
            "cameras": [vars(camera) for camera in self.cameras],
            "marks": self.objects,
        }


def scene_of(data: ReportData, sample: list[Vector]) -> Scene | None:
    """Return the frame of a run's page; None without a sample and camera positions.  sample: some points of the cloud.

    Up is the world's z axis if it agrees with every camera's, else the opposite of the cameras' mean y axis.  The first view
    looks from the cameras to the points, along a world axis if the site is georeferenced.
    """
    record = data.record
    placements = data.placements
    placed: list[CameraRecord] = []
    centres: list[Vector] = []
    rotations: list[Matrix] = []
    for camera in record.cameras:
        if camera.id in placements:
            entry, _ = placements[camera.id]
            placed.append(camera)
            centres.append(tuple(entry["C"]))
            if entry.get("R"):
                rotations.append(entry["R"])
    if not (sample or placed):
        return None

    # 1. The axes of the page: their origin is in the middle of the points, as far as there are any.
    points, origin = _points_and_origin(data, sample, centres)
    crs = ""
    if record.poses:
        crs = record.poses.crs
    axes = Axes(_rows(rotations, centres, origin, on_map=bool(crs)), origin)

    # 2. What is in the scene.
    cameras = tuple(_camera(data, camera, axes) for camera in placed)
    objects = tuple(_objects(data, axes))

    # 3. How far it reaches: the box around most points is what the first view shows; the map holds all cameras and objects, too.
    low, high = _box([axes.place(point) for point in points], trimmed=bool(sample))
    middle = _sum((low, high), 0.5)
    radius = max(math.dist(low, high) / 2, _LEAST_VECTOR)
    corners = [low, high]
    for placed_camera in cameras:
        corners.append(placed_camera.C)
    for item in objects:
        corners.append(item["at"])
    outer_low, outer_high = _ends(corners, skipped=0)
    north = "N" if crs else "y"
    return Scene(axes, cameras, objects, outer_low, outer_high, middle, radius, data.unit, north, origin_of(crs))


def _points_and_origin(data: ReportData, sample: list[Vector], centres: list[Vector]) -> tuple[list[Vector], Vector]:
    """Return points that show how far the scene reaches, and its middle: of the cloud, the last cloud, or else the cameras."""
    if sample:
        return sample, _median(sample)
    last_cloud = _last_cloud(data)
    if last_cloud:
        return last_cloud, _sum(last_cloud, 1 / len(last_cloud))
    return centres, _median(centres)


def _last_cloud(data: ReportData) -> list[Vector]:
    """Return the corners of the last cloud, so that a night without a cloud shows the same place from the same side."""
    for record in data.earlier:
        if record.cloud and record.poses and record.poses.metric:
            (x0, y0, z0), (x1, y1, z1) = record.cloud.bounds
            return list(itertools.product((x0, x1), (y0, y1), (z0, z1)))
    return []


def _rows(rotations: Sequence[Matrix], centres: Sequence[Vector], middle: Vector, on_map: bool) -> tuple[Vector, Vector, Vector]:
    """Return right, away and up: away points from the cameras to the middle, else where they look, else along y."""
    up = _up(rotations)
    view_axes = [R[2] for R in rotations]
    to_middle = []
    spread = 0.0
    for C in centres:
        vector = _minus(middle, C)
        to_middle.append(vector)
        spread += math.hypot(*vector)

    # The first of these directions that the cameras have in common, and that is not upright.
    candidates = [
        (_sum(to_middle), _LEAST_ALIKE * spread),
        (_sum(view_axes), _LEAST_VIEW_ALIKE * len(view_axes)),
        ((0.0, 1.0, 0.0), 0.0),
    ]
    away: Vector = (1.0, 0.0, 0.0)
    for vector, least in candidates:
        # without its part along the vertical
        horizontal = _minus(vector, _sum([up], _dot(vector, up)))
        if math.hypot(*horizontal) > max(least, _LEAST_VECTOR):
            away = _unit(horizontal)
            break

    if on_map:
        # along the axis of the map that is nearest, so that north is at one of the four sides
        x, y, _ = away
        if abs(x) > abs(y):
            away = (math.copysign(1, x), 0.0, 0.0)
        else:
            away = (0.0, math.copysign(1, y), 0.0)
    return _cross(away, up), away, up


def _up(rotations: Sequence[Matrix]) -> Vector:
    # the second row of R is the camera's y axis, which points down in the picture
    if all(-R[1][2] > _LEAST_UPRIGHT for R in rotations):
        return 0.0, 0.0, 1.0
    mean = _sum([R[1] for R in rotations], -1.0)
    if math.hypot(*mean) > _LEAST_VECTOR:
        return _unit(mean)
    return _unit(_sum([rotations[0][1]], -1.0))


def _camera(data: ReportData, camera: CameraRecord, axes: Axes) -> SceneCamera:
    entry, note = data.placements[camera.id]
    C = axes.place(entry["C"])
    state = state_of(camera, data.record)
    reason = camera.reason
    if not reason and camera.health:
        reason = camera.health.text
    words = "; ".join(filter(None, (reason, note)))
    if not entry.get("R"):
        return SceneCamera(camera.id, C, (), (0.0, 1.0, 0.0), 0.0, state, note, words)

    width = entry.get("width") or _DEFAULT_SIZE[0]
    height = entry.get("height") or _DEFAULT_SIZE[1]
    K = entry.get("K") or [[width, 0, width / 2], [0, width, height / 2]]
    fx = K[0][0]
    fy = K[1][1]
    R = entry["R"]
    world_R_camera = list(zip(*R, strict=True))  # the transpose of R, whose rows are the camera's axes in the world
    # the corners of the picture, seen from the camera: K^-1 (x, y, 1), turned into the page's frame
    rays = []
    for x, y in ((0, 0), (width, 0), (width, height), (0, height)):
        ray = ((x - K[0][2]) / fx, (y - K[1][2]) / fy, 1.0)
        rays.append(_rotate(axes.rows, _rotate(world_R_camera, ray)))
    fov = 2 * math.atan(height / 2 / fy)
    return SceneCamera(camera.id, C, tuple(rays), _rotate(axes.rows, R[2]), fov, state, note, words)


def _objects(data: ReportData, axes: Axes) -> Iterator[dict[str, Any]]:
    since = data.since_last_good
    # dashed on the map if it was there on the last good night
    for name, change in data.record.changes.items():
        yield {
            "name": name,
            "kind": change.kind,
            "at": axes.place((change.x, change.y, change.z)),
            "size": math.hypot(change.length or 0.0, change.width or 0.0),
            "known": since is not None and name in since.known,
        }


def _box(points: Sequence[Vector], *, trimmed: bool) -> tuple[Vector, Vector]:
    """Return two corners of the box around points; trimmed: around most of them, with a margin."""
    if not trimmed:
        return _ends(points, skipped=0)
    low, high = _ends(points, skipped=int(_TRIMMED_SHARE * (len(points) - 1)))
    margin = _sum([_minus(high, low)], _MARGIN_SHARE)
    return _minus(low, margin), _sum((high, margin))


def _ends(points: Sequence[Vector], skipped: int) -> tuple[Vector, Vector]:
    """Return two corners of the box around points, without so many of them at each end of each axis."""
    low = []
    high = []
    for values in zip(*points, strict=True):
        ordered = sorted(values)
        low.append(ordered[skipped])
        high.append(ordered[-1 - skipped])
    return _vector(low), _vector(high)


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    total = 0.0
    for x, y in zip(a, b, strict=True):
        total += x * y
    return total


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _rotate(rows: Matrix, point: Sequence[float]) -> Vector:
    return _vector((_dot(rows[0], point), _dot(rows[1], point), _dot(rows[2], point)))


def _minus(a: Sequence[float], b: Sequence[float]) -> Vector:
    return _vector((a[0] - b[0], a[1] - b[1], a[2] - b[2]))


def _sum(vectors: Sequence[Sequence[float]], factor: float = 1.0) -> Vector:
    total = [0.0, 0.0, 0.0]
    for vector in vectors:
        for k in range(3):
            total[k] += vector[k]
    return _vector((factor * total[0], factor * total[1], factor * total[2]))


def _median(points: Sequence[Vector]) -> Vector:
    by_axis = zip(*points, strict=True)
    return _vector(sorted(values)[len(values) // 2] for values in by_axis)


def _unit(a: Vector) -> Vector:
    return _sum([a], 1 / (math.hypot(*a) or 1.0))


def _vector(values: Iterable[float]) -> Vector:
    # whole numbers of a file become floats, so that every vector is written alike
    x, y, z = map(float, values)
    return x, y, z

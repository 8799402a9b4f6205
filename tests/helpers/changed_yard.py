"""Nights of a yard of boxes on flat ground: images, depth maps and clouds are computed, so that every change is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tests.helpers.flat_ground import camera_at
from wbflow_stages.core.cameras import backproject, rays, scaled_intrinsics
from wbflow_stages.types import Camera, Cloud, DepthMap, Float64s, Frame, Poses, View

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Two opposite corners of a box, metres."""

WALL: Box = ((-6.0, 5.0, 0.0), (6.0, 5.4, 3.0))
CRATE: Box = ((-1.0, -0.8, 0.0), (1.0, 0.8, 1.2))
SIGMA = 0.01
SCALE = 0.75
"""Size of the images relative to those of `flat_ground`."""
FARTHEST = 16.0
"""Largest distance that has a depth, metres."""


@dataclass(frozen=True)
class BoxNight:
    """The results of one night that `find_changes` takes."""

    cameras: dict[str, Camera]
    frames: dict[str, Frame]
    depths: dict[str, DepthMap]
    cloud: Cloud

    @property
    def poses(self) -> Poses:
        """The cameras as poses."""
        return Poses(self.cameras, metric=True, source="calibration")

    def arguments(self, prefix: str = "") -> dict[str, Any]:
        """The night as arguments of `find_changes`; prefix: "reference_" for the reference's."""
        found = {"poses": self.poses, "cloud": self.cloud, "frames": self.frames, "depths": self.depths, "refined": {}}
        return {prefix + name: value for name, value in found.items()}


FRONT_DEG = (-50.0, -50.0 / 3, 50.0 / 3, 50.0)
"""Directions of the cameras around the yard, counter-clockwise from south."""


def cameras(turns_deg: Sequence[float] = FRONT_DEG) -> dict[str, Camera]:
    """Cameras on an arc around the yard, 7 m high."""
    turns = np.radians(turns_deg)
    places = [(10 * float(np.sin(a)), -10 * float(np.cos(a)), 7.0) for a in turns]
    return {f"c{k}": _smaller(camera_at(place, (0.0, 0.5, 0.3))) for k, place in enumerate(places)}


def _smaller(camera: Camera) -> Camera:
    width, height = round(camera.width * SCALE), round(camera.height * SCALE)
    return replace(camera, K=scaled_intrinsics(camera.K, SCALE, SCALE), width=width, height=height)


def box_night(
    boxes: Sequence[Box],
    *,
    seed: int = 0,
    noise: float = SIGMA,
    brightness: float = 1.0,
    blind: Sequence[str] = (),
    turns_deg: Sequence[float] = FRONT_DEG,
) -> BoxNight:
    """A night of the yard: its ground, its wall, and boxes.

    Parameters
    ----------
    boxes
        The boxes besides the wall.
    seed, noise
        Seed of all noise, and standard deviation of the depth errors, metres.
    brightness
        Factor on the grey values of the images.
    blind
        Cameras that have no depth.
    turns_deg
        Directions of the cameras around the yard, counter-clockwise from south.
    """
    rng = np.random.default_rng(seed)
    views = cameras(turns_deg)
    frames, depths, parts = {}, {}, []
    for name, camera in views.items():
        X, normals, which = _hit(camera, [WALL, *boxes])
        grey = np.clip(_paint(X + which[:, None]) * brightness + rng.normal(0, 1.5, len(X)), 0, 255).reshape(
            camera.height, camera.width
        )
        image = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
        frames[name] = Frame(image, np.ones(grey.shape, bool), View(camera.width, camera.height, camera.K))
        if name in blind:
            continue
        away = rng.normal(0, noise, len(X))
        z = ((X - camera.C) @ camera.R[2] + away).astype(np.float32)
        known = np.isfinite(z)
        shape = camera.height, camera.width
        plane = np.zeros(shape, np.float32)
        sigma = np.full(shape, SIGMA, np.float32)
        depths[name] = DepthMap(z.reshape(shape), sigma, plane, plane, np.ones(shape, np.uint32), (), known.reshape(shape))
        y, x = np.divmod(np.flatnonzero(known), camera.width)
        points = backproject(camera, np.column_stack([x, y]).astype(np.float64), z[known].astype(np.float64))
        parts.append((points, normals[known], image.reshape(-1, 3)[known]))
    points, normals, colors = (np.concatenate(each) for each in zip(*parts, strict=True))
    n = len(points)
    sigma_mm = np.full(n, 1000 * SIGMA, np.float32)
    cloud = Cloud(points, normals.astype(np.float32), colors, np.ones(n, np.float32), np.full(n, 2, np.uint16), sigma_mm)
    return BoxNight(views, frames, depths, cloud)


def _hit(camera: Camera, boxes: Sequence[Box]) -> tuple[Float64s, Float64s, Float64s]:
    """First surface points (n, 3) along the pixels' rays, nan beyond FARTHEST; their normals; a number (n,) per object."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1).astype(np.float64)
    d = rays(camera, np.column_stack([x, y])).T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(d[:, 2] < 0, -camera.C[2] / d[:, 2], np.inf)
        normals, which = np.tile([0.0, 0.0, 1.0], (len(d), 1)), np.zeros(len(d))
        for low, high in boxes:
            one, two = (np.array(low) - camera.C) / d, (np.array(high) - camera.C) / d
            enter, leave = np.minimum(one, two), np.maximum(one, two).min(axis=1)
            axis, at = enter.argmax(axis=1), enter.max(axis=1)
            hit = (at <= leave) & (at > 0) & (at < t)
            t = np.where(hit, at, t)
            which[hit] = sum(low) + sum(high)
            normals[hit] = -np.sign(d[hit, axis[hit]])[:, None] * np.eye(3)[axis[hit]]
    X = camera.C + d * np.where(t < FARTHEST, t, np.nan)[:, None]
    return X, normals, which


def _paint(X: Float64s) -> Float64s:
    """Grey values (n,) of surface points: waves of several lengths, fixed in space; the sky is white."""
    waves = [np.sin(X @ np.array(k) + p) for k, p in (((9, 5, 11), 0), ((-13, 8, 5), 1), ((4, -17, 9), 2), ((21, 19, -16), 3))]
    return np.asarray(np.nan_to_num(128 + 28 * np.sum(waves, axis=0), nan=250.0), dtype=np.float64)

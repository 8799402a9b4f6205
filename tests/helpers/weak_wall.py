"""A wall with little texture, windows and any relief, seen by cameras on an arc, and its exact depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wbflow_stages.core.cameras import backproject, project
from wbflow_stages.types import Camera, DepthMap, Float64s, Frame, View

WIDTH, HEIGHT, AWAY = 320, 180, 12.0
"""Image width and height in pixels, and radius of the cameras' arc in metres."""

Relief = Callable[[Float64s, Float64s], Float64s]
"""Function of x and z that gives how far the wall is behind y = 0, metres."""


@dataclass(frozen=True)
class Wall:
    """The inputs of `refine` for the middle one of five cameras."""

    frames: dict[str, Frame]
    cameras: dict[str, Camera]
    name: str
    truth: Float64s
    """Depth map (h, w) of the middle camera."""

    def start(self, noise: float = 0.01) -> DepthMap:
        """The true depth with relative noise, like a depth map from pairs."""
        z = (self.truth * (1 + noise * np.random.default_rng(3).normal(size=self.truth.shape))).astype(np.float32)
        flat, sources = np.zeros_like(z), np.ones(z.shape, np.uint32)
        return DepthMap(z, np.float32(noise) * z, flat, flat, sources, (next(iter(self.cameras)),), np.ones(z.shape, bool))


def make_wall(relief: Relief) -> Wall:
    """Make a wall with paint of 1 % contrast, half a grey level of noise, and a window every four metres."""
    rng, frames, cameras, truth = np.random.default_rng(0), {}, {}, np.zeros((0, 0))
    for degrees in (-24, -12, 12, 24, 0):
        a, name = np.radians(degrees), f"cam{degrees:+d}"
        cameras[name] = camera = _looking(np.array([AWAY * np.sin(a), -AWAY * np.cos(a), 3.0]))
        X = _hit(camera, relief)
        window = (np.abs((X[:, 0] + 50) % 4 - 2) < 0.5) & (np.abs((X[:, 2] + 50) % 3 - 1.5) < 0.6)
        grey = np.where(window, 60 + 36 * _pattern(X, 9), 200 + 2 * _pattern(X, 7))
        image = np.round(grey[:, None] + rng.normal(0, 0.5, (len(X), 3))).clip(0, 255).astype(np.uint8)
        frames[name] = Frame(image.reshape(HEIGHT, WIDTH, 3), np.ones((HEIGHT, WIDTH), bool), View(WIDTH, HEIGHT, camera.K))
        truth = project(camera, X)[1].reshape(HEIGHT, WIDTH)
    return Wall(frames, cameras, "cam+0", truth)


def _looking(position: Float64s) -> Camera:
    forward = np.array([0.0, 0.0, 2.5]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    f = 1.1 * WIDTH
    K = np.array([[f, 0, (WIDTH - 1) / 2], [0, f, (HEIGHT - 1) / 2], [0, 0, 1]])
    return Camera(K, np.stack([right, np.cross(forward, right), forward]), position, WIDTH, HEIGHT)


def _hit(camera: Camera, relief: Relief) -> Float64s:
    """Points (n, 3) where the pixels' rays first meet the wall, which has to lie between y = -1.5 and 1.5."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].reshape(2, -1).astype(np.float64)
    ray = backproject(camera, np.column_stack([x, y]), np.ones(len(x))) - camera.C
    near, far = ((side - camera.C[1]) / ray[:, 1] for side in (-1.5, 1.5))

    def behind(t: Float64s) -> Float64s:
        X = camera.C + ray * t[:, None]
        return np.asarray(X[:, 1] - relief(X[:, 0], X[:, 2]))

    before, after = near.copy(), far.copy()
    for share in np.linspace(1, 0, 60):  # from far to near: ends with the nearest step behind the wall
        t = near + (far - near) * share
        after = np.where(behind(t) >= 0, t, after)
    before = after - (far - near) / 59
    for _ in range(20):
        t = (before + after) / 2
        before, after = np.where(behind(t) < 0, t, before), np.where(behind(t) < 0, after, t)
    return np.asarray(camera.C + ray * after[:, None])


def _pattern(X: Float64s, seed: int) -> Float64s:
    """Pattern (n,) of unit variance: waves of 6 cm to 2 m in all directions."""
    rng, total = np.random.default_rng(seed), np.zeros(len(X))
    for _ in range(40):
        direction = rng.normal(size=3)
        wave = np.exp(rng.uniform(np.log(0.06), np.log(2.0))) * np.linalg.norm(direction)
        total += np.sin(2 * np.pi * X @ direction / wave + rng.uniform(0, 2 * np.pi))
    return np.asarray(total / np.sqrt(20))

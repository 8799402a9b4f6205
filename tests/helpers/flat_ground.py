"""Cameras above flat ground of random texture, so that images, depths and poses are known exactly."""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_stages.core.cameras import rays
from wbflow_stages.types import Camera, Float32s, Float64s, Frame, View

SIZE = (320, 240)
TEXEL_M = 0.03
TEXTURE = 900
"""Number of texels along each side of the ground."""


def camera_at(C: tuple[float, float, float], target: tuple[float, float, float]) -> Camera:
    """An upright camera at C that looks at a target."""
    forward = np.subtract(target, C) / np.linalg.norm(np.subtract(target, C))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[260.0, 0.0, (SIZE[0] - 1) / 2], [0.0, 260.0, (SIZE[1] - 1) / 2], [0.0, 0.0, 1.0]])
    return Camera(K, R, np.array(C), *SIZE)


def cameras(count: int = 3) -> dict[str, Camera]:
    """Cameras 6 m above the ground, around its centre in steps of 25 degrees."""
    turns = np.radians(25.0 * np.arange(count))
    return {f"c{k}": camera_at((9 * float(np.sin(a)), -9 * float(np.cos(a)), 6.0), (0.0, 0.0, 0.0)) for k, a in enumerate(turns)}


def texture(seed: int = 0) -> Float32s:
    """Grey texture (TEXTURE, TEXTURE), float32, with detail at several scales."""
    rng = np.random.default_rng(seed)
    layers = [cv2.GaussianBlur(rng.normal(size=(TEXTURE, TEXTURE)).astype(np.float32), (0, 0), s) * s for s in (1.5, 4.0, 10.0)]
    noise = np.sum(layers, axis=0)
    return np.asarray(np.clip(128 + 45 * noise / noise.std(), 1, 254), dtype=np.float32)


def frame_of(camera: Camera, ground: Float32s, height: float = 0.0) -> Frame:
    """The frame of a camera above level ground at z = `height`."""
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    direction = rays(camera, pixels).T
    X: Float64s = camera.C + direction * ((height - camera.C[2]) / direction[:, 2])[:, None]
    u = (X[:, :2] / TEXEL_M + TEXTURE / 2).astype(np.float32).reshape(camera.height, camera.width, 2)
    grey = cv2.remap(ground, u[..., 0], u[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    image = np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=2)
    return Frame(image, np.ones(image.shape[:2], dtype=np.bool_), View(camera.width, camera.height, camera.K))

"""What lies between a camera and the scene."""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_stages.types import Float32s

from .light import Light

VEIL = 0.12
"""Share of the light that falling water replaces by that of the sky."""
STREAKS = 0.0016
"""For each pixel."""


def rain_over(radiance: Float32s, light: Light, rng: np.random.Generator) -> Float32s:
    """A picture (h, w, 3) of linear radiance through rain: a veil, and streaks that are elsewhere in every frame."""
    height, width = radiance.shape[:2]
    scale = width / 640
    streaks = np.zeros((height, width), np.uint8)
    slant = rng.normal(0.18, 0.03)
    for _ in range(round(STREAKS * height * width / max(scale, 0.5))):
        x, y = rng.uniform(0, width), rng.uniform(-0.05 * height, height)
        long = rng.uniform(8, 34) * scale
        end = (round(x + slant * long), round(y + long))
        cv2.line(streaks, (round(x), round(y)), end, int(rng.integers(35, 130)), max(round(scale), 1), cv2.LINE_AA)
    cover = np.float32(VEIL) + cv2.GaussianBlur(streaks, (0, 0), 0.6 * max(scale, 0.7)).astype(np.float32)[..., None] / 255
    grey = np.asarray(light.haze, np.float32) * np.float32(0.8)
    return np.asarray(radiance * (1 - cover) + grey * cover, np.float32)

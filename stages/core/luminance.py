"""Levels of pictures: grey ones of coloured ones, rounded as detectors take them or not, and another exposure."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import Float32s, Float64s, Uint8s


def grey_levels(image: Uint8s) -> Uint8s:
    """(h, w) grey levels of (h, w, 3) RGB, rounded: OpenCV's weights, those of ITU-R BT.601."""
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def luminance(image: Uint8s) -> Float32s:
    """(h, w) float32 of (h, w, 3) RGB, the same weights, never rounded: weak texture lives below one grey level."""
    return np.asarray(cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2GRAY), dtype=np.float32)


def with_gain(image: Uint8s, gains: Float64s) -> Uint8s:
    """(h, w, 3) uint8 of an image, its channels times (3,) gains."""
    table = np.clip(np.arange(256)[:, None] * gains[None, :] + 0.5, 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(image, table.reshape(256, 1, 3)), dtype=np.uint8)

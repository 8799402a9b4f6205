"""A rectified pair of random texture with exactly known disparity: a slanted floor and a disc in front of it."""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_stages.types import Frame, Rectification, View


def texture(height: int, width: int, seed: int = 0) -> np.ndarray:
    """Random texture (h, w), float32, grey values 30 to 220, with detail at several scales."""
    rng = np.random.default_rng(seed)
    image = np.zeros((height, width))
    for sigma, weight in ((0.8, 1.0), (2.0, 2.0), (6.0, 4.0)):
        layer = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), sigma)
        image += weight * layer / layer.std()
    low, high = np.percentile(image, [1, 99])
    return np.asarray(np.clip(30 + 190 * (image - low) / (high - low), 30, 220), np.float32)


def true_disparity(height: int, width: int, offset: float = 20.0, slope: float = 0.04) -> np.ndarray:
    """Disparity (h, w) of the left view: offset + slope x + 0.5 slope y on the floor, 12 px more on a disc."""
    y, x = np.mgrid[0:height, 0:width]
    floor = offset + slope * x + 0.5 * slope * y
    disc = np.hypot(x - 0.6 * width, y - 0.5 * height) < 0.15 * height
    return np.asarray(np.where(disc, floor + 12, floor))


def stereo_pair(height: int = 180, width: int = 240, offset: float = 20.0, slope: float = 0.04) -> tuple[np.ndarray, np.ndarray]:
    """Left and right grey image, float32; the left one is resampled from the right one, so its disparity is exact."""
    disparity = true_disparity(height, width, offset, slope)
    right = texture(height, width)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    source = (x - disparity).astype(np.float32)
    left = cv2.remap(right, source, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return left, right


def frame_of(grey: np.ndarray, mask: np.ndarray | None = None) -> Frame:
    image = np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
    height, width = grey.shape
    return Frame(image, np.ones((height, width), dtype=bool) if mask is None else mask, View(width, height))


def as_they_are(left: np.ndarray, right: np.ndarray, low: float, high: float) -> Rectification:
    """The rectification of images that are rectified already."""
    sizes = (left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])
    return Rectification("hartley", "rectified already", np.eye(3), np.eye(3), *sizes, low, high, 0.0, 0.0, float("nan"))

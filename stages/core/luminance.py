"""Grey levels of images, rounded (for detectors) or not, channel gains, block means, and pixel noise."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import Bools, Float32s, Float64s, Uint8s


def grey_levels(image: Uint8s) -> Uint8s:
    """(h, w) grey levels of (h, w, 3) RGB, rounded, with OpenCV's weights (ITU-R BT.601)."""
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def luminance(image: Uint8s) -> Float32s:
    """(h, w) float32 grey levels of (h, w, 3) RGB with the same weights, not rounded: weak texture spans less than one level."""
    return np.asarray(cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2GRAY), dtype=np.float32)


def with_gain(image: Uint8s, gains: Float64s) -> Uint8s:
    """(h, w, 3) uint8 image with its channels multiplied by (3,) gains."""
    # + 0.5: rounded, not cut
    table = np.clip(np.arange(256)[:, None] * gains[None, :] + 0.5, 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(image, table.reshape(256, 1, 3)), dtype=np.uint8)


def block_means(values: Float32s, side: int) -> Float32s:
    """(h // side, w // side) means over square blocks of values (h, w); incomplete blocks at the borders are left out."""
    rows = values.shape[0] // side
    columns = values.shape[1] // side
    # (rows, side, columns, side): axes 1 and 3 run within a block
    blocks = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)


_BLOCK = 16
"""Side of the blocks of which noise is measured, pixels.  Larger ones vary less, but fewer are free of texture."""
_QUIETEST_PERCENT = 10
"""Percentile of the blocks' responses that counts as noise: blocks above it may have texture."""


def noise_level(image: Float32s, valid: Bools) -> float:
    """Standard deviation of the pixel noise, in grey levels, of a grey image (h, w), from its quietest blocks.

    The filter does not respond to intensities that vary linearly.  References: Immerkaer, CVIU 1996.
    """
    # difference of two Laplacians; for noise of standard deviation s the response's is 6 s, and its mean size sqrt(2 / pi) 6 s
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    response = np.abs(cv2.filter2D(image, -1, kernel))
    valid_blocks = block_means(valid.astype(np.float32), _BLOCK) > 0.999  # all pixels, up to rounding
    if not valid_blocks.any():
        return 0.0
    mean = block_means(np.asarray(response, dtype=np.float32), _BLOCK)[valid_blocks]
    return float(np.sqrt(np.pi / 2) / 6 * np.percentile(mean, _QUIETEST_PERCENT))

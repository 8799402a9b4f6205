"""How noisy a picture is."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import Bools, Float32s

_BLOCK = 16
_QUIETEST_PERCENT = 10


def noise_level(image: Float32s, valid: Bools) -> float:
    """Standard deviation of the pixel noise, in grey levels, of a grey image (h, w), from its quietest blocks.

    The mask is blind to anything that changes linearly.  References: Immerkaer, CVIU 1996.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    response = np.abs(cv2.filter2D(image, -1, mask))
    rows, columns = image.shape[0] // _BLOCK, image.shape[1] // _BLOCK

    def blocks(a: Float32s) -> Float32s:
        whole = a[: rows * _BLOCK, : columns * _BLOCK]
        return np.asarray(whole.reshape(rows, _BLOCK, columns, _BLOCK).mean(axis=(1, 3)), dtype=np.float32)

    whole = blocks(valid.astype(np.float32)) > 0.999
    if not whole.any():
        return 0.0
    mean = blocks(np.asarray(response, dtype=np.float32))[whole]
    return float(np.sqrt(np.pi / 2) / 6 * np.percentile(mean, _QUIETEST_PERCENT))

"""What is done about a noisy picture before it is matched."""

from __future__ import annotations

import cv2
import numpy as np

from ..core.noise import noise_level
from ..types import Bools, Float32s

NOISY = 3.0
"""Grey levels of noise (standard deviation) from which a picture is smoothed before it is matched: lamp light, high gain.  Fine
texture everywhere reads as 2."""


def quietened(image: Float32s, valid: Bools) -> Float32s:
    """The image, smoothed by a Gaussian of 1 px where it is noisy."""
    if noise_level(image, valid) < NOISY:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.float32)

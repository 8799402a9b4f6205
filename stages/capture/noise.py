"""Noise of a night without lamps, taken off a frame before anything is made of it.

It is measured where it is white, in the captures as they come from the camera: undistorting a picture mixes neighbouring pixels,
after which noise of eleven grey levels reads as two.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..core.noise import noise_level
from ..types import Float32s, Uint8s

NOISY = 2.0
"""Grey levels of noise (standard deviation) of a frame from which on it is denoised."""
_DARKEST, _BRIGHTEST = 12.0, 243.0
"""Mean grey of the surroundings that can tell of noise: what is clipped has none."""
_SURROUNDINGS_PX = 16
_MIXED = 0.67
"""What bilinear interpolation leaves of white noise: 2/3 of its standard deviation, mean over all fractions."""
_PATCH_PX, _SEARCH_PX = 7, 21
_COLOUR_PX = 2.0
"""Colours are smoothed by a Gaussian of so many pixels: they tell little of shape, and their noise is coarse."""


def capture_noise(grey: Float32s) -> float:
    """Standard deviation of the noise of a capture (h, w) as it comes from the camera, grey levels."""
    mean = cv2.blur(grey, (_SURROUNDINGS_PX, _SURROUNDINGS_PX))
    return noise_level(grey, np.asarray((mean > _DARKEST) & (mean < _BRIGHTEST), np.bool_))


def remaining_noise(noise: float, captures: int, scale: float) -> float:
    """What the frame has of its captures' noise.

    Parameters
    ----------
    noise : float
        Of one capture, grey levels.
    captures : int
        So many are merged by their median, whose standard deviation is sqrt(pi / (2 n + pi - 2)) of one's (David and Nagaraja,
        Order Statistics, 2003; within 1 % from three on).  Of two, one is used.
    scale : float
        Side of the frame's pixels over the capture's, at most 1: reducing averages.
    """
    merged = 1.0 if captures < 3 else float(np.sqrt(np.pi / (2 * captures + np.pi - 2)))
    return noise * _MIXED * merged * min(scale, 1.0)


def denoised(image: Uint8s, noise: float) -> Uint8s:
    """A frame (h, w, 3) without most of its noise (grey levels): non-local means (Buades, Coll and Morel, CVPR 2005).

    Edges and texture that is seen again nearby stay, which a Gaussian wears down: on the yard without lamps (four cameras)
    F at 2 cm is 35.5 with it, 34.7 with a Gaussian of 1 px, 32.8 with neither.
    """
    luma, red, blue = cv2.split(cv2.cvtColor(image, cv2.COLOR_RGB2YCrCb))
    luma = cv2.fastNlMeansDenoising(luma, None, h=noise, templateWindowSize=_PATCH_PX, searchWindowSize=_SEARCH_PX)
    red, blue = (cv2.GaussianBlur(colour, (0, 0), _COLOUR_PX) for colour in (red, blue))
    return np.asarray(cv2.cvtColor(cv2.merge([luma, red, blue]), cv2.COLOR_YCrCb2RGB), np.uint8)

"""Regions that show nothing but shading (sky, an even wall): depths come from their borders, and reach into them from there.

Of a wall or a lawn nearly all gets a depth; of the sky a band beside whatever stands before it, which is wrong.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..core.luminance import grey_levels
from ..types import Bools, DepthMap, Frame
from .surface_support import surroundings_px

_EVEN = 1.0
"""Grey levels that pixels differ by from the mean of 3 x 3 (root mean square), besides a quarter of the noise that is left in a
picture: less shows nothing, or shading."""
_FILLED = 0.5
"""Of a region: so much of a surface gets a depth from pairs.  Of skies above houses, a car park and a stadium 0 to 0.25 do, of
nearly all walls and lawns there 0.54 to 1, of cars and roads that show nothing 0 to 0.02."""


def believed(frame: Frame, depth: DepthMap) -> Bools:
    """(h, w) pixels of a frame's mask whose depths may be used: all but large even regions of which too little has one.

    Small ones lie within what `surface_support` asks anyway.  depth: of the view, from its pairs, where there is one.
    """
    grey = grey_levels(frame.image).astype(np.float32)
    detail = cv2.blur(np.square(grey - cv2.blur(grey, (3, 3))), (3, 3))
    even = (detail < (_EVEN + 0.25 * frame.noise_left) ** 2) & frame.mask
    count, region = cv2.connectedComponents(even.astype(np.uint8), connectivity=4)
    pixels = np.bincount(region.ravel())
    filled = np.bincount(region.ravel(), np.isfinite(depth.depth).ravel(), count)
    known = (filled >= _FILLED * pixels) | (pixels < surroundings_px(frame.mask.shape))
    known[0] = True  # what is not even
    return np.asarray(frame.mask & known[region], np.bool_)

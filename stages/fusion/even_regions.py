"""Regions that show nothing (sky, an even wall): their depths come from their borders alone, and reach into them from there.

Of a wall or a lawn nearly all gets a depth that is sure; of the sky a band beside whatever stands before it, which is wrong.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..core.luminance import grey_levels
from ..types import Bools, DepthMap, Frame
from .surface_support import surroundings_px

_EVEN = 1.0
"""Grey levels of standard deviation in 3 x 3 pixels: less shows nothing.  Noise counts, or a night would be even."""
_SURE = 1 / 3
"""Of a region: so much of a surface gets a sure depth.  Of the sky above a building site, a car park and a stadium 0 to 0.14 did,
of walls and lawns there and in a study 0.48 to 1."""


def believed(frame: Frame, depth: DepthMap) -> Bools:
    """(h, w) pixels of a frame's mask whose depths may be used: all but large even regions of which too little has a sure one.

    Small ones lie within what `surface_support` asks anyway.
    """
    grey = grey_levels(frame.image).astype(np.float32)
    mean, square = cv2.blur(grey, (3, 3)), cv2.blur(grey * grey, (3, 3))
    even = (square - mean * mean < _EVEN**2) & frame.mask
    count, region = cv2.connectedComponents(even.astype(np.uint8), connectivity=4)
    pixels = np.bincount(region.ravel())
    sure = np.bincount(region.ravel(), (depth.sure & np.isfinite(depth.depth)).ravel(), count)
    known = (sure >= _SURE * pixels) | (pixels < surroundings_px(frame.mask.shape))
    known[0] = True  # what is not even
    return np.asarray(frame.mask & known[region], np.bool_)

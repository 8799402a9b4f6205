"""Regions with nothing but shading (sky, an even wall): their depths come from their borders and extend inwards from there.

On a wall or a lawn, nearly all pixels get a depth.  In the sky, only a band along foreground objects does, and it is wrong.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..core.luminance import grey_levels
from ..types import Bools, DepthMap, Frame
from .surface_support import surroundings_px

_MOST_DETAIL = 1.0
"""A pixel is even if its grey levels differ from the mean of 3 x 3 pixels (root mean square) by less than this plus a quarter of
the noise left in the frame: it shows nothing, or only shading."""

_LEAST_FILLED = 0.5
"""Smallest share of a large even region that must have a depth from pairs for its depths to be used.  Measured: skies above
houses, a car park and a stadium reach 0 to 0.25, nearly all walls and lawns there 0.54 to 1, cars and roads without texture 0 to
0.02."""


def usable_pixels(frame: Frame, depth: DepthMap) -> Bools:
    """(h, w) pixels of a frame's mask whose depths may be used: all but large even regions in which too few pixels have one.

    Even regions smaller than the neighbourhood of `surface_support` are kept.  depth: the view's, from its pairs if any.
    """
    grey = grey_levels(frame.image).astype(np.float32)
    detail = cv2.blur(np.square(grey - cv2.blur(grey, (3, 3))), (3, 3))
    # the noise that is left adds to the detail
    even = (detail < (_MOST_DETAIL + 0.25 * (frame.noise_left or 0.0)) ** 2) & frame.mask
    region_count, region = cv2.connectedComponents(even.astype(np.uint8), connectivity=4)
    pixels = np.bincount(region.ravel())
    filled = np.bincount(region.ravel(), np.isfinite(depth.depth).ravel(), region_count)
    usable = (filled >= _LEAST_FILLED * pixels) | (pixels < surroundings_px(frame.mask.shape))
    usable[0] = True  # label 0: pixels that are not even
    return np.asarray(frame.mask & usable[region], np.bool_)

"""Privacy areas: polygons whose pixels are erased before anything else reads an image."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from ..types import Bools, Float64s, Privacy, Uint8s
from .files import BadCapture

GREY = 128
"""Grey level that replaces private pixels."""
_MARGIN_PX = 3
"""Width in pixels of the margin around a polygon that is not used: the edge of a grey area is not a feature of the site."""


def private_area(privacy: Privacy | None, width: int, height: int, name: str) -> Bools | None:
    """(height, width) bool, True for private pixels; None if there are no polygons.

    Raises BadCapture if a polygon does not fit an image of this size: a capture is lost rather than private pixels shown.

    Parameters
    ----------
    privacy : the polygons.
    width, height : size of the capture, pixels.
    name : of the capture, for messages.
    """
    if privacy is None or not len(privacy.counts):
        return None
    area = np.zeros((height, width), np.uint8)
    for corners in _polygons(privacy, width, height):
        low = corners.min(axis=0)
        high = corners.max(axis=0)
        if high[0] > width or high[1] > height or (low < -0.5).any():
            raise BadCapture(
                f"{name} has {width} x {height} pixels, and a privacy polygon reaches to ({high[0]:.0f}, {high[1]:.0f}): "
                "draw it over a capture as it comes from the camera, or give shares of width and height"
            )
        outline = [np.rint(corners).astype(np.int32)]
        cv2.fillPoly(area, outline, 1)
        cv2.polylines(area, outline, True, 1, 2)  # the border as well: corners lie between pixels
    return np.asarray(area, np.bool_)


def blanked(image: Uint8s, area: Bools | None) -> Uint8s:
    """The image with its private pixels replaced by grey."""
    if area is None:
        return image
    out = image.copy()
    out[area] = GREY
    return out


def with_margin(area: Bools) -> Bools:
    """The area with a margin around it."""
    kernel = np.ones((2 * _MARGIN_PX + 1, 2 * _MARGIN_PX + 1), np.uint8)
    return np.asarray(cv2.dilate(area.astype(np.uint8), kernel), np.bool_)


def _polygons(privacy: Privacy, width: int, height: int) -> Iterator[Float64s]:
    """Corners (n, 2) of each polygon in pixels; corners that all lie within 0 to 1 are shares of width and height."""
    for corners in np.split(privacy.corners, np.cumsum(privacy.counts.astype(int)))[:-1]:
        if (corners >= 0).all() and (corners <= 1).all():
            yield corners * (width, height) - 0.5  # the centre of the first pixel is 0, its corner -0.5
        else:
            yield corners

"""What nobody may see: polygons whose pixels are gone before anything else looks at a picture."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from ..types import Bools, Float64s, Privacy, Uint8s
from .files import BadCapture

GREY = 128
"""What is there instead."""
_MARGIN = 3
"""Pixels around a polygon that are not used: the edge of a grey area is no feature of the site."""


def private_area(privacy: Privacy | None, width: int, height: int, name: str) -> Bools | None:
    """(height, width) bool, True where nobody may see anything; None where everything may be seen.

    Raises BadCapture where a polygon does not fit a picture of this size: rather none of it is used than what should not be seen.

    Parameters
    ----------
    privacy : the polygons.
    width, height : of a capture, pixels.
    name : of the capture, for messages.
    """
    if privacy is None or not len(privacy.counts):
        return None
    area = np.zeros((height, width), np.uint8)
    for corners in _polygons(privacy, width, height):
        low, high = corners.min(axis=0), corners.max(axis=0)
        if high[0] > width or high[1] > height or (low < -0.5).any():
            raise BadCapture(
                f"{name} has {width} x {height} pixels, and a privacy polygon reaches to ({high[0]:.0f}, {high[1]:.0f}): "
                "draw it over a capture as it comes from the camera, or give shares of width and height"
            )
        outline = [np.rint(corners).astype(np.int32)]
        cv2.fillPoly(area, outline, 1)
        cv2.polylines(area, outline, True, 1, 2)
    return np.asarray(area, np.bool_)


def blanked(image: Uint8s, area: Bools | None) -> Uint8s:
    """The picture without what lies in an area."""
    if area is None:
        return image
    out = image.copy()
    out[area] = GREY
    return out


def around(area: Bools) -> Bools:
    """The area and a margin."""
    kernel = np.ones((2 * _MARGIN + 1, 2 * _MARGIN + 1), np.uint8)
    return np.asarray(cv2.dilate(area.astype(np.uint8), kernel), np.bool_)


def _polygons(privacy: Privacy, width: int, height: int) -> Iterator[Float64s]:
    """The corners (n, 2) of each, pixels; they may be stated as shares of width and height."""
    for corners in np.split(privacy.corners, np.cumsum(privacy.counts.astype(int)))[:-1]:
        shares = bool((corners >= 0).all() and (corners <= 1).all())
        yield corners * (width, height) - 0.5 if shares else corners

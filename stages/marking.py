"""Captures and masks for a page on which an operator draws: pictures to draw on, and masks made from the drawing."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from .capture.files import BadCapture, decoded_mask, wrong_size
from .capture.video import one_picture
from .io.rasters import jpeg, png
from .types import Capture, Lens, Uint8s

LARGE = 2560
"""Long side in pixels of a picture to draw on."""

_JPEG_QUALITY = 88
"""Quality of that picture, 0 to 100: artefacts are invisible at the size of a page."""

_SHADE_RGBA = (230, 60, 60, 130)
"""Colour over what a mask leaves out: red, green, blue, opacity."""

Area = tuple[bool, list[list[float]]]
"""A polygon to paint: whether its pixels may be used, and its corners in pixels of a capture (pixel centres are integers)."""


def as_jpeg(name: str, data: bytes) -> tuple[int, int, bytes]:
    """Width and height of a capture (upright, as for masks and polygons), and a JPEG of it that browsers show.

    Raises BadCapture, naming the file, if it is not a usable picture.
    """
    image = one_picture(Capture(name, np.frombuffer(data, np.uint8)))
    height, width = image.shape[:2]
    return width, height, jpeg(_reduced(image), _JPEG_QUALITY).tobytes()


def mask_overlay(name: str, mask: bytes) -> bytes:
    """A PNG that is red where a mask leaves pixels out, and transparent elsewhere.  Raises BadCapture."""
    small = _reduced(_decode(name, mask))
    overlay = np.zeros((*small.shape[:2], 4), np.uint8)
    overlay[small == 0] = _SHADE_RGBA
    return png(overlay)


def paint_mask(name: str, mask: bytes | None, size: tuple[int, int], areas: Sequence[Area]) -> bytes:
    """A mask, as a PNG, with areas painted over it, one after the other.

    Raises BadCapture if the mask cannot be read, has another size, or would leave no pixel to use.

    Parameters
    ----------
    name, mask : the mask's name for messages, and an image file of the captures' size; None: all pixels may be used.
    size : (width, height) of captures.
    areas : the areas to paint, in order.
    """
    width, height = size
    if mask is None:
        image = np.full((height, width), 255, np.uint8)
    else:
        image = _decode(name, mask).copy()  # decoded pixels are read-only
    if image.shape != (height, width):
        raise wrong_size(name, image.shape[1], image.shape[0], Lens(width=width, height=height))
    for use, corners in areas:
        whole_pixels = np.rint(np.array(corners)).astype(np.int32)
        cv2.fillPoly(image, [whole_pixels], 255 if use else 0)
    if not image.any():
        raise BadCapture(f"{name} would leave no pixel to use")
    return png(image)


def _decode(name: str, mask: bytes) -> Uint8s:
    return decoded_mask(f"mask {name}", np.frombuffer(mask, np.uint8))


def _reduced(image: Uint8s) -> Uint8s:
    """A picture (h, w, 3) or mask (h, w), reduced to a long side of at most `LARGE`."""
    height, width = image.shape[:2]
    scale = LARGE / max(height, width)
    if scale >= 1:
        return image
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    # a mask must not get grey levels between used and unused
    interpolation = cv2.INTER_AREA if image.ndim == 3 else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), np.uint8)

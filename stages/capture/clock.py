"""Detects a running clock burned into the image: its digits change between captures, the strokes next to them do not.

If several cameras write such a line at the same place, matching finds their text instead of the scene.  `background` finds
overlays where the light of the scene changes; this module looks for changing digits, which also works in constant light.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..core.luminance import grey_levels
from ..types import Bools, Uint8s

_BAND = 0.15
"""Height of the bands at the top and at the bottom of the image in which a clock is searched for, as a share of its height."""
_HIGHEST = 0.08
"""Largest height of a line of text, as a share of the image height."""
_LONG = 8.0
"""Smallest ratio of a line's length to its height."""
_STROKE, _WHITE = 50.0, 170.0
"""Smallest grey-level contrast of a stroke with its surroundings, and smallest grey level of a stroke."""
_ROLLED, _STEADY = 60.0, 25.0
"""Range of grey levels over the captures: at least the first for a stroke of a digit, at most the second for one of a letter."""
_LEAST_ROLLED, _LEAST_STEADY, _LEAST_READ = 8, 0.25, 0.7
"""Smallest number of changing digit pixels, and smallest shares of a line's strokes that are steady, and that are either."""
_WRITTEN = 0.15
"""Smallest share of a changing digit's pixels that are strokes in every capture; a shadow or a person leaves none."""

Box = tuple[int, int, int, int]
"""x, y, width and height, pixels."""


def running_clock(images: Sequence[Uint8s], usable: Bools) -> Box | None:
    """Box of the text line whose digits change between images (h, w, 3) of one view, within the mask `usable` (h, w), or None."""
    height, width = usable.shape
    if len(images) < 2 or min(height, width) < 64:
        return None
    band = max(16, round(_BAND * height))
    for top in (0, height - band):
        rows = slice(top, top + band)
        found = _line([np.asarray(grey_levels(image[rows])) for image in images], usable[rows], _HIGHEST * height)
        if found is not None:
            x, y, w, h = found
            return x, top + y, w, h
    return None


def _line(grey: Sequence[Uint8s], usable: Bools, highest: float) -> Box | None:
    """The box of a running clock in a band of the images, or None."""
    side = max(5, round(0.6 * highest)) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    strokes = np.stack([(cv2.morphologyEx(one, cv2.MORPH_TOPHAT, kernel) > _STROKE) & (one > _WHITE) for one in grey])
    stack = np.stack(grey).astype(np.float32)
    spread = np.ptp(stack, axis=0)
    written = strokes.any(axis=0) & usable
    rolled, steady = written & (spread >= _ROLLED), written & strokes.all(axis=0) & (spread <= _STEADY)
    across = max(5, round(1.2 * side)) | 1
    lines = cv2.morphologyEx(written.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, across), np.uint8))
    _, _, boxes, _ = cv2.connectedComponentsWithStats(lines, connectivity=8)
    for x, y, w, h, _ in boxes[1:].tolist():
        box = slice(y, y + h), slice(x, x + w)
        count = int(written[box].sum())
        if h > highest or w < _LONG * h:
            continue
        digits, letters = _digits(strokes[:, box[0], box[1]] & rolled[box], h), int(steady[box].sum())
        if digits >= _LEAST_ROLLED and letters >= _LEAST_STEADY * count and digits + letters >= _LEAST_READ * count:
            return x, y, w, h
    return None


def _digits(strokes: Bools, height: int) -> int:
    """Number of pixels at which digits change into other digits, from a line's changing strokes (captures, height, w).

    Changes are judged in groups of columns that are separated by gaps, as digits are: a passer-by or a shadow that crosses a
    row of bright paving stones leaves none of them bright.
    """
    changing = np.flatnonzero(strokes.any(axis=(0, 1)))
    found = 0
    for columns in np.split(changing, np.flatnonzero(np.diff(changing) > max(1, height // 8)) + 1):
        each = strokes[:, :, columns].sum(axis=(1, 2))
        whole = int(strokes[:, :, columns].any(axis=0).sum())
        found += whole if each.min() >= _WRITTEN * whole else 0
    return found

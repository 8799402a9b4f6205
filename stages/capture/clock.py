"""Is a running clock burned into a picture?  Its digits change from capture to capture, and the strokes beside them do not.

Cameras that write such a line at the same place match each other's text instead of the scene.  Where the light of a night
changes, `background` finds overlays by that; this asks for the digits, which need no change of light.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..core.luminance import grey_levels
from ..types import Bools, Uint8s

_BAND = 0.15
"""Of the picture's height, at the top and at the bottom: where cameras write."""
_HIGHEST = 0.08
"""Of the picture's height: no line of text is higher."""
_LONG = 8.0
"""A line is so many times longer than high."""
_STROKE, _WHITE = 50.0, 170.0
"""Grey levels by which a stroke stands out, and that it has at least."""
_ROLLED, _STEADY = 60.0, 25.0
"""Grey levels by which a digit's strokes change at least, and those of a letter at most."""
_LEAST_ROLLED, _LEAST_STEADY, _LEAST_READ = 8, 0.25, 0.7
"""Pixels of digits; share of the strokes that stay; share of them that do one or the other."""
_WRITTEN = 0.15
"""Where a digit changes, each capture has strokes on this share of the pixels: a shadow or a person leaves none."""

Box = tuple[int, int, int, int]
"""x, y, width and height, pixels."""


def running_clock(images: Sequence[Uint8s], usable: Bools) -> Box | None:
    """The line of text whose digits change between pictures (h, w, 3) of one view, where `usable` (h, w) has not masked it."""
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
    """The box of a running clock in a band of the pictures."""
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
    """Pixels at which digits change into digits, of the changing strokes (captures, height, w) of a line.

    What changes is looked at in parts that stand apart, as digits do: a passer-by or a shadow may cross the bright stones of a
    paved row, and leaves none of them bright.
    """
    changing = np.flatnonzero(strokes.any(axis=(0, 1)))
    found = 0
    for columns in np.split(changing, np.flatnonzero(np.diff(changing) > max(1, height // 8)) + 1):
        each = strokes[:, :, columns].sum(axis=(1, 2))
        whole = int(strokes[:, :, columns].any(axis=0).sum())
        found += whole if each.min() >= _WRITTEN * whole else 0
    return found

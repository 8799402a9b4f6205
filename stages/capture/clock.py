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
        digits, letters = int(rolled[box].sum()), int(steady[box].sum())
        if h > highest or w < _LONG * h or digits < _LEAST_ROLLED:
            continue
        if letters >= _LEAST_STEADY * count and digits + letters >= _LEAST_READ * count:
            return x, y, w, h
    return None

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

_BAND_HEIGHT = 0.15
"""Height of the bands at the top and at the bottom of the image in which a clock is searched for, as a share of its height."""
_MOST_HEIGHT = 0.08
"""Largest height of a line of text, as a share of the image height."""
_LEAST_ASPECT = 8.0
"""Smallest ratio of a line's length to its height."""
_STROKE = 50.0
"""Smallest contrast of a stroke with its surroundings, grey levels."""
_WHITE = 170.0
"""Smallest grey level of a stroke: clocks are written in white."""
_DIGIT_RANGE = 60.0
"""Smallest range of grey levels, over the captures, of a digit's stroke that comes or goes."""
_LETTER_RANGE = 25.0
"""Largest range of grey levels, over the captures, of a letter's stroke, which stays."""
_LEAST_DIGIT_PIXELS = 8
"""Smallest number of changing pixels of digits in a line."""
_LEAST_LETTERS = 0.25
"""Smallest share of a line's strokes that stay."""
_LEAST_TEXT = 0.7
"""Smallest share of a line's strokes that either stay or change as digits do: other things are not made of strokes alone."""
_LEAST_STROKES = 0.15
"""Smallest share of a changing digit's pixels that are strokes in every capture; a shadow or a person leaves none."""

Box = tuple[int, int, int, int]
"""x, y, width and height, pixels."""


def running_clock(images: Sequence[Uint8s], usable: Bools) -> Box | None:
    """Box of the text line whose digits change between images (h, w, 3) of one view, within the mask `usable` (h, w), or None."""
    height, width = usable.shape
    if len(images) < 2 or min(height, width) < 64:
        return None
    band = max(16, round(_BAND_HEIGHT * height))
    for top in (0, height - band):
        rows = slice(top, top + band)
        bands = [np.asarray(grey_levels(image[rows])) for image in images]
        box = _clock_box(bands, usable[rows], _MOST_HEIGHT * height)
        if box is not None:
            x, y, w, h = box
            return x, top + y, w, h
    return None


def _clock_box(images: Sequence[Uint8s], usable: Bools, most_height: float) -> Box | None:
    """The box of a running clock in a band of the images, or None."""
    # 1. strokes: bright, and narrower than the kernel (a white top hat)
    kernel_size = max(5, round(0.6 * most_height)) | 1  # odd
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (kernel_size, kernel_size))
    masks = []
    for image in images:
        contrast = cv2.morphologyEx(image, cv2.MORPH_TOPHAT, kernel)
        masks.append((contrast > _STROKE) & (image > _WHITE))
    strokes = np.stack(masks)  # (captures, h, w)
    any_stroke = strokes.any(axis=0) & usable
    spread = np.ptp(np.stack(images).astype(np.float32), axis=0)
    changing = any_stroke & (spread >= _DIGIT_RANGE)
    constant = any_stroke & strokes.all(axis=0) & (spread <= _LETTER_RANGE)

    # 2. lines of text: strokes joined along their row
    join_width = max(5, round(1.2 * kernel_size)) | 1
    lines = cv2.morphologyEx(any_stroke.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, join_width), np.uint8))
    _, _, boxes, _ = cv2.connectedComponentsWithStats(lines, connectivity=8)
    for x, y, w, h, _ in boxes[1:].tolist():
        if h > most_height or w < _LEAST_ASPECT * h:
            continue
        rows = slice(y, y + h)
        columns = slice(x, x + w)
        count = int(any_stroke[rows, columns].sum())
        digits = _digit_pixels(strokes[:, rows, columns] & changing[rows, columns], h)
        letters = int(constant[rows, columns].sum())
        has_both = digits >= _LEAST_DIGIT_PIXELS and letters >= _LEAST_LETTERS * count
        if has_both and digits + letters >= _LEAST_TEXT * count:
            return x, y, w, h
    return None


def _digit_pixels(strokes: Bools, height: int) -> int:
    """Number of pixels at which digits change into other digits, from a line's changing strokes (captures, height, w).

    Changes are judged in groups of columns that are separated by gaps, as digits are: a passer-by or a shadow that crosses a
    row of bright paving stones leaves none of them bright.
    """
    changing_columns = np.flatnonzero(strokes.any(axis=(0, 1)))
    gaps = np.flatnonzero(np.diff(changing_columns) > max(1, height // 8))
    total = 0
    for columns in np.split(changing_columns, gaps + 1):
        stroke_counts = strokes[:, :, columns].sum(axis=(1, 2))
        digit_area = int(strokes[:, :, columns].any(axis=0).sum())
        if stroke_counts.min() >= _LEAST_STROKES * digit_area:
            total += digit_area
    return total

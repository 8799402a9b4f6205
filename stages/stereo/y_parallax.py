"""How far corresponding points lie from their common row: y-parallax, of which right cameras leave none.

Dense matching looks for partners on the row that cameras give, and finds most of them where these are some tenths of a pixel off,
too.  What is left of that across the rows shows it: where windows of both images are most alike, a row up or down.  Keypoints lie
within 0.3 pixels of their lines; the median of some hundred windows within 0.05.

References
----------
Y-parallax of relative orientation: Kraus, Photogrammetry, 2007, chapter 4.  Between three costs: parabola, e.g. Scharstein &
Szeliski, IJCV 2002.
"""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np

from ..types import Bools, Float32s, Float64s
from .matcher import RectifiedPair

_WINDOW = 7
_LEAST_FILLED = 0.8
"""Share of a window's pixels that need a disparity."""
_ALIKE, _SHARP, _CONTRAST = 0.6, 0.1, 2.0
"""A window is asked whose correlation is more than this, and falls by that from a row to the next (twice the second difference),
with so many grey levels of standard deviation."""
_TILES, _LEAST = 8, 20
"""Tiles along each side of the image, and the fewest windows that one needs."""
_FLOOR_PX, _USUAL_DEG = 0.05, 30.0
"""No tile is known better where views meet at less than this angle; beyond it, by its square (nine rendered
scenes, as they are, leave 0.01 to 0.09 below 45 degrees, but for one pair, and up to 0.25 at 88)."""


def measure_y_parallax(pair: RectifiedPair, disparity: Float32s, angle_deg: float) -> tuple[Float64s, Float64s, Float64s]:
    """One match for each part of the common view that is free to lie beside its row: pixels (n, 2) of the left and of the right
    rectified image, and the standard deviation (n,) of the latter's rows, pixels.

    disparity : (h, w) of the left image, nan where unknown.  angle_deg : between the views, nan where unknown.
    """
    floor = _FLOOR_PX * max(1.0, np.nan_to_num(angle_deg) / _USUAL_DEG) ** 2
    y_offset, sure = _offsets(pair, disparity)
    h, w = disparity.shape
    found = []
    for rows, columns in product(*(np.array_split(np.arange(side), min(_TILES, side)) for side in (h, w))):
        y, x = np.nonzero(sure[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])
        if len(y) < _LEAST:
            continue
        y, x = y + rows[0], x + columns[0]
        off = y_offset[y, x]
        median = float(np.median(off))
        scatter = 1.4826 * float(np.median(np.abs(off - median)))
        middle = int(np.argmin((y - y.mean()) ** 2 + (x - x.mean()) ** 2))
        at = float(x[middle]), float(y[middle])
        partner = at[0] - float(disparity[y[middle], x[middle]])
        windows = max(1.0, len(y) / _WINDOW**2)  # that share no pixel
        found.append((*at, partner, at[1] + median, np.hypot(floor, scatter / np.sqrt(windows))))
    tiles = np.array(found, dtype=np.float64).reshape(-1, 5)
    return tiles[:, :2], tiles[:, 2:4], tiles[:, 4]


def _offsets(pair: RectifiedPair, disparity: Float32s) -> tuple[Float32s, Bools]:
    """(h, w) rows by which the partner of each window lies lower, and where that is sure."""
    h, w = disparity.shape
    known = np.isfinite(disparity)
    y, x = np.mgrid[:h, :w].astype(np.float32)
    at = x - np.where(known, disparity, np.float32(0.0))
    weight = known.astype(np.float32)
    filled = _summed(weight)

    def mean(values: cv2.typing.MatLike) -> Float32s:
        return np.asarray(_summed(values * weight) / np.maximum(filled, 1.0), dtype=np.float32)

    def likeness(rows: float) -> Float32s:
        right = cv2.remap(pair.right, at, y + np.float32(rows), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        centre = mean(right)
        spread = variance * (mean(right * right) - centre * centre)
        return np.asarray((mean(left * right) - left_mean * centre) / np.sqrt(np.maximum(spread, 1e-6)), dtype=np.float32)

    left = pair.left
    left_mean = mean(left)
    variance = mean(left * left) - left_mean * left_mean
    above, here, below = (likeness(rows) for rows in (-1.0, 0.0, 1.0))
    bend = 2.0 * here - above - below
    offset = np.asarray((below - above) / (2.0 * np.maximum(bend, 1e-6)), dtype=np.float32)
    sure = known & (filled >= _LEAST_FILLED * _WINDOW**2) & (here > _ALIKE) & (bend > _SHARP) & (variance > _CONTRAST**2)
    return offset, sure & (np.abs(offset) < 1.0)


def _summed(values: Float32s) -> Float32s:
    return np.asarray(cv2.boxFilter(values, -1, (_WINDOW, _WINDOW), normalize=False), dtype=np.float32)

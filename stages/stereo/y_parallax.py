"""Residual y-parallax: the row offset between corresponding points of a rectified pair, zero if the cameras are right.

Dense matching searches along the rows that the cameras give, and finds most partners even if these are some tenths of a pixel
off.  The remaining offset shows when windows of both images are correlated on the same row, one row up and one row down.
Keypoints lie within 0.3 pixels of their epipolar lines, the median offset of some hundred windows within 0.05.

References
----------
Y-parallax of relative orientation: Kraus, Photogrammetry, 2007, chapter 4.  Parabola through three costs: e.g. Scharstein &
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
"""Smallest share of a window's pixels that must have a disparity."""
_SIMILAR, _SHARP, _CONTRAST = 0.6, 0.1, 2.0
"""A window is used if its correlation exceeds `_SIMILAR`, the (negative) second difference of its correlation over the three rows
exceeds `_SHARP`, and its standard deviation exceeds `_CONTRAST` grey levels."""
_TILES, _LEAST_WINDOWS = 8, 20
"""Tiles along each side of the image, and the fewest usable windows that a tile needs."""
_LEAST_SIGMA_PX, _USUAL_DEG = 0.05, 30.0
"""Smallest standard deviation of a tile, pixels, up to this angle between the views; beyond it, it grows with the angle's square
(nine unaltered rendered scenes leave 0.01 to 0.09 below 45 degrees, except for one pair, and up to 0.25 at 88)."""


def measure_y_parallax(pair: RectifiedPair, disparity: Float32s, angle_deg: float) -> tuple[Float64s, Float64s, Float64s]:
    """Measure the row offset in each tile of the common view by a match that may leave its row: pixels (n, 2) of the left and
    of the right rectified image, and the standard deviation (n,) of the latter's rows, pixels.

    disparity : (h, w) of the left image, nan where unknown.  angle_deg : angle between the views, nan where unknown.
    """
    least_sigma = _LEAST_SIGMA_PX * max(1.0, np.nan_to_num(angle_deg) / _USUAL_DEG) ** 2
    y_offset, reliable = _offsets(pair, disparity)
    h, w = disparity.shape
    measured = []
    for rows, columns in product(*(np.array_split(np.arange(side), min(_TILES, side)) for side in (h, w))):
        y, x = np.nonzero(reliable[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])
        if len(y) < _LEAST_WINDOWS:
            continue
        y, x = y + rows[0], x + columns[0]
        offsets = y_offset[y, x]
        median = float(np.median(offsets))
        scatter = 1.4826 * float(np.median(np.abs(offsets - median)))
        centre = int(np.argmin((y - y.mean()) ** 2 + (x - x.mean()) ** 2))
        point = float(x[centre]), float(y[centre])
        partner_x = point[0] - float(disparity[y[centre], x[centre]])
        windows = max(1.0, len(y) / _WINDOW**2)  # number of windows without a common pixel
        measured.append((*point, partner_x, point[1] + median, np.hypot(least_sigma, scatter / np.sqrt(windows))))
    tiles = np.array(measured, dtype=np.float64).reshape(-1, 5)
    return tiles[:, :2], tiles[:, 2:4], tiles[:, 4]


def _offsets(pair: RectifiedPair, disparity: Float32s) -> tuple[Float32s, Bools]:
    """(h, w) row offset of each window's partner in the right image, positive if it lies lower; and where it is reliable."""
    h, w = disparity.shape
    known = np.isfinite(disparity)
    y, x = np.mgrid[:h, :w].astype(np.float32)
    partner_x = x - np.where(known, disparity, np.float32(0.0))
    weight = known.astype(np.float32)
    filled = _window_sum(weight)

    def mean(values: cv2.typing.MatLike) -> Float32s:
        return np.asarray(_window_sum(values * weight) / np.maximum(filled, 1.0), dtype=np.float32)

    def correlation(rows: float) -> Float32s:
        right = cv2.remap(pair.right, partner_x, y + np.float32(rows), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        right_mean = mean(right)
        spread = variance * (mean(right * right) - right_mean * right_mean)
        return np.asarray((mean(left * right) - left_mean * right_mean) / np.sqrt(np.maximum(spread, 1e-6)), dtype=np.float32)

    left = pair.left
    left_mean = mean(left)
    variance = mean(left * left) - left_mean * left_mean
    above, here, below = (correlation(rows) for rows in (-1.0, 0.0, 1.0))
    curve = 2.0 * here - above - below
    offset = np.asarray((below - above) / (2.0 * np.maximum(curve, 1e-6)), dtype=np.float32)
    reliable = known & (filled >= _LEAST_FILLED * _WINDOW**2) & (here > _SIMILAR) & (curve > _SHARP) & (variance > _CONTRAST**2)
    return offset, reliable & (np.abs(offset) < 1.0)


def _window_sum(values: Float32s) -> Float32s:
    return np.asarray(cv2.boxFilter(values, -1, (_WINDOW, _WINDOW), normalize=False), dtype=np.float32)

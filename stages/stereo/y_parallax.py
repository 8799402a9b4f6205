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

import cv2
import numpy as np

from ..types import Bools, Float32s, Float64s
from .matcher import RectifiedPair

_WINDOW = 7
"""Side of the windows that are correlated, pixels; larger ones are less noisy and blur across edges."""
_LEAST_FILLED = 0.8
"""Smallest share of a window's pixels that must have a disparity."""
_LEAST_CORRELATION = 0.6
"""A window is used if its correlation exceeds this."""
_LEAST_CURVATURE = 0.1
"""A window is used if the negated second difference of its correlation over the three rows exceeds this: a sharp maximum."""
_LEAST_CONTRAST = 2.0
"""A window is used if its standard deviation exceeds this, grey levels."""
_MOST_OFFSET_PX = 1.0
"""A window is used if its offset is smaller, pixels: beyond it, the parabola extrapolates."""
_TILES = 8
"""Tiles along each side of the image."""
_LEAST_WINDOWS = 20
"""Fewest usable windows that a tile needs."""
_LEAST_SIGMA_PX = 0.05
"""Smallest standard deviation of a tile, pixels (measured: nine unaltered rendered scenes leave 0.01 to 0.09 below 45
degrees, except for one pair, and up to 0.25 at 88)."""
_NARROW_DEG = 30.0
"""Angle between the views, degrees, beyond which this smallest standard deviation grows with the angle's square."""
_MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""


def measure_y_parallax(pair: RectifiedPair, disparity: Float32s, angle_deg: float) -> tuple[Float64s, Float64s, Float64s]:
    """Measure the row offset in each tile of the common view by a match that may leave its row: pixels (n, 2) of the left and
    of the right rectified image, and the standard deviation (n,) of the latter's rows, pixels.

    disparity : (h, w) of the left image, nan where unknown.  angle_deg : angle between the views, nan where unknown.
    """
    least_sigma = _LEAST_SIGMA_PX * max(1.0, np.nan_to_num(angle_deg) / _NARROW_DEG) ** 2
    y_offset, reliable = _offsets(pair, disparity)
    height, width = disparity.shape
    measured = []
    for top, bottom in _tile_bounds(height):
        for left, right in _tile_bounds(width):
            y, x = np.nonzero(reliable[top:bottom, left:right])
            if len(y) < _LEAST_WINDOWS:
                continue
            y = y + top
            x = x + left
            offsets = y_offset[y, x]
            median = float(np.median(offsets))
            scatter = _MAD_TO_SIGMA * float(np.median(np.abs(offsets - median)))
            windows = max(1.0, len(y) / _WINDOW**2)  # number of windows without a common pixel
            sigma = np.hypot(least_sigma, scatter / np.sqrt(windows))
            # the tile's offset is given at the window nearest to the mean position of all
            centre = int(np.argmin((y - y.mean()) ** 2 + (x - x.mean()) ** 2))
            point_x = float(x[centre])
            point_y = float(y[centre])
            partner_x = point_x - float(disparity[y[centre], x[centre]])
            measured.append((point_x, point_y, partner_x, point_y + median, sigma))
    tiles = np.array(measured, dtype=np.float64).reshape(-1, 5)
    return tiles[:, :2], tiles[:, 2:4], tiles[:, 4]


def _tile_bounds(side: int) -> list[tuple[int, int]]:
    """First pixel and end of each tile along a `side` of so many pixels; tiles differ by one pixel at most."""
    tiles = np.array_split(np.arange(side), min(_TILES, side))
    return [(int(tile[0]), int(tile[-1]) + 1) for tile in tiles]


def _offsets(pair: RectifiedPair, disparity: Float32s) -> tuple[Float32s, Bools]:
    """(h, w) row offset of each window's partner in the right image, positive if it lies lower; and where it is reliable."""
    height, width = disparity.shape
    known = np.isfinite(disparity)
    weight = known.astype(np.float32)
    filled = _window_sum(weight)
    left = pair.left
    left_mean = _window_mean(left, weight, filled)
    left_variance = _window_mean(left * left, weight, filled) - left_mean * left_mean

    # correlation of each window with its partner one row up, on its row, and one row down
    y, x = np.mgrid[:height, :width].astype(np.float32)
    partner_x = x - np.where(known, disparity, np.float32(0.0))
    correlations = []
    for rows in (-1.0, 0.0, 1.0):
        right = cv2.remap(pair.right, partner_x, y + np.float32(rows), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        right_mean = _window_mean(right, weight, filled)
        right_variance = _window_mean(right * right, weight, filled) - right_mean * right_mean
        covariance = _window_mean(left * right, weight, filled) - left_mean * right_mean
        spread = left_variance * right_variance
        correlations.append(np.asarray(covariance / np.sqrt(np.maximum(spread, 1e-6)), dtype=np.float32))
    above, here, below = correlations

    # the vertex of the parabola through the three correlations
    curvature = 2.0 * here - above - below
    offset = np.asarray((below - above) / (2.0 * np.maximum(curvature, 1e-6)), dtype=np.float32)

    reliable = known & (filled >= _LEAST_FILLED * _WINDOW**2)
    reliable &= (here > _LEAST_CORRELATION) & (curvature > _LEAST_CURVATURE)
    reliable &= left_variance > _LEAST_CONTRAST**2
    reliable &= np.abs(offset) < _MOST_OFFSET_PX
    return offset, reliable


def _window_mean(values: cv2.typing.MatLike, weight: Float32s, filled: Float32s) -> Float32s:
    """(h, w) weighted means of the windows around each pixel; filled: the sums of their weights."""
    return np.asarray(_window_sum(values * weight) / np.maximum(filled, 1.0), dtype=np.float32)


def _window_sum(values: Float32s) -> Float32s:
    return np.asarray(cv2.boxFilter(values, -1, (_WINDOW, _WINDOW), normalize=False), dtype=np.float32)

"""Places in the pictures of cameras, for the report: where keypoints lie, and those that the geometry of a pair explains.

Each place takes two unsigned 16-bit numbers, little-endian: its shares of the picture's width and height, in 65535ths.
"""

from __future__ import annotations

import numpy as np

from ..types import Features, Float64s, Geometry, Int64s, View

MOST = 3000
"""Keypoints of a picture that are shown: more hide it."""
MOST_OF_A_PAIR = 400


def keypoint_marks(features: Features) -> bytes:
    """Evenly chosen ones of a camera's keypoints."""
    return _places(features.xy[_some(len(features.xy), MOST)], features.view)


def inlier_marks(geometry: Geometry) -> bytes:
    """Evenly chosen inliers of a pair: their places in the left picture, then as many in the right one."""
    some = _some(len(geometry.x1), MOST_OF_A_PAIR)
    return _places(geometry.x1[some], geometry.view1) + _places(geometry.x2[some], geometry.view2)


def _some(count: int, most: int) -> Int64s:
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.int64)


def _places(xy: Float64s, view: View) -> bytes:
    shares = (xy + 0.5) / (view.width, view.height)  # pixel centres are whole numbers
    return bytes(np.rint(shares.clip(0, 1) * 65535).astype("<u2").tobytes())

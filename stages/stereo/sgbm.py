"""OpenCV's semi-global matching, three directions, on both views (Hirschmueller, PAMI 2008; OpenCV's StereoSGBM)."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import Float32s, Uint8s
from .pair import DenseMatches, RectifiedPair, mirrored

_BLOCK = 3
_SOBEL_CAP = 20
_UNIQUENESS_PERCENT = 0


def match_sgbm(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views, each from its own run."""
    left = _left_disparity(pair)
    right = np.ascontiguousarray(_left_disparity(mirrored(pair))[:, ::-1])
    return DenseMatches(left, right, np.ones_like(left), np.ones_like(right))


def _left_disparity(pair: RectifiedPair) -> Float32s:
    """The right image is moved so that disparities start at 0, and both get columns on the left: StereoSGBM gives no value to
    columns that don't have the whole range inside the right image.  Columns where nothing may be matched are left out."""
    count = 16 * -(-(pair.disparity_max - pair.disparity_min + 1) // 16)
    disparity = np.full(pair.left.shape, np.nan, dtype=np.float32)
    used = np.flatnonzero(pair.valid_left.any(axis=0))
    if len(used) == 0:
        return disparity
    columns = slice(max(used[0] - _BLOCK, 0), used[-1] + 1 + _BLOCK)
    left = np.asarray(cv2.copyMakeBorder(_eight_bit(pair.left[:, columns]), 0, 0, count, 0, cv2.BORDER_REPLICATE), dtype=np.uint8)
    right = _shifted(_eight_bit(pair.right), count + pair.disparity_min - columns.start, left.shape[1])
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=_BLOCK,
        P1=7 * _BLOCK**2,
        P2=38 * _BLOCK**2,
        disp12MaxDiff=-1,
        preFilterCap=_SOBEL_CAP,
        uniquenessRatio=_UNIQUENESS_PERCENT,
        speckleWindowSize=0,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    found = matcher.compute(left, right)[:, count:]
    disparity[:, columns] = np.where(found < 0, np.float32(np.nan), found.astype(np.float32) / 16 + pair.disparity_min)
    return disparity


def _eight_bit(image: Float32s) -> Uint8s:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _shifted(image: Uint8s, by: int, width: int) -> Uint8s:
    """`image` with its column 0 at column `by` of a canvas of `width`; the ends repeat the border."""
    columns = np.clip(np.arange(width) - by, 0, image.shape[1] - 1)
    return np.ascontiguousarray(image[:, columns])

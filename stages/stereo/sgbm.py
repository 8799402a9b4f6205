"""OpenCV's semi-global matching, three directions, on both views (Hirschmueller, PAMI 2008; OpenCV's StereoSGBM)."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import Bools, Float32s, Uint8s
from .blocks import BELOW_PX, CONTEXT_PX, blocks
from .consistency import disagreement, without_speckles
from .matcher import DenseMatches, RectifiedPair, halved, mirrored

_BLOCK = 3
_SOBEL_CAP = 20
_UNIQUENESS_PERCENT = 0

_NARROW = 160
"""Ranges of up to this many disparities are searched in one piece: it costs no more than blocks do."""


def match_sgbm(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views, each from its own runs; blocks of a wide range are searched as far as half the size tells."""
    if pair.disparity_max - pair.disparity_min < _NARROW:
        return match_in_one_piece(pair)
    small = halved(pair)
    seen = match_sgbm(small)
    left = _in_blocks(pair, confirmed(seen.left, seen.right, small.valid_left, -1))
    seen_right = confirmed(seen.right, seen.left, small.valid_right, 1)
    right = np.ascontiguousarray(_in_blocks(mirrored(pair), seen_right[:, ::-1])[:, ::-1])
    return DenseMatches(left, right, np.ones_like(left), np.ones_like(right))


def match_in_one_piece(pair: RectifiedPair) -> DenseMatches:
    """The same with the whole range for all of the image."""
    left = _whole(pair)
    right = np.ascontiguousarray(_whole(mirrored(pair))[:, ::-1])
    return DenseMatches(left, right, np.ones_like(left), np.ones_like(right))


def confirmed(one: Float32s, other: Float32s, valid: Bools, sign: int) -> Float32s:
    """Disparity of one view where the other one's differs by at most a pixel, without speckles; nan elsewhere.

    Parameters
    ----------
    one : ndarray
        (h, w) disparity of the view, nan where unknown.
    other : ndarray
        (h, w) disparity of the other view.
    valid : ndarray
        (h, w) pixels of the view that may be used.
    sign : int
        -1 for the left view, 1 for the right one.
    """
    agreed = valid & (disagreement(one, other, sign) <= 1)
    return without_speckles(np.where(agreed, one, np.float32(np.nan)), max(agreed.size // 2000, 4))


def _in_blocks(pair: RectifiedPair, seen: Float32s) -> Float32s:
    left, right = _eight_bit(pair.left), _eight_bit(pair.right)
    disparity = np.full(left.shape, np.nan, dtype=np.float32)
    for block in blocks(seen, pair.disparity_min, pair.disparity_max):
        top, start = max(block.top - CONTEXT_PX, 0), max(block.left - CONTEXT_PX, 0)
        rows, columns = slice(top, block.bottom + BELOW_PX), slice(start, block.right + CONTEXT_PX)
        found = _searched(left[rows, columns], right[rows], start, block.low, block.high)
        inner = slice(block.top, block.bottom), slice(block.left, block.right)
        disparity[inner] = found[block.top - top : block.bottom - top, block.left - start : block.right - start]
    return disparity


def _whole(pair: RectifiedPair) -> Float32s:
    """Columns where nothing may be matched are left out."""
    disparity = np.full(pair.left.shape, np.nan, dtype=np.float32)
    used = np.flatnonzero(pair.valid_left.any(axis=0))
    if len(used) > 0:
        columns = slice(max(used[0] - _BLOCK, 0), used[-1] + 1 + _BLOCK)
        left, right = _eight_bit(pair.left[:, columns]), _eight_bit(pair.right)
        disparity[:, columns] = _searched(left, right, columns.start, pair.disparity_min, pair.disparity_max)
    return disparity


def _searched(left: Uint8s, right: Uint8s, start: int, low: int, high: int) -> Float32s:
    """Disparity (h, w) of a part of the left image that begins at its column `start`; right: the same rows, all columns.

    The right image is moved so that disparities start at 0, and both get columns on the left: StereoSGBM gives no value to
    columns that don't have the whole range inside the right image.
    """
    count = 16 * -(-(high - low + 1) // 16)
    left = np.asarray(cv2.copyMakeBorder(left, 0, 0, count, 0, cv2.BORDER_REPLICATE), dtype=np.uint8)
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
    found = matcher.compute(left, _shifted(right, count + low - start, left.shape[1]))[:, count:]
    return np.where(found < 0, np.float32(np.nan), found.astype(np.float32) / 16 + low).astype(np.float32)


def _eight_bit(image: Float32s) -> Uint8s:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _shifted(image: Uint8s, by: int, width: int) -> Uint8s:
    """`image` with its column 0 at column `by` of a canvas of `width`; the ends repeat the border."""
    columns = np.clip(np.arange(width) - by, 0, image.shape[1] - 1)
    return np.ascontiguousarray(image[:, columns])

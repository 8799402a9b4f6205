"""Filters for raw dense matches: agreement of both views, and removal of speckles."""

from __future__ import annotations

import cv2
import numpy as np

from ..core.jit import kernel
from ..types import Bools, Float32s

_STEEPNESS_WEIGHT = 0.15
"""The tolerance of `agreeing` is divided by 1 + this times the range of disparities around the pixel, in pixels; larger
values drop more pixels at edges."""
_STEP_X = 1.5
"""Largest difference, in pixels, between the disparities of connected neighbours within a row; larger values keep more
speckles."""
_STEP_Y = 4.0
"""The same between rows: ground seen at a low angle changes by several pixels from row to row, but never along a row."""
_FAR_BELOW = np.float32(-1e6)
"""A disparity, in pixels, below any that occurs: stands for an unknown one where the largest is sought."""
_FAR_ABOVE = np.float32(1e6)
"""A disparity above any that occurs: stands for an unknown one where the smallest is sought."""
_AGREED_PX = 1.0
"""Largest difference, in pixels, between the disparities of both views in `cross_checked`."""


@kernel
def disagreement(disparity: Float32s, other_disparity: Float32s, sign: int) -> Float32s:
    """(h, w) float32: difference between a view's disparity and that of the pixel it points to, inf where either is unknown.

    sign: -1 when `disparity` belongs to the left view (x2 = x1 - d), 1 for the right view.
    """
    height, width = disparity.shape
    difference = np.full((height, width), np.inf, dtype=np.float32)
    for y in range(height):
        for x in range(width):
            column = np.rint(np.float32(x) + np.float32(sign) * disparity[y, x])
            if 0 <= column < width:  # False for nan, too
                distance = abs(other_disparity[y, int(column)] - disparity[y, x])
                if not np.isnan(distance):
                    difference[y, x] = distance
    return difference


def agreeing(disparity: Float32s, other_disparity: Float32s, sign: int, tolerance_px: float) -> Bools:
    """(h, w) bool: the other view agrees within `tolerance_px`, and more closely where disparity is steep or torn: the
    tolerance is divided by 1 + `_STEEPNESS_WEIGHT` times the range of disparities within 5x5 pixels.

    There, errors exceed the disagreement between the views, because both stretch the same edge over the background.

    Parameters
    ----------
    disparity, other_disparity : (h, w) disparity of the view and of the other one, nan where unknown.
    sign : -1 for the left view, 1 for the right one.
    tolerance_px : on flat surfaces, pixels.
    """
    difference = disagreement(disparity, other_disparity, sign)
    known = difference <= tolerance_px
    window = np.ones((5, 5), dtype=np.uint8)
    highest = cv2.dilate(np.where(known, disparity, _FAR_BELOW), window)
    lowest = cv2.erode(np.where(known, disparity, _FAR_ABOVE), window)
    # the difference is multiplied, which is the same as dividing the tolerance
    weighted_difference = difference * (1 + _STEEPNESS_WEIGHT * (highest - lowest))
    return np.asarray(known & (weighted_difference <= tolerance_px))


def lands_on(valid_other: Bools, disparity: Float32s, sign: int) -> Bools:
    """(h, w) bool: does each disparity point to a pixel of the other view that may be matched?"""
    width = disparity.shape[1]
    x = np.arange(width, dtype=np.float32) + sign * np.nan_to_num(disparity, nan=-1e6)
    column = np.rint(np.clip(x, -1, width)).astype(np.int64)  # clipped to one pixel outside, so that it fits an integer
    inside = (column >= 0) & (column < width)
    valid_there = np.take_along_axis(valid_other, np.clip(column, 0, width - 1), axis=1)
    return np.asarray(inside & valid_there, dtype=np.bool_)


def cross_checked(disparity: Float32s, other_disparity: Float32s, valid: Bools, sign: int, smallest_px: int) -> Float32s:
    """Disparity of one view where the other view agrees within one pixel, without speckles; nan elsewhere.

    Parameters
    ----------
    disparity, other_disparity : (h, w) disparity of the view and of the other one, nan where unknown.
    valid : (h, w) pixels of the view that may be used.
    sign : -1 for the left view, 1 for the right one.
    smallest_px : connected pieces of fewer pixels are removed.
    """
    agreed = valid & (disagreement(disparity, other_disparity, sign) <= _AGREED_PX)
    return without_speckles(np.where(agreed, disparity, np.float32(np.nan)), smallest_px)


def without_speckles(disparity: Float32s, smallest_px: int) -> Float32s:
    """Disparity (h, w), nan where unknown, without connected pieces of fewer than `smallest_px` pixels."""
    kept = disparity.copy()
    _drop_speckles(kept, smallest_px, _STEP_X, _STEP_Y)
    return kept


@kernel
def _drop_speckles(disparity: Float32s, smallest_px: int, step_x: float, step_y: float) -> None:
    """Set connected pieces of fewer than `smallest_px` pixels to nan, by flood fill from each pixel not visited yet."""
    height, width = disparity.shape
    visited = np.isnan(disparity)
    piece = np.empty(height * width, dtype=np.int32)  # its pixels so far; those from k on still have neighbours to visit
    for y0 in range(height):
        for x0 in range(width):
            if visited[y0, x0]:
                continue
            visited[y0, x0] = True
            piece[0] = y0 * width + x0
            count = 1
            k = 0
            while k < count:
                y, x = divmod(piece[k], width)
                k += 1
                d = disparity[y, x]
                for dy, dx, most_step in ((1, 0, step_y), (-1, 0, step_y), (0, 1, step_x), (0, -1, step_x)):
                    ny = y + dy
                    nx = x + dx
                    if not (0 <= ny < height and 0 <= nx < width) or visited[ny, nx]:
                        continue
                    if abs(disparity[ny, nx] - d) <= most_step:
                        visited[ny, nx] = True
                        piece[count] = ny * width + nx
                        count += 1
            if count < smallest_px:
                for k in range(count):
                    y, x = divmod(piece[k], width)
                    disparity[y, x] = np.nan


def fill_along_rows(disparity: Float32s, nearer: int) -> Float32s:
    """Disparity with each hole filled by the farther value at its two ends in the row: a foreground hides background.

    nearer: 1 where larger disparities are nearer, -1 where smaller ones are.  Rows without any value stay nan.
    """
    width = disparity.shape[1]
    known = ~np.isnan(disparity)
    # column of the last known value up to each pixel, and of the first from it on; -1 and width where there is none
    previous_known = np.maximum.accumulate(np.where(known, np.arange(width), -1), axis=1)
    next_known = np.minimum.accumulate(np.where(known, np.arange(width), width)[:, ::-1], axis=1)[:, ::-1]
    # a column of nan on either side stands for these two
    bordered = np.pad(disparity, ((0, 0), (1, 1)), constant_values=np.nan)
    before = np.take_along_axis(bordered, previous_known + 1, axis=1)
    after = np.take_along_axis(bordered, next_known + 1, axis=1)
    # fmin and fmax ignore nan, so that a hole with one end takes that one
    if nearer > 0:
        return np.asarray(np.fmin(before, after), dtype=np.float32)
    return np.asarray(np.fmax(before, after), dtype=np.float32)

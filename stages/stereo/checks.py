"""What is kept of raw dense matches: both views must agree, specks go."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import INVALID, Bools, Float32s, Int16s


def disagreement(one: Float32s, other: Float32s, sign: int) -> Float32s:
    """(h, w) float32: how far the disparity of one view differs from that of the pixel it points to, inf where there is none.

    sign: -1 when `one` belongs to the left view (x2 = x1 - d), 1 for the right view.
    """
    height, width = one.shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    target = np.where(np.isnan(one), np.float32(-10), np.clip(x + sign * one, -10, width + 10)).astype(np.float32)
    back = cv2.remap(other, target, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
    difference = np.abs(back - one)
    return np.where(np.isnan(difference), np.float32(np.inf), difference).astype(np.float32)


def lands_on(valid_other: Bools, disparity: Float32s, sign: int) -> Bools:
    """(h, w) bool: the pixel that each disparity points to may be matched."""
    width = disparity.shape[1]
    x = np.arange(width, dtype=np.float32) + sign * np.nan_to_num(disparity, nan=-1e6)
    column = np.rint(np.clip(x, -1, width)).astype(np.int64)
    inside = (column >= 0) & (column < width)
    return np.asarray(inside & np.take_along_axis(valid_other, np.clip(column, 0, width - 1), axis=1), dtype=np.bool_)


def without_specks(stored: Int16s, largest_px: int, step_px: float) -> Int16s:
    """Stored disparity without connected pieces (neighbours within `step_px`) of at most `largest_px` pixels."""
    kept = stored.copy()
    cv2.filterSpeckles(kept, INVALID, largest_px, round(16 * step_px))
    return kept


def within_reach(valid: Bools, valid_other: Bools, disparity_min: int, disparity_max: int, sign: int) -> Bools:
    """(h, w) bool: valid pixels that have at least one valid partner within the disparity range."""
    height, width = valid.shape
    count = np.zeros((height, width + 1), dtype=np.int32)
    np.cumsum(valid_other, axis=1, out=count[:, 1:])
    ends = sign * disparity_min, sign * disparity_max
    first = np.clip(np.arange(width) + min(ends), 0, width)
    last = np.clip(np.arange(width) + max(ends) + 1, 0, width)
    return valid & (count[:, last] > count[:, first])

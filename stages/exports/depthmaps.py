"""Depth of each view as files: float PFM, and 16-bit PNG with a scale."""

from __future__ import annotations

import numpy as np

from ..io.rasters import pfm, png, stepped
from ..types import DepthMap


def depth_files(depth: DepthMap) -> tuple[dict[str, bytes], float]:
    """Files of the depths that are sure, by suffix, and the steps of the PNG in a unit of length.

    PNG: 0 is unknown, else depth = (value - 1) / steps.  PFM: float32, bottom row first, infinite where unknown.
    """
    # a depth that needs another view to be believed is no answer when this view is looked at alone
    sure = np.where(depth.sure, depth.depth, np.nan).astype(np.float32)
    values, steps = stepped(sure, 0.0)
    return {".png": png(values), ".pfm": pfm(sure)}, steps

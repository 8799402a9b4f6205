"""Dense matches as the witness of a pair whose cameras are known: are the rows right, and where does the scene really lie?

The images are matched at half their size, on the rows that the cameras give and on shifted ones (`row_test`).  What matches on
the right rows then takes the place of keypoints: it tells net, crop and range of disparities of the final rectification.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rectification.warping import from_rectified
from ..types import Float32s, Float64s, Frame, Rectification
from .coarse_range import with_coarse_range
from .rectified import rectified_pair
from .row_test import RowTest, row_test

_MOST_POINTS = 4000


@dataclass(frozen=True)
class Witness:
    """What dense matching says of a rectification."""

    rows: RowTest
    """Are its rows right?"""
    x1: Float64s
    """(n, 2) pixels of frame 1: some of what matched, evenly spread over it..."""
    x2: Float64s
    """(n, 2) ...and where in frame 2."""
    confidence: Float32s
    """(n,) 0 to 1."""


def ask_witness(left: Frame, right: Frame, rectification: Rectification) -> Witness:
    """Match both frames at half their size as `rectification` resamples them."""
    rows, disparity, confidence = row_test(with_coarse_range(rectified_pair(left, right, rectification)))
    y, x = np.nonzero(np.isfinite(disparity))
    some = slice(None, None, max(1, len(x) // _MOST_POINTS))
    y, x = y[some], x[some]
    at1 = np.column_stack([2 * x + 0.5, 2 * y + 0.5])
    at2 = at1 - np.column_stack([2 * disparity[y, x].astype(np.float64), np.zeros(len(x))])
    x1, x2 = from_rectified(rectification, 1, at1), from_rectified(rectification, 2, at2)
    return Witness(rows, x1, x2, confidence[y, x])

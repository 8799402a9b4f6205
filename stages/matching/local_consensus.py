"""Local affine maps of matches whose keypoints have no frames: at each match, the map on which most of its neighbours agree.

A right match moves with its neighbours, a wrong one does not (after L. Cavalli et al., AdaLAM: Revisiting Handcrafted Outlier
Detection, arXiv 2006.04250).  No random numbers are drawn: each two near neighbours propose a map.
"""

from __future__ import annotations

import numpy as np

from ..core.jit import helper, kernel
from ..core.nearest_points import nearest_points
from ..types import Float64s, Int32s

NEIGHBOURS = 32
"""Nearest matches in image 1 that are asked."""
PROPOSING = 14
"""Of these, the nearest ones: each two of them propose a map, together with the match itself."""
AGREE_PX = 4.0
"""A neighbour agrees with a map that predicts it to within this many pixels, plus `AGREE_PER_PX` of its distance."""
AGREE_PER_PX = 0.1
"""Error of a prediction that is allowed for each pixel of distance in image 2; no unit."""
LEAST_SPACING_PX = 1.5
"""Matches nearer to each other than this (sum of both coordinates, pixels) are repeats of one thing and do not count."""
LEAST_SINE = 0.3
"""Smallest sine of the angle between two neighbours that propose a map: nearly in line, they would not define one."""
LARGEST_STRETCH = 6.0
"""Largest factor by which a map may stretch or shrink in any direction; no unit."""
FEWEST = 4
"""With fewer matches there is no consensus: three define a map."""


def local_consensus(x1: Float64s, x2: Float64s) -> tuple[Float64s, Int32s]:
    """Find the local map of each match.

    Parameters
    ----------
    x1, x2 : (n, 2) pixels of the matches in either image.

    Returns
    -------
    Affine maps (n, 2, 2) from image 1 to image 2, the identity where none was found; and the number (n,) of neighbours that
    agree with each, among them the two that define it.
    """
    affine = np.tile(np.eye(2), (len(x1), 1, 1))
    support = np.zeros(len(x1), np.int32)
    if len(x1) >= FEWEST:
        # one more than wanted: each match is its own nearest
        distance, index = nearest_points(x1, x1, min(NEIGHBOURS, len(x1) - 1) + 1)
        nearest_first = np.lexsort((index, distance), axis=1)
        _find_maps(np.take_along_axis(index, nearest_first, axis=1), x1, x2, affine, support)
    return affine, support


@kernel
def _find_maps(index: Int32s, x1: Float64s, x2: Float64s, affine: Float64s, support: Int32s) -> None:
    """Write the map and its support at each match.  index: (n, k) its nearest matches in image 1, nearest first."""
    k = index.shape[1]
    step1 = np.empty((k, 2))
    step2 = np.empty((k, 2))
    for n in range(len(x1)):
        # 1. steps to the neighbours in either image, without repeats and the match itself
        count = 0
        for a in range(k):
            b = index[n, a]
            du = x1[b, 0] - x1[n, 0]
            dv = x1[b, 1] - x1[n, 1]
            if abs(du) + abs(dv) > LEAST_SPACING_PX:
                step1[count, 0] = du
                step1[count, 1] = dv
                step2[count, 0] = x2[b, 0] - x2[n, 0]
                step2[count, 1] = x2[b, 1] - x2[n, 1]
                count += 1

        # 2. each two of the nearest propose a map: the one with most support is kept, of equal ones that with smaller errors
        most = 0
        least_error = 0.0
        for a in range(min(count, PROPOSING)):
            for b in range(a):
                det = step1[a, 0] * step1[b, 1] - step1[a, 1] * step1[b, 0]
                length_a = step1[a, 0] ** 2 + step1[a, 1] ** 2
                length_b = step1[b, 0] ** 2 + step1[b, 1] ** 2
                if abs(det) < LEAST_SINE * np.sqrt(length_a * length_b):
                    continue
                m00 = (step2[a, 0] * step1[b, 1] - step2[b, 0] * step1[a, 1]) / det
                m01 = (step2[b, 0] * step1[a, 0] - step2[a, 0] * step1[b, 0]) / det
                m10 = (step2[a, 1] * step1[b, 1] - step2[b, 1] * step1[a, 1]) / det
                m11 = (step2[b, 1] * step1[a, 0] - step2[a, 1] * step1[b, 0]) / det
                if not _is_plausible(m00, m01, m10, m11):
                    continue
                agreeing = 0
                error = 0.0
                for c in range(count):
                    ex = m00 * step1[c, 0] + m01 * step1[c, 1] - step2[c, 0]
                    ey = m10 * step1[c, 0] + m11 * step1[c, 1] - step2[c, 1]
                    allowed = AGREE_PX + AGREE_PER_PX * np.sqrt(step2[c, 0] ** 2 + step2[c, 1] ** 2)
                    share = (ex * ex + ey * ey) / (allowed * allowed)
                    if share < 1:
                        agreeing += 1
                        error += share
                if agreeing > most or (agreeing == most and error < least_error):
                    most = agreeing
                    least_error = error
                    affine[n, 0, 0] = m00
                    affine[n, 0, 1] = m01
                    affine[n, 1, 0] = m10
                    affine[n, 1, 1] = m11
        support[n] = most


@helper
def _is_plausible(m00: float, m01: float, m10: float, m11: float) -> bool:
    """Does a map keep the orientation of surfaces, and stretch no direction by more than `LARGEST_STRETCH`, or shrink it so?"""
    det = m00 * m11 - m01 * m10
    if det <= 0:
        return False
    # singular values from their squares' sum and their product
    squares = m00 * m00 + m01 * m01 + m10 * m10 + m11 * m11
    largest = np.sqrt(0.5 * (squares + np.sqrt(max(squares * squares - 4 * det * det, 0.0))))
    return bool(largest <= LARGEST_STRETCH and det / largest >= 1 / LARGEST_STRETCH)

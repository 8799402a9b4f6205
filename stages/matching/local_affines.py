"""Local affine maps of matches: from the frames of their keypoints, or from the matches around them."""

from __future__ import annotations

import numpy as np

from ..types import LEARNED, Features, Float64s, Int32s
from .local_consensus import local_consensus


def match_affines(left: Features, right: Features, i1: Int32s, i2: Int32s) -> Float64s:
    """(n, 2, 2) map from image 1 to image 2 at each match, by the frames of its keypoints; learned keypoints have none, and
    their matches get the map on which the learned matches around them agree.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    i1, i2 : (n,) int32 rows of the matches in `left` and `right`.
    """
    affine = np.asarray(right.frames[i2] @ np.linalg.inv(left.frames[i1]), dtype=np.float64)
    is_learned = left.tilts[i1] >= LEARNED
    if is_learned.any():
        affine[is_learned] = local_consensus(left.xy[i1[is_learned]], right.xy[i2[is_learned]])[0]
    return affine

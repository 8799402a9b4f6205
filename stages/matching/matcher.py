"""Shared by the sparse matchers: the keypoints that they may use, and the form of their result."""

from __future__ import annotations

import numpy as np

from ..types import PLAIN, Features, Float64s, Int32s, Matches


def keypoint_matches(
    left: Features,
    right: Features,
    i1: Int32s,
    i2: Int32s,
    probability: Float64s,
    *,
    tilted: bool = False,
    searched: tuple[object, ...] = (),
) -> Matches:
    """`Matches` from rows of keypoints.

    Parameters
    ----------
    left, right : the keypoints of the two frames.
    i1, i2 : (n,) int32 rows of `left` and `right`.
    probability : (n,) probability that each match is right, 0 to 1.
    tilted : the views compressed in x were used too.
    searched : results that geometry may use again, see `Matches.searched`.
    """
    affine = right.frames[i2] @ np.linalg.inv(left.frames[i1])
    p = probability.astype(np.float32)
    return Matches(left.xy[i1], right.xy[i2], i1, i2, p, affine, left.view, right.view, tilted=tilted, searched=searched)


def plain_rows(features: Features) -> Int32s:
    """Rows of the keypoints of the plain view, for matchers that use only one view."""
    return np.flatnonzero(features.tilts == PLAIN).astype(np.int32)

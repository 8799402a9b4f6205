"""Shared by the sparse matchers: the keypoints that they may use, and the form of their result."""

from __future__ import annotations

import numpy as np

from ..types import LEARNED, PLAIN, Features, Float64s, Int32s, Matches
from .local_affines import match_affines


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
    affine = match_affines(left, right, i1, i2)
    p = probability.astype(np.float32)
    return Matches(left.xy[i1], right.xy[i2], i1, i2, p, affine, left.view, right.view, tilted=tilted, searched=searched)


def plain_rows(features: Features) -> Int32s:
    """Rows of the keypoints of the plain view, for matchers that use only one view; learned ones where there are no others."""
    is_plain = features.tilts == PLAIN
    if not is_plain.any():
        is_plain = features.tilts == LEARNED
    return np.flatnonzero(is_plain).astype(np.int32)

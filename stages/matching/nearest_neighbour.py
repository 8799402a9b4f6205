"""Alternatives to the structural matcher: nearest neighbours with a ratio test, mutual ones or Lowe's (IJCV 2004, section 7)."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..contracts.defaults import NEIGHBOUR_RATIO, SEED
from ..types import Features, Matches
from .matcher import keypoint_matches, plain_rows
from .neighbours import nearest_neighbours


def match_mutual(left: Features, right: Features, *, ratio: float = NEIGHBOUR_RATIO) -> Matches:
    """Match mutual nearest neighbours of the plain views; `probability` is 1 - first/second distance, which is only a ranking.

    Parameters
    ----------
    left, right : keypoints of the pair; those of compressed views are left out.
    ratio : largest ratio of first to second descriptor distance, both ways; no unit.
    """
    rows1 = plain_rows(left)
    rows2 = plain_rows(right)
    neighbours = nearest_neighbours(left.descriptors[rows1], right.descriptors[rows2], 2)
    if neighbours.rows.shape[1] < 2:  # no second neighbour, and hence no ratio
        return keypoint_matches(left, right, rows1[:0], rows2[:0], np.zeros(0))
    i1, i2, ratios = neighbours.mutual()
    keep = ratios < ratio
    return keypoint_matches(left, right, rows1[i1[keep]], rows2[i2[keep]], 1 - ratios[keep])


_KDTREE = 1
"""FLANN's number for randomised k-d trees."""
_TREES = 4
"""Trees that are searched together."""
_CHECKS = 200
"""Leaves that are visited for each query.  More find the true neighbour more often, and cost time."""


def match_kdtree(left: Features, right: Features, *, ratio: float = NEIGHBOUR_RATIO, seed: int = SEED) -> Matches:
    """Match nearest neighbours of the plain views (k-d trees); `probability` is 1 - first/second distance, only a ranking.

    Parameters
    ----------
    left, right : keypoints of the pair; those of compressed views are left out.
    ratio : largest ratio of first to second descriptor distance; no unit.
    seed : seed of the trees' random splits.
    """
    rows1 = plain_rows(left)
    rows2 = plain_rows(right)
    found: Sequence[Sequence[cv2.DMatch]] = []
    if len(rows1) and len(rows2) >= 2:
        cv2.setRNGSeed(seed)
        matcher = cv2.FlannBasedMatcher({"algorithm": _KDTREE, "trees": _TREES}, {"checks": _CHECKS})
        found = matcher.knnMatch(left.descriptors[rows1], right.descriptors[rows2], 2)

    # the ratio of first to second distance, wherever the trees found two neighbours
    first_rows = []
    second_rows = []
    all_ratios = []
    for neighbours in found:
        if len(neighbours) == 2:
            nearest, second = neighbours
            first_rows.append(nearest.queryIdx)
            second_rows.append(nearest.trainIdx)
            all_ratios.append(nearest.distance / max(second.distance, 1e-9))
    i1 = np.array(first_rows, np.int32)
    i2 = np.array(second_rows, np.int32)
    ratios = np.array(all_ratios, np.float32)
    keep = ratios < ratio
    return keypoint_matches(left, right, rows1[i1[keep]], rows2[i2[keep]], 1 - ratios[keep].astype(np.float64))

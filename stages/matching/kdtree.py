"""Rival: Lowe's matching (IJCV 2004, section 7), randomised kd-trees of FLANN and the ratio of the two nearest distances."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import Features, Float32s, Int32s, Matches
from .matcher import keypoint_matches, plain_rows

_KDTREE = 1
_TREES = 4
_CHECKS = 200


def match_kdtree(left: Features, right: Features, *, ratio: float = 0.8, seed: int = 0) -> Matches:
    """Match the keypoints of the plain views; `probability` is 1 - first/second distance, an order and no frequency.

    Parameters
    ----------
    left, right
        Keypoints of the pair; those of simulated views are left out.
    ratio
        First over second descriptor distance, at most; no unit.
    seed
        Of the trees' random splits.
    """
    rows1, rows2 = plain_rows(left), plain_rows(right)
    i1, i2, rivalry = kdtree_matches(left.descriptors[rows1], right.descriptors[rows2], ratio, seed)
    return keypoint_matches(left, right, rows1[i1], rows2[i2], 1 - rivalry.astype(np.float64))


def kdtree_matches(descriptors1: Float32s, descriptors2: Float32s, ratio: float, seed: int) -> tuple[Int32s, Int32s, Float32s]:
    """Rows i1, i2 whose first/second distance in set 2 is below `ratio`, and that ratio (n,); several i1 may share an i2.

    Parameters
    ----------
    descriptors1, descriptors2
        (n1, d) and (n2, d) float32.
    ratio
        First over second distance, at most.
    seed
        Of the trees' random splits.
    """
    if len(descriptors1) == 0 or len(descriptors2) < 2:
        return np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32)
    cv2.setRNGSeed(seed)  # the trees' random splits
    matcher = cv2.FlannBasedMatcher({"algorithm": _KDTREE, "trees": _TREES}, {"checks": _CHECKS})
    pairs = [pair for pair in matcher.knnMatch(descriptors1, descriptors2, 2) if len(pair) == 2]
    i1 = np.array([a.queryIdx for a, _ in pairs], np.int32)
    i2 = np.array([a.trainIdx for a, _ in pairs], np.int32)
    ratios = np.array([a.distance / max(b.distance, 1e-9) for a, b in pairs], np.float32)
    keep = ratios < ratio
    return i1[keep], i2[keep], ratios[keep]

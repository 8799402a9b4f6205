"""Rivals of the structural matcher: nearest neighbours under a ratio test, mutual ones or Lowe's (IJCV 2004, section 7)."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import Features, Float32s, Int32s, Matches
from .matcher import keypoint_matches, plain_rows
from .neighbours import nearest_neighbours


def match_mutual(left: Features, right: Features, *, ratio: float = 0.8) -> Matches:
    """Match the keypoints of the plain views; `probability` is 1 - first/second distance, an order and no frequency.

    Parameters
    ----------
    left, right : keypoints of the pair; those of simulated views are left out.
    ratio : first over second descriptor distance, at most, both ways; no unit.
    """
    rows1, rows2 = plain_rows(left), plain_rows(right)
    i1, i2, distance_ratio = mutual_matches(left.descriptors[rows1], right.descriptors[rows2], ratio)
    return keypoint_matches(left, right, rows1[i1], rows2[i2], 1 - distance_ratio.astype(np.float64))


def mutual_matches(descriptors1: Float32s, descriptors2: Float32s, ratio: float) -> tuple[Int32s, Int32s, Float32s]:
    """Rows i1, i2 of mutual nearest neighbours with first/second distance below `ratio` both ways, and that ratio (n,)."""
    near = nearest_neighbours(descriptors1, descriptors2, 2)
    if near.rows.shape[1] < 2:
        return np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32)
    i1, i2, worse = near.mutual()
    keep = worse < ratio
    return i1[keep].astype(np.int32), i2[keep], worse[keep]


_KDTREE = 1
_TREES = 4
_CHECKS = 200


def match_kdtree(left: Features, right: Features, *, ratio: float = 0.8, seed: int = 0) -> Matches:
    """Match the keypoints of the plain views; `probability` is 1 - first/second distance, an order and no frequency.

    Parameters
    ----------
    left, right : keypoints of the pair; those of simulated views are left out.
    ratio : first over second descriptor distance, at most; no unit.
    seed : of the trees' random splits.
    """
    rows1, rows2 = plain_rows(left), plain_rows(right)
    i1, i2, distance_ratio = kdtree_matches(left.descriptors[rows1], right.descriptors[rows2], ratio, seed)
    return keypoint_matches(left, right, rows1[i1], rows2[i2], 1 - distance_ratio.astype(np.float64))


def kdtree_matches(descriptors1: Float32s, descriptors2: Float32s, ratio: float, seed: int) -> tuple[Int32s, Int32s, Float32s]:
    """Rows i1, i2 whose first/second distance in set 2 is below `ratio`, and that ratio (n,); several i1 may share an i2.

    Parameters
    ----------
    descriptors1, descriptors2 : (n1, d) and (n2, d) float32.
    ratio : first over second distance, at most.
    seed : of the trees' random splits.
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

"""Alternatives to the structural matcher: nearest neighbours with a ratio test, mutual ones or Lowe's (IJCV 2004, section 7)."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import Features, Matches
from .matcher import keypoint_matches, plain_rows
from .neighbours import nearest_neighbours


def match_mutual(left: Features, right: Features, *, ratio: float = 0.8) -> Matches:
    """Match mutual nearest neighbours of the plain views; `probability` is 1 - first/second distance, which is only a ranking.

    Parameters
    ----------
    left, right : keypoints of the pair; those of compressed views are left out.
    ratio : largest ratio of first to second descriptor distance, both ways; no unit.
    """
    rows1, rows2 = plain_rows(left), plain_rows(right)
    neighbours = nearest_neighbours(left.descriptors[rows1], right.descriptors[rows2], 2)
    if neighbours.rows.shape[1] < 2:
        return keypoint_matches(left, right, rows1[:0], rows2[:0], np.zeros(0))
    i1, i2, ratios = neighbours.mutual()
    keep = ratios < ratio
    return keypoint_matches(left, right, rows1[i1[keep]], rows2[i2[keep]], 1 - ratios[keep])


_KDTREE, _TREES, _CHECKS = 1, 4, 200


def match_kdtree(left: Features, right: Features, *, ratio: float = 0.8, seed: int = 0) -> Matches:
    """Match nearest neighbours of the plain views (k-d trees); `probability` is 1 - first/second distance, only a ranking.

    Parameters
    ----------
    left, right : keypoints of the pair; those of compressed views are left out.
    ratio : largest ratio of first to second descriptor distance; no unit.
    seed : seed of the trees' random splits.
    """
    rows1, rows2 = plain_rows(left), plain_rows(right)
    pairs = []
    if len(rows1) and len(rows2) >= 2:
        cv2.setRNGSeed(seed)
        matcher = cv2.FlannBasedMatcher({"algorithm": _KDTREE, "trees": _TREES}, {"checks": _CHECKS})
        pairs = [pair for pair in matcher.knnMatch(left.descriptors[rows1], right.descriptors[rows2], 2) if len(pair) == 2]
    i1 = np.array([a.queryIdx for a, _ in pairs], np.int32)
    i2 = np.array([a.trainIdx for a, _ in pairs], np.int32)
    ratios = np.array([a.distance / max(b.distance, 1e-9) for a, b in pairs], np.float32)
    keep = ratios < ratio
    return keypoint_matches(left, right, rows1[i1[keep]], rows2[i2[keep]], 1 - ratios[keep].astype(np.float64))

"""Evidence from one night's keypoints for a geometry that was pooled from many nights.

Nights of the same scene are not independent evidence: look-alikes recur every night, and recurring matches agree with each other
whether they are right or not.  Pooling makes the geometry more exact, but whether it is right is judged from the descriptors of
one night, as for any pair: how distinctive the matches around it are, whether the clear ones agree with it, and which rival
poses the two cameras have.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..core.nearest_points import nearest_points
from ..matching.candidates import searched_view_pairs, view_pairs
from ..matching.matcher import keypoint_matches
from ..matching.structural import match_guided
from ..types import Features, Float64s, Int32s, Matches
from .pair_evidence import pair_evidence
from .pair_score import PairEvidence
from .robust import TwoView, supporters

NEAR_PX = 2.0
"""A keypoint within this distance of a pooled match's point represents it: nights differ by noise."""
SAME_PX = 1.5
"""A match of the night equals a pooled one if the Euclidean distance of their four coordinates is at most this."""
FEWEST = 8
"""Fewest matches of a night that count as evidence."""


def matches_of_night(inliers: Matches, F: Float64s, left: Features, right: Features) -> Matches:
    """Match the keypoints of one night around a pooled geometry.

    Parameters
    ----------
    inliers : the pooled matches that agree with F.
    F : (3, 3) the geometry.
    left, right : keypoints of the two cameras in that night.
    """
    i1 = _keypoint_at(left, inliers.x1)
    i2 = _keypoint_at(right, inliers.x2)
    is_found = (i1 >= 0) & (i2 >= 0)
    pairs = view_pairs(left, right, inliers.tilted)
    probability = inliers.probability[is_found].astype(np.float64)
    seeds = keypoint_matches(left, right, i1[is_found], i2[is_found], probability, tilted=inliers.tilted, searched=pairs)
    return match_guided(seeds, left, right, F)


def _keypoint_at(features: Features, x: Float64s) -> Int32s:
    """(n,) row of the nearest keypoint to each position, -1 if none is within `NEAR_PX`."""
    distance, row = nearest_points(features.xy, x, 1)
    return np.where(distance.ravel() <= NEAR_PX, row.ravel(), -1).astype(np.int32)


def with_night(pooled: Matches, night: Matches) -> Matches:
    """The pooled matches, and those of a night that are new."""
    is_new = np.zeros(len(night.x1), bool)
    if len(night.x1):  # a tree rejects an empty query
        tree = cKDTree(np.hstack([pooled.x1, pooled.x2]))
        distance, _ = tree.query(np.hstack([night.x1, night.x2]))
        is_new = distance > SAME_PX
    return replace(
        pooled,
        x1=np.vstack([pooled.x1, night.x1[is_new]]),
        x2=np.vstack([pooled.x2, night.x2[is_new]]),
        probability=np.concatenate([pooled.probability, night.probability[is_new]]),
    )


def pooled_evidence(
    own: PairEvidence, night: Matches, found: TwoView, left: Features, right: Features, threshold_px: float, seed: int = 0
) -> PairEvidence:
    """Evidence for a pooled geometry: inliers, angle and half rotation from the pool, the rest from a night's keypoints.

    Parameters
    ----------
    own : evidence from the pooled matches alone.
    night : the night's matches around the geometry.
    found : the geometry.
    left, right : keypoints of the night.
    threshold_px : noise of a correct match, pixels.
    seed : random seed.
    """
    keep = supporters(found.F, night.x1, night.x2, threshold_px)
    if night.i1 is None or night.i2 is None or keep.sum() < FEWEST:
        return replace(own, distinct_cells=0, distinct_share=0.0, agreement=0.0)
    pairs = searched_view_pairs(night, left, right)
    evidence = pair_evidence(left, right, pairs, night.i1[keep], night.i2[keep], found, seed)
    rival = evidence.rival
    if rival is not None:
        # the score compares the rival's inliers with the pair's, of which the pool has more than a night
        ratio = own.inliers / evidence.inliers
        rival = replace(rival, inliers=round(ratio * rival.inliers), elsewhere=round(ratio * rival.elsewhere))
    return replace(evidence, inliers=own.inliers, half_rotation_deg=own.half_rotation_deg, angle_deg=own.angle_deg, rival=rival)

"""Point correspondences of a pair: one matcher by name, its result as `Matches`."""

from __future__ import annotations

from typing import Literal

import numpy as np

from .features import PLAIN
from .matching.kdtree import kdtree_matches
from .matching.mutual import mutual_matches
from .types import Features, Float32s, Int32s, Matches, Rejected

Matcher = Literal["mutual", "kdtree"]


def match(
    left: Features,
    right: Features,
    *,
    matcher: Matcher = "mutual",
    ratio: float = 0.8,
    min_matches: int = 8,
    seed: int = 0,
) -> Matches | Rejected:
    """Match the keypoints of two frames by their descriptors and the pattern they form.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    matcher : "mutual" (mutual nearest neighbours under `ratio` both ways) or "kdtree" (Lowe's, through FLANN).
    ratio : nearest distance over second nearest, at most; no unit.
    min_matches : fewer than this reject the pair.
    seed : of the random kd-trees.

    Returns
    -------
    Matches, or Rejected when there are too few to say anything.
    """
    plain1, plain2 = np.flatnonzero(left.tilts == PLAIN), np.flatnonzero(right.tilts == PLAIN)
    d1, d2 = left.descriptors[plain1], right.descriptors[plain2]
    i1, i2, ratios = mutual_matches(d1, d2, ratio) if matcher == "mutual" else kdtree_matches(d1, d2, ratio, seed)
    if len(i1) < min_matches:
        return Rejected(f"{len(i1)} matches, {min_matches} needed", {"matches": len(i1)})
    i1, i2 = plain1[i1].astype(np.int32), plain2[i2].astype(np.int32)
    return _matches(left, right, i1, i2, 1 - ratios, matcher, tilted=False)


def _matches(
    left: Features, right: Features, i1: Int32s, i2: Int32s, probability: Float32s, matcher: str, *, tilted: bool
) -> Matches:
    affine = right.frames[i2] @ np.linalg.inv(left.frames[i1])
    p = np.asarray(probability, dtype=np.float32)
    return Matches(left.xy[i1], right.xy[i2], i1, i2, p, affine, left.view, right.view, matcher, tilted)

"""Point correspondences of a pair: one matcher by name, its result as `Matches`."""

from __future__ import annotations

from typing import Literal

import numpy as np

from .features import PLAIN, TILTED
from .matching.kdtree import kdtree_matches
from .matching.mutual import mutual_matches
from .matching.procrustes import feature_matrix, literal_dominance, nearest_dominance, procrustes
from .matching.structural import structural_matches
from .reasons import Reason, Rejected
from .types import Features, Float64s, Int32s, Matches

Matcher = Literal["structural", "dominant", "literal", "mutual", "kdtree"]
Tilt = Literal["auto", "never", "always"]


def match(
    left: Features,
    right: Features,
    *,
    matcher: Matcher = "structural",
    dominance: float = 0.8,
    neighbours: int = 7,
    rounds: int = 4,
    tilt: Tilt = "auto",
    weak_matches: int = 300,
    ratio: float = 0.8,
    min_matches: int = 8,
    seed: int = 0,
) -> Matches | Rejected:
    """Match the keypoints of two frames by their descriptors and the pattern they form.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    matcher : "structural" (descriptors and local affine structure together); for study "literal" (the source's section 3.3.2 to
        the letter) and "dominant" (the same with a dominance test that can fire); rivals "mutual" (mutual nearest neighbours
        under `ratio` both ways) and "kdtree" (Lowe's, through FLANN).
    dominance : structural and literal: odds of an accepted match against all its rivals together, at least; no unit. More is
        stricter: 0.8 keeps what is more likely right than wrong, 9 keeps what is right nine times in ten.
    neighbours : structural: candidates that each keypoint proposes.
    rounds : structural: rounds of expectation and maximisation.
    tilt : structural: bring in the views compressed in x: "auto" where the plain views give fewer than `weak_matches`.
    weak_matches : plain matches under which "auto" brings in the compressed views.
    ratio : mutual, kdtree and dominant: best rival over best, at most; no unit.
    min_matches : fewer than this reject the pair.
    seed : of the random kd-trees.

    Returns
    -------
    Matches, or Rejected when there are too few to say anything.

    References
    ----------
    W. Hao, wide-baseline stereo, 2011, chapter 3.
    """
    tilted = False
    if matcher == "structural":
        i1, i2, probability, tilted = _structural(left, right, dominance, neighbours, rounds, tilt, weak_matches)
    else:
        i1, i2, probability = _plain(left, right, matcher, dominance, ratio, seed)
    if len(i1) < min_matches:
        return Rejected(Reason.TOO_FEW_MATCHES, {"matches": len(i1), "needed": min_matches})
    affine = right.frames[i2] @ np.linalg.inv(left.frames[i1])
    p = probability.astype(np.float32)
    return Matches(left.xy[i1], right.xy[i2], i1, i2, p, affine, left.view, right.view, matcher, tilted)


def _structural(
    left: Features, right: Features, dominance: float, neighbours: int, rounds: int, tilt: Tilt, weak_matches: int
) -> tuple[Int32s, Int32s, Float64s, bool]:
    """Plain views first; the compressed ones too where they are asked for, or needed."""
    possible = tilt != "never" and bool((left.tilts == TILTED).any() or (right.tilts == TILTED).any())
    if not (possible and tilt == "always"):
        found = structural_matches(left, right, dominance=dominance, neighbours=neighbours, rounds=rounds)
        if not possible or len(found.i1) >= weak_matches:
            return found.i1, found.i2, found.probability, False
    found = structural_matches(left, right, tilted=True, dominance=dominance, neighbours=neighbours, rounds=rounds)
    return found.i1, found.i2, found.probability, True


def _plain(
    left: Features, right: Features, matcher: Matcher, dominance: float, ratio: float, seed: int
) -> tuple[Int32s, Int32s, Float64s]:
    """The matchers that know one view only; `probability` is 1 - best rival / best, an order, not a frequency."""
    rows1 = np.flatnonzero(left.tilts == PLAIN).astype(np.int32)
    rows2 = np.flatnonzero(right.tilts == PLAIN).astype(np.int32)
    d1, d2 = left.descriptors[rows1], right.descriptors[rows2]
    if matcher == "mutual":
        i1, i2, rivalry = mutual_matches(d1, d2, ratio)
    elif matcher == "kdtree":
        i1, i2, rivalry = kdtree_matches(d1, d2, ratio, seed)
    elif min(len(d1), len(d2)) < 2:
        return rows1[:0], rows2[:0], np.zeros(0)
    else:
        P = procrustes(feature_matrix(left, rows1), feature_matrix(right, rows2)).matrix()
        if matcher == "dominant":
            i1, i2, rivalry = nearest_dominance(P, ratio)
        else:
            found1, found2 = np.nonzero(literal_dominance(P, dominance))
            i1, i2, rivalry = found1.astype(np.int32), found2.astype(np.int32), np.zeros(len(found1), np.float32)
    return rows1[i1], rows2[i2], 1 - rivalry.astype(np.float64)

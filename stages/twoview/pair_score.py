"""Score of a pair: how likely its geometry is right, from the pair's own evidence.

Look-alike windows seen from opposite sides give a hundred or more matches that agree with one F, so the number of inliers does
not separate right pairs from wrong ones.  What does: whether the matches are *distinctive* (no rival in the other image, no
look-alike in their own) and cover the image; whether the clearest matches, found before any geometry, also agree with F; whether
both halves of the inliers give the same rotation; and how stretched the local affine maps are (wrong pairs join similar views).

Pairs that remain undecided on their own are decided by the whole site (`sfm.loops`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, log

import numpy as np

from ..core.cameras import field_ratio, ray_angles
from ..core.epipolar import homogeneous, symmetric_epipolar_distance
from ..core.rotations import angle_between_deg
from ..matching.affine_field import fit_affine_field
from ..matching.candidates import ViewPair, rival_distances
from ..matching.neighbours import nearest_lookalike
from ..types import Features, Float32s, Float64s, Int32s, Matches, View
from .ambiguity import Ambiguity, find_ambiguity
from .image_grid import covered_cells
from .robust import TwoView, estimate_essential

DISTINCT_FROM_RIVALS, DISTINCT_FROM_LOOKALIKES = 0.85, 0.95
"""A match is distinctive if its descriptor distance is below these shares of its nearest rival's and nearest look-alike's."""
CLEAR_RATIO, CLEAR_PX = 0.9, 2.0
"""Clear matches are mutual nearest neighbours with a distance ratio below the first; they agree with F within the second (px)."""
DISTINCT_CELLS = 20
"""Distinctive matches in this many grid cells show the same structure in both images, if perhaps at another place: in scenes
without repetition, no three such pairs contradict each other (`scripts/bench_verdict.py`: at most 7 cells, in 484 triangles)."""
LEAST_PROBABILITY = 0.5
"""Probability from which a match without keypoints counts as distinctive, and as clear."""


@dataclass(frozen=True)
class PairEvidence:
    """Inputs of the score; described in `Geometry`."""

    inliers: int
    distinct_cells: int
    distinct_share: float
    agreement: float
    half_rotation_deg: float
    stretch: float
    angle_deg: float = float("nan")
    """Median angle between the rays of the inliers, nan without a pose."""
    rival: Ambiguity | None = None
    """The best competing pose; None if none was searched for, without a pose or without keypoints."""


NO_BASELINE_DEG, LEAST_AGREEMENT = 1.0, 0.8
"""Both cameras seem to be at one place if the ray angle is below the first (degrees) and the agreement is at least the second."""
WEIGHTS, OFFSET = (0.89, 0.90, 3.37, 1.20, 2.91, 3.68, -0.27, -1.15), -15.3
"""Weights of the `terms`, fitted by `scripts/bench_verdict.py` on 299 pairs of 13 sets, photographed and rendered, most with
look-alikes.  Each scene has the same weight, and the fit is drawn toward the weights of an earlier one (walls and a courtyard).
Exact copies of a building count as right, since no single pair can distinguish them."""


def terms(e: PairEvidence) -> tuple[float, ...]:
    """Terms of the score of a pair with a pose and a search for rivals; the last two count against the pair, the rest for it."""
    rivals = 0 if e.rival is None else e.rival.inliers
    return (
        log(1 + e.distinct_cells),
        e.distinct_share,
        e.agreement,
        log(1 + e.inliers),
        log(e.stretch + 0.01),
        log(min(e.angle_deg, 15.0) + 0.3),
        log(e.half_rotation_deg + 0.01),
        log((rivals + 20) / (e.inliers + 20)),
    )


def pair_evidence(
    left: Features, right: Features, pairs: tuple[ViewPair, ...], i1: Int32s, i2: Int32s, found: TwoView, seed: int = 0
) -> PairEvidence:
    """Evidence from the inliers of a pair with keypoints.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    pairs : their view pairs, from `matching.candidates.view_pairs`.
    i1, i2 : (n,) int32, rows of the inliers in the features.
    found : the geometry.
    seed : random seed for the poses of the two halves and of rivals.
    """
    x1, x2 = left.xy[i1], right.xy[i2]
    dots = np.einsum("nd,nd->n", left.descriptors[i1], right.descriptors[i2]).astype(np.float64)
    distance = np.sqrt(np.maximum(2 - 2 * dots, 1e-9))
    rival_ratio = distance / np.maximum(rival_distances(left, right, pairs, i1, i2), 1e-6)
    lookalike_ratio = distance / np.maximum(np.minimum(_lookalike_distances(left, i1), _lookalike_distances(right, i2)), 1e-6)
    distinct = (rival_ratio < DISTINCT_FROM_RIVALS) & (lookalike_ratio < DISTINCT_FROM_LOOKALIKES)
    return PairEvidence(
        inliers=len(i1),
        distinct_cells=_distinct_cells(x1[distinct], x2[distinct], left.view, right.view),
        distinct_share=float((lookalike_ratio < DISTINCT_FROM_LOOKALIKES).mean()),
        agreement=_agreement(pairs, found.F),
        half_rotation_deg=_half_rotation_deg(x1, x2, left.view, right.view, seed),
        stretch=_stretch(x1, x2, right.frames[i2] @ np.linalg.inv(left.frames[i1])),
        angle_deg=ray_angle_deg(x1, x2, left.view, right.view, found.R),
        rival=None if found.R is None else find_ambiguity(left, right, pairs, i1, i2, found, seed),
    )


def point_evidence(before: Matches, inliers: Matches, found: TwoView, seed: int = 0) -> PairEvidence:
    """Evidence from matches without keypoints, where the matcher's probabilities replace descriptors.

    Inliers with a probability of 0.5 or more count as distinctive, and such matches of `before` as clear.

    Parameters
    ----------
    before : all matches from which the geometry was estimated.
    inliers : the matches that agree with it.
    found : the geometry.
    seed : random seed.
    """
    x1, x2 = inliers.x1, inliers.x2
    distinct = inliers.probability >= LEAST_PROBABILITY
    clear = before.probability >= LEAST_PROBABILITY
    distance = symmetric_epipolar_distance(found.F, before.x1[clear], before.x2[clear])
    return PairEvidence(
        inliers=len(x1),
        distinct_cells=_distinct_cells(x1[distinct], x2[distinct], inliers.view1, inliers.view2),
        distinct_share=float(distinct.mean()),
        agreement=_share_near(distance),
        half_rotation_deg=_half_rotation_deg(x1, x2, inliers.view1, inliers.view2, seed),
        stretch=_stretch(x1, x2, None),
        angle_deg=ray_angle_deg(x1, x2, inliers.view1, inliers.view2, found.R),
    )


def _lookalike_distances(features: Features, rows: Int32s) -> Float32s:
    """Descriptor distance (n,) of keypoints, given by their rows, to the most similar one elsewhere in their own image."""
    known = features.lookalikes
    if not len(known):
        return nearest_lookalike(features.descriptors, features.xy, len(features.xy))[rows]
    is_known = rows < len(known)
    distances = np.empty(len(rows), np.float32)
    distances[is_known] = known[rows[is_known]]
    if is_known.all():
        return distances
    queried = np.concatenate([np.arange(len(known)), rows[~is_known]])
    distances[~is_known] = nearest_lookalike(features.descriptors[queried], features.xy[queried], len(known), begin=len(known))
    return distances


def pair_score(evidence: PairEvidence, contradicted: bool = False) -> float:
    """Log odds that the geometry is right.

    contradicted: the intrinsics contradict F.  The score is then at most 0, as it is if a rival pose has much support.
    With K and a search for rivals, `WEIGHTS` apply.  The weights for the other cases were fitted by logistic regression on 263
    labelled pairs of four scenes, 118 of them wrong; 5 are misclassified.
    """
    e = evidence
    cells, inliers, stretch = log(1 + e.distinct_cells), log(1 + e.inliers), log(e.stretch + 0.01)
    if isfinite(e.half_rotation_deg) and isfinite(e.angle_deg) and e.rival is not None:
        score = sum(weight * term for weight, term in zip(WEIGHTS, terms(e), strict=True)) + OFFSET
    elif isfinite(e.half_rotation_deg):
        halves = log(e.half_rotation_deg + 0.01)
        score = 0.54 * cells + 8.9 * e.distinct_share + 4.8 * e.agreement + 2.7 * stretch + 0.53 * inliers - 0.84 * halves - 4.0
    else:
        score = 0.9 * cells + 12.0 * e.distinct_share + 5.5 * e.agreement + 3.0 * stretch + 0.6 * inliers - 6.5
    ambiguous = e.rival is not None and e.rival.ambiguous(e.inliers)
    return min(score, 0.0) if contradicted or ambiguous else score


def hardly_converging(angle_deg: float, agreement: float) -> bool:
    """Whether the clear matches agree but the rays are too nearly parallel (degrees; nan if unknown) to determine the pose: it is
    not the matches that are in doubt."""
    return angle_deg < NO_BASELINE_DEG and agreement >= LEAST_AGREEMENT


def informs_about_site(evidence: PairEvidence) -> bool:
    """Whether a rejected pair whose cameras seem to be at one place is still informative about its site: either that they are at
    one place, or, if as distinctive as right pairs, that the scene looks the same from several sides."""
    e = evidence
    return hardly_converging(e.angle_deg, e.agreement) or (e.angle_deg < NO_BASELINE_DEG and e.distinct_cells >= DISTINCT_CELLS)


def probability(score: float) -> float:
    """Log odds as a probability."""
    return 1 / (1 + exp(-max(min(score, 30.0), -30.0)))


def _distinct_cells(x1: Float64s, x2: Float64s, view1: View, view2: View) -> int:
    """Number of cells that hold a point, in the image with fewer of them.

    The wider view gets more cells, by the ratio of the fields of view: a long lens fills few of these, but all of its own.
    """
    ratio = field_ratio(view1, view2)
    size1, size2 = (view1.width, view1.height), (view2.width, view2.height)
    return min(covered_cells(x1, size1, max(ratio, 1.0)), covered_cells(x2, size2, max(1 / ratio, 1.0)))


def _agreement(pairs: tuple[ViewPair, ...], F: Float64s) -> float:
    """Share of the clear matches of the plain views that lie on their epipolar lines; shrunk toward 0 if they are few."""
    if not pairs:
        return 0.0
    i, j, ratio = pairs[0].candidates.near.mutual()
    clear = ratio < CLEAR_RATIO
    distance = symmetric_epipolar_distance(F, pairs[0].x1[i[clear]], pairs[0].x2[j[clear]])
    return _share_near(distance)


def _share_near(distance: Float64s) -> float:
    """Share of the matches within `CLEAR_PX` of their epipolar lines; shrunk toward 0 if they are few."""
    return float(((distance < CLEAR_PX).sum() + 0.5) / (len(distance) + 5))


def _stretch(x1: Float64s, x2: Float64s, affine: Float64s | None) -> float:
    """Median log axis ratio of the local affine maps, each fitted to the neighbours of a match without the match itself.

    affine: (n, 2, 2) maps from the keypoints' frames, None without keypoints.
    """
    maps, ridge = (np.zeros((len(x1), 2, 2)), 0.0) if affine is None else (affine, 2.0)
    field = fit_affine_field(x1, x2, maps, np.ones(len(x1)), x1, neighbours=16, ridge=ridge)
    axes = np.linalg.svd(field.affine, compute_uv=False)
    return float(np.median(np.log(axes[:, 0] / np.maximum(axes[:, 1], 1e-3))))


def _half_rotation_deg(x1: Float64s, x2: Float64s, view1: View, view2: View, seed: int) -> float:
    """Angle in degrees between the rotations estimated from the two halves of the inliers; nan without K, 180 without a pose."""
    if view1.K is None or view2.K is None or not (view1.focal_known and view2.focal_known):
        return float("nan")
    centred = x1 - x1.mean(axis=0)
    coordinate = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]  # along the largest spread
    is_first = coordinate < np.median(coordinate)
    poses = [estimate_essential(x1[h], x2[h], view1, view2, 1.0, seed, max_iterations=300) for h in (is_first, ~is_first)]
    if poses[0] is None or poses[1] is None or poses[0].R is None or poses[1].R is None:
        return 180.0
    return angle_between_deg(poses[1].R, poses[0].R)


def ray_angle_deg(x1: Float64s, x2: Float64s, view1: View, view2: View, R: Float64s | None) -> float:
    """Median angle in degrees between the two rays of each correspondence; nan without R or K.

    Parameters
    ----------
    x1, x2 : (n, 2) pixels.
    view1, view2 : size and intrinsics of the images.
    R : (3, 3) relative rotation; None if unknown.
    """
    if R is None or view1.K is None or view2.K is None:
        return float("nan")
    ray1 = homogeneous(x1) @ np.linalg.inv(view1.K).T @ R.T
    ray2 = homogeneous(x2) @ np.linalg.inv(view2.K).T
    return float(np.degrees(np.median(ray_angles(ray1, ray2))))

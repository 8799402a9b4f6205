"""Is a pair to be believed?  A score for each pair, from its own evidence.

Look-alike windows seen from opposite sides give a hundred and more matches that agree with one F: no count of inliers tells them
from the truth.  What does: whether the matches are *distinctive* (no rival in the other image, no look-alike in their own) and
cover the image; whether the clearest matches, found before any geometry, agree with it too; whether the two halves of the
inliers tell the same pose; and how much the local maps are stretched (aliases are found where views look alike).

What a pair alone leaves open is settled by the site (`sfm.loops`).
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
from ..matching.neighbours import nearest_elsewhere
from ..types import Features, Float32s, Float64s, Int32s, Matches, View
from .ambiguity import Ambiguity, find_ambiguity
from .image_grid import places
from .robust import TwoView, estimate_essential

DISTINCT_FROM_RIVALS, DISTINCT_FROM_LOOKALIKES = 0.85, 0.95
"""A match is distinctive where its descriptor distance is below this share of the nearest rival's and look-alike's."""
CLEAR_RATIO, CLEAR_PX = 0.9, 2.0
"""Clear matches: mutual nearest under this ratio, without geometry; they agree with F within so many pixels."""
DISTINCT_CELLS = 20
"""A pair with distinctive matches in so many cells of the grid shows the same thing in both images, if not the same place: where
scenes don't repeat, no three such pairs contradict each other (`scripts/bench_verdict.py`: at most 7 cells, in 484 triangles)."""
LIKELY = 0.5
"""A match without keypoints counts as distinctive from this probability on."""


@dataclass(frozen=True)
class PairEvidence:
    """What the score is made of; described in `Geometry`."""

    inliers: int
    distinct_cells: int
    distinct_share: float
    agreement: float
    half_rotation_deg: float
    stretch: float
    angle_deg: float = float("nan")
    """Median angle between the rays, nan without a pose."""
    rival: Ambiguity | None = None
    """The best other hypothesis, None where nobody looked for one: no pose, or no keypoints."""


HARDLY_DEG, MOSTLY = 1.0, 0.8
"""Rays that meet at less, and clear matches of which so many agree: two cameras at one place."""
WEIGHTS, OFFSET = (0.89, 0.90, 3.37, 1.20, 2.91, 3.68, -0.27, -1.15), -15.3
"""Of the `terms`, fitted by `scripts/bench_verdict.py` on 299 pairs of 13 sets, photographed and rendered, look-alikes in most;
each scene with the same weight, drawn to the weights of an earlier fit (walls and a courtyard).  Exact copies of a building
count as right there: no pair tells them apart."""


def terms(e: PairEvidence) -> tuple[float, ...]:
    """What the score of a pair adds up that has a pose, and of which rivals were looked for; all but the last two are for it."""
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
    """Evidence from the inliers of a pair.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    pairs : their views, as `matching.candidates.view_pairs` gives them.
    i1, i2 : (n,) int32, the inliers: rows of the features.
    found : the geometry.
    seed : of the random samples for the halves' poses.
    """
    x1, x2 = left.xy[i1], right.xy[i2]
    dots = np.einsum("nd,nd->n", left.descriptors[i1], right.descriptors[i2]).astype(np.float64)
    distance = np.sqrt(np.maximum(2 - 2 * dots, 1e-9))
    rivalry = distance / np.maximum(rival_distances(left, right, pairs, i1, i2), 1e-6)
    likeness = distance / np.maximum(np.minimum(_lookalikes(left, i1), _lookalikes(right, i2)), 1e-6)
    distinct = (rivalry < DISTINCT_FROM_RIVALS) & (likeness < DISTINCT_FROM_LOOKALIKES)
    return PairEvidence(
        inliers=len(i1),
        distinct_cells=_distinct_cells(x1[distinct], x2[distinct], left.view, right.view),
        distinct_share=float((likeness < DISTINCT_FROM_LOOKALIKES).mean()),
        agreement=_agreement(pairs, found.F),
        half_rotation_deg=_half_rotation_deg(x1, x2, left.view, right.view, seed),
        stretch=_stretch(x1, x2, right.frames[i2] @ np.linalg.inv(left.frames[i1])),
        angle_deg=ray_angle_deg(x1, x2, left.view, right.view, found.R),
        rival=None if found.R is None else find_ambiguity(left, right, pairs, i1, i2, found, seed),
    )


def point_evidence(before: Matches, inliers: Matches, found: TwoView, seed: int = 0) -> PairEvidence:
    """The same for points that are no keypoints, in which the matcher's word stands for what descriptors tell.

    A match of probability 0.5 and more counts as distinctive, and so do those `before` geometry as clear.

    Parameters
    ----------
    before : all matches that the geometry was estimated from.
    inliers : those that agree with it.
    found : the geometry.
    seed : of the samples.
    """
    x1, x2 = inliers.x1, inliers.x2
    distinct = inliers.probability >= LIKELY
    clear = before.probability >= LIKELY
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


def _lookalikes(features: Features, rows: Int32s) -> Float32s:
    """Distance of some keypoints (n,) to the most similar one elsewhere in their own image."""
    known = features.lookalikes
    if not len(known):
        return nearest_elsewhere(features.descriptors, features.xy, len(features.xy))[rows]
    plain = rows < len(known)
    found = np.empty(len(rows), np.float32)
    found[plain] = known[rows[plain]]
    if plain.all():
        return found
    asking = np.concatenate([np.arange(len(known)), rows[~plain]])
    found[~plain] = nearest_elsewhere(features.descriptors[asking], features.xy[asking], len(known), begin=len(known))
    return found


def pair_score(evidence: PairEvidence, contradicted: bool = False) -> float:
    """Log odds that the geometry is right.

    contradicted: the intrinsics contradict F, or another pose has as much support; such a pair is never believed on its own.
    With K and rivals: see `WEIGHTS`.  Without either, fitted by logistic regression on 263 labelled pairs of four scenes, 118 of
    them wrong; 5 fall on the wrong side.
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
    """The clear matches of a pair agree, but its rays are so near to parallel (degrees; nan: unknown) that no pose can be told:
    what speaks against it is not its matches."""
    return angle_deg < HARDLY_DEG and agreement >= MOSTLY


def tells_the_site(evidence: PairEvidence) -> bool:
    """Does a pair that is not believed, since its cameras seem to be at one place, say something of its site all the same: that
    they are, or, as distinct as right pairs are, that the scene looks the same from several sides?"""
    e = evidence
    return hardly_converging(e.angle_deg, e.agreement) or (e.angle_deg < HARDLY_DEG and e.distinct_cells >= DISTINCT_CELLS)


def probability(score: float) -> float:
    """Log odds as a probability."""
    return 1 / (1 + exp(-max(min(score, 30.0), -30.0)))


def _distinct_cells(x1: Float64s, x2: Float64s, view1: View, view2: View) -> int:
    """How many cells hold a point, in the image where they are fewer.

    A wide view has as many more cells as it sees more than a narrow one: a long lens sees a few cells of it, and all of its own.
    """
    more = field_ratio(view1, view2)
    size1, size2 = (view1.width, view1.height), (view2.width, view2.height)
    return min(places(x1, size1, max(more, 1.0)), places(x2, size2, max(1 / more, 1.0)))


def _agreement(pairs: tuple[ViewPair, ...], F: Float64s) -> float:
    """Share of the clear matches of the plain views that lie on their epipolar lines; shrunk toward 0 where they are few."""
    if not pairs:
        return 0.0
    i, j, ratio = pairs[0].candidates.near.mutual()
    clear = ratio < CLEAR_RATIO
    distance = symmetric_epipolar_distance(F, pairs[0].x1[i[clear]], pairs[0].x2[j[clear]])
    return _share_near(distance)


def _share_near(distance: Float64s) -> float:
    """Share of the matches at most `CLEAR_PX` from their epipolar lines; shrunk toward 0 where they are few."""
    return float(((distance < CLEAR_PX).sum() + 0.5) / (len(distance) + 5))


def _stretch(x1: Float64s, x2: Float64s, affine: Float64s | None) -> float:
    """Median log ratio of the axes of the local maps, each fitted to the neighbours of a match without itself.

    affine: (n, 2, 2) what the keypoints' frames say of the maps, None where there are no keypoints.
    """
    maps, ridge = (np.zeros((len(x1), 2, 2)), 0.0) if affine is None else (affine, 2.0)
    field = fit_affine_field(x1, x2, maps, np.ones(len(x1)), x1, neighbours=16, ridge=ridge)
    axes = np.linalg.svd(field.affine, compute_uv=False)
    return float(np.median(np.log(axes[:, 0] / np.maximum(axes[:, 1], 1e-3))))


def _half_rotation_deg(x1: Float64s, x2: Float64s, view1: View, view2: View, seed: int) -> float:
    """Angle between the rotations that the two halves of the inliers tell; nan without K."""
    if view1.K is None or view2.K is None or not (view1.focal_known and view2.focal_known):
        return float("nan")
    centred = x1 - x1.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]  # their longest spread
    first = along < np.median(along)
    poses = [estimate_essential(x1[h], x2[h], view1, view2, 1.0, seed, max_iterations=300) for h in (first, ~first)]
    if poses[0] is None or poses[1] is None or poses[0].R is None or poses[1].R is None:
        return 180.0
    return angle_between_deg(poses[1].R, poses[0].R)


def ray_angle_deg(x1: Float64s, x2: Float64s, view1: View, view2: View, R: Float64s | None) -> float:
    """Median angle between the two rays of each correspondence.

    Parameters
    ----------
    x1, x2 : (n, 2) pixels.
    view1, view2 : size and intrinsics of the images.
    R : (3, 3) relative rotation; None where it is not known.
    """
    if R is None or view1.K is None or view2.K is None:
        return float("nan")
    ray1 = homogeneous(x1) @ np.linalg.inv(view1.K).T @ R.T
    ray2 = homogeneous(x2) @ np.linalg.inv(view2.K).T
    return float(np.degrees(np.median(ray_angles(ray1, ray2))))

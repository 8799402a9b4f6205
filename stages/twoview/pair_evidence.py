"""Evidence for and against a pair's geometry, from its matches: the inputs of `twoview.pair_score`."""

from __future__ import annotations

import numpy as np

from ..core.cameras import field_ratio, ray_angles
from ..core.epipolar import homogeneous, symmetric_epipolar_distance
from ..core.rotations import angle_between_deg
from ..matching.affine_field import fit_affine_field
from ..matching.candidates import ViewPair, rival_distances
from ..matching.local_affines import match_affines
from ..matching.neighbours import nearest_lookalike
from ..types import LEARNED, Features, Float32s, Float64s, Int32s, Matches, View
from .image_grid import covered_cells
from .pair_score import PairEvidence
from .rival_search import find_rival
from .robust import TwoView, estimate_essential

DISTINCT_FROM_RIVALS = 0.85
"""A match is distinctive only if its descriptor distance is below this share of its nearest rival's in the other image."""
DISTINCT_FROM_LOOKALIKES = 0.95
"""A match is distinctive only if its descriptor distance is below this share of the distance between one of its keypoints and
that keypoint's nearest look-alike in its own image."""
CLEAR_RATIO = 0.9
"""Clear matches are mutual nearest neighbours whose distance ratio to the second nearest is below this."""
CLEAR_PX = 2.0
"""Clear matches agree with F if they lie within this distance of their epipolar lines, pixels."""
LEAST_PROBABILITY = 0.5
"""Probability from which a match without keypoints counts as distinctive, and as clear."""


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
    x1 = left.xy[i1]
    x2 = right.xy[i2]
    # descriptors have unit length, so their squared distance is 2 - 2 cos; the bounds keep the ratios below finite
    cosines = np.einsum("nd,nd->n", left.descriptors[i1], right.descriptors[i2]).astype(np.float64)
    distance = np.sqrt(np.maximum(2 - 2 * cosines, 1e-9))
    rival_ratio = distance / np.maximum(rival_distances(left, right, pairs, i1, i2), 1e-6)
    nearest_lookalikes = np.minimum(_lookalike_distances(left, i1), _lookalike_distances(right, i2))
    lookalike_ratio = distance / np.maximum(nearest_lookalikes, 1e-6)
    is_distinct = (rival_ratio < DISTINCT_FROM_RIVALS) & (lookalike_ratio < DISTINCT_FROM_LOOKALIKES)
    return PairEvidence(
        inliers=len(i1),
        distinct_cells=_distinct_cells(x1[is_distinct], x2[is_distinct], left.view, right.view),
        distinct_share=float((lookalike_ratio < DISTINCT_FROM_LOOKALIKES).mean()),
        agreement=_agreement(pairs, found.F),
        half_rotation_deg=_half_rotation_deg(x1, x2, left.view, right.view, seed),
        stretch=_stretch(x1, x2, match_affines(left, right, i1, i2)),
        angle_deg=ray_angle_deg(x1, x2, left.view, right.view, found.R),
        rival=None if found.R is None else find_rival(left, right, pairs, i1, i2, found, seed),
        has_frames=float((left.tilts[i1] >= LEARNED).mean()) <= 0.5,
    )


def point_evidence(before: Matches, inliers: Matches, found: TwoView, seed: int = 0) -> PairEvidence:
    """Evidence from matches without keypoints, where the matcher's probabilities replace descriptors.

    Inliers with a probability of `LEAST_PROBABILITY` or more count as distinctive, and such matches of `before` as clear.

    Parameters
    ----------
    before : all matches from which the geometry was estimated.
    inliers : the matches that agree with it.
    found : the geometry.
    seed : random seed.
    """
    x1 = inliers.x1
    x2 = inliers.x2
    is_distinct = inliers.probability >= LEAST_PROBABILITY
    is_clear = before.probability >= LEAST_PROBABILITY
    distance = symmetric_epipolar_distance(found.F, before.x1[is_clear], before.x2[is_clear])
    return PairEvidence(
        inliers=len(x1),
        distinct_cells=_distinct_cells(x1[is_distinct], x2[is_distinct], inliers.view1, inliers.view2),
        distinct_share=float(is_distinct.mean()),
        agreement=_share_near(distance),
        half_rotation_deg=_half_rotation_deg(x1, x2, inliers.view1, inliers.view2, seed),
        stretch=_stretch(x1, x2, None),
        angle_deg=ray_angle_deg(x1, x2, inliers.view1, inliers.view2, found.R),
    )


def _lookalike_distances(features: Features, rows: Int32s) -> Float32s:
    """Descriptor distance (n,) of keypoints, given by their rows, to the most similar one elsewhere in their own image."""
    stored = features.lookalikes
    if not len(stored):
        return nearest_lookalike(features.descriptors, features.xy, len(features.xy))[rows]
    # Distances are stored for the first keypoints only, those of the plain view.
    is_stored = rows < len(stored)
    distances = np.empty(len(rows), np.float32)
    distances[is_stored] = stored[rows[is_stored]]
    if is_stored.all():
        return distances
    # The others are compared with the same keypoints, not with each other: those are the rows before `begin`.
    compared = np.concatenate([np.arange(len(stored)), rows[~is_stored]])
    distances[~is_stored] = nearest_lookalike(
        features.descriptors[compared], features.xy[compared], len(stored), begin=len(stored)
    )
    return distances


def _distinct_cells(x1: Float64s, x2: Float64s, view1: View, view2: View) -> int:
    """Number of cells that hold a point, in the image with fewer of them.

    The wider view gets more cells, by the ratio of the fields of view: a long lens fills few of these, but all of its own.
    """
    ratio = field_ratio(view1, view2)
    cells1 = covered_cells(x1, (view1.width, view1.height), max(ratio, 1.0))
    cells2 = covered_cells(x2, (view2.width, view2.height), max(1 / ratio, 1.0))
    return min(cells1, cells2)


def _agreement(pairs: tuple[ViewPair, ...], F: Float64s) -> float:
    """Share of the clear matches of the plain views and of learned keypoints that lie on their epipolar lines; shrunk toward 0 if
    they are few."""
    if not pairs:
        return 0.0
    distances = []
    for pair in (pairs[0], *(other for other in pairs[1:] if not other.has_frames)):
        i, j, ratio = pair.candidates.near.mutual()
        is_clear = ratio < CLEAR_RATIO
        distances.append(symmetric_epipolar_distance(F, pair.x1[i[is_clear]], pair.x2[j[is_clear]]))
    return _share_near(np.concatenate(distances))


def _share_near(distance: Float64s) -> float:
    """Share of the matches within `CLEAR_PX` of their epipolar lines; shrunk toward 0 if they are few."""
    near = (distance < CLEAR_PX).sum()
    return float((near + 0.5) / (len(distance) + 5))


def _stretch(x1: Float64s, x2: Float64s, affine: Float64s | None) -> float:
    """Median log axis ratio of the local affine maps, each fitted to the neighbours of a match without the match itself.

    affine: (n, 2, 2) maps from the keypoints' frames, None without keypoints.
    """
    if affine is None:
        # nothing to draw the maps toward: no ridge
        affine = np.zeros((len(x1), 2, 2))
        ridge = 0.0
    else:
        ridge = 2.0
    field = fit_affine_field(x1, x2, affine, np.ones(len(x1)), x1, neighbours=16, ridge=ridge)
    axes = np.linalg.svd(field.affine, compute_uv=False)
    return float(np.median(np.log(axes[:, 0] / np.maximum(axes[:, 1], 1e-3))))


def _half_rotation_deg(x1: Float64s, x2: Float64s, view1: View, view2: View, seed: int) -> float:
    """Angle in degrees between the rotations estimated from the two halves of the inliers; nan without K, 180 without a pose."""
    if view1.K is None or view2.K is None or not (view1.focal_known and view2.focal_known):
        return float("nan")
    # Halves of a cluster would agree by chance, so the inliers are cut across the direction in which they spread the most.
    centred = x1 - x1.mean(axis=0)
    coordinate = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    is_first = coordinate < np.median(coordinate)
    first = estimate_essential(x1[is_first], x2[is_first], view1, view2, 1.0, seed, max_iterations=300)
    second = estimate_essential(x1[~is_first], x2[~is_first], view1, view2, 1.0, seed, max_iterations=300)
    if first is None or second is None or first.R is None or second.R is None:
        return 180.0
    return angle_between_deg(second.R, first.R)


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
    # both in the axes of camera 2
    rays1 = homogeneous(x1) @ np.linalg.inv(view1.K).T @ R.T
    rays2 = homogeneous(x2) @ np.linalg.inv(view2.K).T
    return float(np.degrees(np.median(ray_angles(rays1, rays2))))

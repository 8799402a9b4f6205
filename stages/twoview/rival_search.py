"""Search for rivals of a pair's geometry: a shift by one period of a repetitive structure, or the view of another side.

Candidates that the accepted geometry explains are removed, and the matcher runs again on the rest.  In a scene without
repetition, the rest is incoherent.  If tiles or whole sides of a building repeat, a second set of matches appears, of the same
keypoints with other partners, and with it a second pose.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..core.epipolar import symmetric_epipolar_distance
from ..core.rotations import angle_between_deg
from ..matching.affine_field import fit_affine_field
from ..matching.assignment import without_repeats
from ..matching.candidates import ViewPair, inverses
from ..matching.local_affines import match_affines
from ..matching.structural import DOMINANCE, ROUNDS, Correspondences, confirmations, solve_rounds
from ..types import Bools, Features, Float64s, Int32s, View
from .image_grid import covered_cells
from .rival_pose import SAME_ROTATION_DEG, TURNED_RIVAL_SHARE, RivalPose
from .robust import MOST_POSED, TwoView, estimate_essential, supporters

EXPLAINED_PX = 12.0
"""A candidate at most this far from where the accepted matches predict its keypoint is no rival, pixels."""
FEWEST_CONFIRMING = 2
"""Neighbours that must confirm an initial match of the rival."""
FEWEST = 8
"""Fewest matches of a rival: with fewer, no pose is estimated."""
FREEDOMS = 5
"""Degrees of freedom of E: inliers in no more grid cells than this fit some pose by chance, as a cell's matches count as one."""
OFF_LINES_PX = 3.0
"""A match farther than this from its accepted epipolar line, pixels, cannot be the same pose with another depth."""
ANOTHER_STEP_DEG = 30.0
"""A rival with the accepted rotation whose baseline differs by more than this, degrees, is another pose even if all its matches
lie on the epipolar lines: the view of another house of a row."""


def find_rival(
    left: Features, right: Features, pairs: tuple[ViewPair, ...], i1: Int32s, i2: Int32s, accepted: TwoView, seed: int = 0
) -> RivalPose:
    """The strongest set of matches apart from the accepted ones.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    pairs : their view pairs, from `matching.candidates.view_pairs`.
    i1, i2 : (n,) int32, rows of the accepted matches in the features.
    accepted : the accepted geometry, with its pose.
    seed : random seed.
    """
    assert accepted.R is not None and accepted.t is not None
    if not pairs:
        return RivalPose()
    # 1. Match what the accepted geometry leaves of the plain views.
    pruned = _without_explained(pairs[0], left, right, i1, i2)
    rivals = solve_rounds(left, right, (pruned,), _initial_matches(pruned), DOMINANCE, ROUNDS, None)
    if rivals is None or len(rivals.i1) < FEWEST:
        return RivalPose()

    # 2. The pose that most of these matches agree with may only shift them along the accepted epipolar lines.
    x1 = left.xy[rivals.i1]
    x2 = right.xy[rivals.i2]
    overall = _strongest_pose(x1, x2, left.view, right.view, accepted.R, accepted.t, seed)

    # 3. So matches off these lines count on their own; too few to make the pair ambiguous need no pose.
    is_off_lines = symmetric_epipolar_distance(accepted.F, x1, x2) > OFF_LINES_PX
    elsewhere = _Pose()
    if is_off_lines.sum() >= TURNED_RIVAL_SHARE * len(i1):
        elsewhere = _strongest_pose(x1[is_off_lines], x2[is_off_lines], left.view, right.view, accepted.R, accepted.t, seed)

    # 4. Unless the overall pose takes another step along a row: its matches may all lie on the lines, yet it is another pose.
    is_another_step = overall.turned_deg < SAME_ROTATION_DEG and overall.step_deg > ANOTHER_STEP_DEG
    if is_another_step and overall.inliers > elsewhere.inliers:
        elsewhere = overall
    return RivalPose(overall.inliers, elsewhere.inliers, elsewhere.turned_deg)


def _without_explained(pair: ViewPair, left: Features, right: Features, i1: Int32s, i2: Int32s) -> ViewPair:
    """The view pair without the candidates near the positions that the accepted matches predict."""
    x1 = left.xy[i1]
    x2 = right.xy[i2]
    candidates = pair.candidates
    # A prediction explains candidates farther away where it is less certain, up to a limit.
    affine = match_affines(left, right, i1, i2)
    field = fit_affine_field(x1, x2, affine, np.ones(len(i1)), pair.x1)
    reach = EXPLAINED_PX + 2 * np.minimum(field.sigma_px, 2 * EXPLAINED_PX)
    is_unexplained = np.linalg.norm(pair.x2[candidates.j] - field.prediction[candidates.i], axis=1) > reach[candidates.i]
    # The field leaves out the match at its own query, so an accepted match explains its own keypoint here.
    accepted_x2 = np.full((len(left.xy), 2), np.inf)
    accepted_x2[i1] = x2
    own_x2 = accepted_x2[pair.rows1]
    is_unexplained &= ~(np.linalg.norm(pair.x2[candidates.j] - own_x2[candidates.i], axis=1) <= EXPLAINED_PX)
    remaining = replace(
        candidates,
        i=candidates.i[is_unexplained],
        j=candidates.j[is_unexplained],
        q=candidates.q[is_unexplained],
    )
    return replace(pair, candidates=remaining)


def _initial_matches(pair: ViewPair) -> Correspondences:
    """Initial matches: candidates that are mutually nearest among the remaining ones, confirmed by their neighbours."""
    candidates = pair.candidates
    mutual = np.flatnonzero(_is_nearest(candidates.i, candidates.q) & _is_nearest(candidates.j, candidates.q))
    i = candidates.i[mutual]
    j = candidates.j[mutual]
    q = candidates.q[mutual]
    x1 = pair.x1[i]
    x2 = pair.x2[j]
    affine = np.linalg.inv(pair.inverse_frames2[j]) @ inverses(pair.frames1[i])
    # By frames also for learned keypoints, whose frames are all alike: their neighbours agree by chance where the best candidates
    # are taken away, and a right pair of the fountain became ambiguous, while no wrong one was found.
    by_frames = np.ones(len(i), dtype=bool)
    is_confirmed = confirmations(x1, x2, affine, by_frames) >= FEWEST_CONFIRMING
    keep = without_repeats(x1[is_confirmed], x2[is_confirmed], -q[is_confirmed])
    rows1 = pair.rows1[i[is_confirmed]][keep]
    rows2 = pair.rows2[j[is_confirmed]][keep]
    return Correspondences(rows1, rows2, np.ones(int(keep.sum())))


def _is_nearest(keypoint: Int32s, distance: Float64s) -> Bools:
    """(n,) which candidates are the nearest of their keypoint; the first of equally near ones."""
    # `lexsort` is stable, and `unique` returns where each keypoint appears first, with its smallest distance
    order = np.lexsort((distance, keypoint))
    first_of_keypoint = np.unique(keypoint[order], return_index=True)[1]
    nearest = np.zeros(len(keypoint), bool)
    nearest[order[first_of_keypoint]] = True
    return nearest


class _Pose(NamedTuple):
    """Number of matches that agree with one pose, and the angles of its rotation and baseline to the accepted ones."""

    inliers: int = 0
    turned_deg: float = 0.0
    step_deg: float = 0.0


def _strongest_pose(x1: Float64s, x2: Float64s, view1: View, view2: View, R: Float64s, t: Float64s, seed: int) -> _Pose:
    """The pose that most matches agree with, compared with R and the unit vector t."""
    if len(x1) < FEWEST:
        return _Pose()
    sample = slice(None, None, -(-len(x1) // MOST_POSED))  # at most `MOST_POSED` matches, evenly spread over the rows
    pose = estimate_essential(x1[sample], x2[sample], view1, view2, 1.0, seed, max_iterations=1000)
    if pose is None or pose.R is None or pose.t is None:
        return _Pose()
    is_inlier = supporters(pose.F, x1, x2, 1.0)
    cells1 = covered_cells(x1[is_inlier], (view1.width, view1.height))
    cells2 = covered_cells(x2[is_inlier], (view2.width, view2.height))
    if min(cells1, cells2) <= FREEDOMS:
        return _Pose()
    baseline_deg = np.degrees(np.arccos(np.clip(np.ravel(pose.t) @ np.ravel(t), -1, 1)))
    return _Pose(int(is_inlier.sum()), angle_between_deg(pose.R, R), float(baseline_deg))

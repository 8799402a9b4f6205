"""Search for rivals of a pair's geometry: a shift by one period of a repetitive structure, or the view of another side.

Candidates that the accepted geometry explains are removed, and the matcher runs again on the rest.  In a scene without
repetition, the rest is incoherent.  If tiles or whole sides of a building repeat, a second set of matches appears, of the same
keypoints with other partners, and with it a second pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..core.epipolar import symmetric_epipolar_distance
from ..core.rotations import angle_between_deg
from ..matching.affine_field import fit_affine_field
from ..matching.assignment import without_repeats
from ..matching.candidates import ViewPair, inverses
from ..matching.structural import DOMINANCE, ROUNDS, Correspondences, confirmations, solve_rounds
from ..types import Bools, Features, Float64s, Int32s, View
from .image_grid import covered_cells
from .robust import MOST_POSED, TwoView, estimate_essential, supporters

EXPLAINED_PX = 12.0
"""A candidate at most this far from where the accepted matches predict its keypoint is no rival."""
FEWEST_CONFIRMING = 2
"""Neighbours that must confirm an initial match of the rival."""
FEWEST = 8
FREEDOMS = 5
"""Degrees of freedom of E: inliers in no more grid cells than this fit some pose by chance, as a cell's matches count as one."""
OFF_LINES_PX = 3.0
RIVAL_SHARE = 0.25
"""Any other pose makes a pair ambiguous if this share of the accepted inliers agrees with it."""
TURNED_RIVAL_SHARE, TURNED_DEG = 0.08, 20.0
"""A pose turned by more than the second makes a pair ambiguous if the first share of the accepted inliers agrees with it."""
SAME_ROTATION_DEG, ANOTHER_STEP_DEG = 1.0, 30.0
"""A rival whose rotation differs by less than the first and whose baseline differs by more than the second is another pose even
if all its matches lie on the epipolar lines: the view of another house of a row."""


@dataclass(frozen=True)
class Ambiguity:
    """The best competing pose of a pair."""

    inliers: int = 0
    """Number of matches not explained by the accepted geometry that agree with one other pose."""
    elsewhere: int = 0
    """Number of matches off the accepted epipolar lines that agree with one other pose (a shift along them is another depth);
    equals `inliers` if that pose differs in its baseline only: another step along a row, perhaps to its other side."""
    turned_deg: float = 0.0
    """Angle between the accepted rotation and that of the pose of `elsewhere`."""

    def ambiguous(self, inliers: int) -> bool:
        """Whether this pose is as plausible as a geometry with this many inliers.

        A quarter of its inliers suffices for any second pose; a twelfth for one that is turned far: the view of another side.
        """
        another_side = self.elsewhere >= TURNED_RIVAL_SHARE * inliers and self.turned_deg > TURNED_DEG
        return another_side or self.elsewhere >= RIVAL_SHARE * inliers


def find_ambiguity(
    left: Features, right: Features, pairs: tuple[ViewPair, ...], i1: Int32s, i2: Int32s, accepted: TwoView, seed: int = 0
) -> Ambiguity:
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
    pruned = (_without_explained(pairs[0], left, right, i1, i2),) if pairs else ()
    rivals = solve_rounds(left, right, pruned, _initial_matches(pruned[0]), DOMINANCE, ROUNDS, None) if pruned else None
    if rivals is None or len(rivals.i1) < FEWEST:
        return Ambiguity()
    x1, x2 = left.xy[rivals.i1], right.xy[rivals.i2]
    overall = _strongest_pose(x1, x2, left.view, right.view, accepted.R, accepted.t, seed)
    is_off_lines = symmetric_epipolar_distance(accepted.F, x1, x2) > OFF_LINES_PX
    elsewhere = _Pose()
    if is_off_lines.sum() >= TURNED_RIVAL_SHARE * len(i1):  # fewer cannot make the pair ambiguous
        elsewhere = _strongest_pose(x1[is_off_lines], x2[is_off_lines], left.view, right.view, accepted.R, accepted.t, seed)
    if overall.turned_deg < SAME_ROTATION_DEG and overall.step_deg > ANOTHER_STEP_DEG and overall.inliers > elsewhere.inliers:
        elsewhere = overall
    return Ambiguity(overall.inliers, elsewhere.inliers, elsewhere.turned_deg)


class _Pose(NamedTuple):
    """Number of matches that agree with one pose, and the angles of its rotation and baseline to the accepted ones."""

    inliers: int = 0
    turned_deg: float = 0.0
    step_deg: float = 0.0


def _strongest_pose(x1: Float64s, x2: Float64s, view1: View, view2: View, R: Float64s, t: Float64s, seed: int) -> _Pose:
    """The pose that most matches agree with, compared with R and the unit vector t."""
    if len(x1) < FEWEST:
        return _Pose()
    sample = slice(None, None, -(-len(x1) // MOST_POSED))
    pose = estimate_essential(x1[sample], x2[sample], view1, view2, 1.0, seed, max_iterations=1000)
    if pose is None or pose.R is None or pose.t is None:
        return _Pose()
    inliers = supporters(pose.F, x1, x2, 1.0)
    sides = ((x1, view1), (x2, view2))
    if min(covered_cells(x[inliers], (view.width, view.height)) for x, view in sides) <= FREEDOMS:
        return _Pose()
    baseline_deg = np.degrees(np.arccos(np.clip(np.ravel(pose.t) @ np.ravel(t), -1, 1)))
    return _Pose(int(inliers.sum()), angle_between_deg(pose.R, R), float(baseline_deg))


def _without_explained(pair: ViewPair, left: Features, right: Features, i1: Int32s, i2: Int32s) -> ViewPair:
    """The view pair without the candidates near the positions that the accepted matches predict."""
    x1, x2 = left.xy[i1], right.xy[i2]
    affine = right.frames[i2] @ inverses(left.frames[i1])
    field = fit_affine_field(x1, x2, affine, np.ones(len(i1)), pair.x1)
    c = pair.candidates
    reach = EXPLAINED_PX + 2 * np.minimum(field.sigma_px, 2 * EXPLAINED_PX)
    unexplained = np.linalg.norm(pair.x2[c.j] - field.prediction[c.i], axis=1) > reach[c.i]
    accepted_x2 = np.full((len(left.xy), 2), np.inf)
    accepted_x2[i1] = x2
    own_x2 = accepted_x2[pair.rows1]
    unexplained &= ~(np.linalg.norm(pair.x2[c.j] - own_x2[c.i], axis=1) <= EXPLAINED_PX)
    return replace(pair, candidates=replace(c, i=c.i[unexplained], j=c.j[unexplained], q=c.q[unexplained]))


def _initial_matches(pair: ViewPair) -> Correspondences:
    """Initial matches: candidates that are mutually nearest among the remaining ones, confirmed by their neighbours."""
    candidates = pair.candidates
    mutual = np.flatnonzero(_is_nearest(candidates.i, candidates.q) & _is_nearest(candidates.j, candidates.q))
    i, j, q = candidates.i[mutual], candidates.j[mutual], candidates.q[mutual]
    x1, x2 = pair.x1[i], pair.x2[j]
    affine = np.linalg.inv(pair.inverse_frames2[j]) @ inverses(pair.frames1[i])
    good = confirmations(x1, x2, affine) >= FEWEST_CONFIRMING
    rows1, rows2 = pair.rows1[i[good]], pair.rows2[j[good]]
    keep = without_repeats(x1[good], x2[good], -q[good])
    return Correspondences(rows1[keep], rows2[keep], np.ones(int(keep.sum())))


def _is_nearest(keypoint: Int32s, distance: Float64s) -> Bools:
    """(n,) which candidates are the nearest of their keypoint."""
    order = np.lexsort((distance, keypoint))  # the first of equally near ones
    nearest = np.zeros(len(keypoint), bool)
    nearest[order[np.unique(keypoint[order], return_index=True)[1]]] = True
    return nearest

"""Rivals of a pair's geometry, looked for on purpose: a shift by a period of what repeats, the view of another side.

What the accepted geometry explains is taken out of the candidates, and the matcher works once more on what is left.  In a scene
without repetition nothing hangs together there.  Where tiles or whole sides of a building repeat, a second pattern of matches
appears, of the same keypoints with other partners, and a second pose with it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..core.rotations import angle_between_deg
from ..matching.affine_field import fit_affine_field
from ..matching.assignment import without_repeats
from ..matching.candidates import ViewPair, inverses
from ..matching.initial import Correspondences, confirmations
from ..matching.structural import solve_rounds
from ..types import Features, Float64s, Int32s, View
from .epipolar import symmetric_epipolar_distance
from .robust import estimate_essential

EXPLAINED_PX = 12.0
"""A candidate this near to where the accepted matches put its keypoint is no rival."""
CONFIRMED = 2
"""Neighbours that confirm a first match of the rival."""
DOMINANCE, ROUNDS = 0.8, 3
OFF_LINES_PX = 3.0


@dataclass(frozen=True)
class Rival:
    """The best other hypothesis of a pair."""

    matches: int = 0
    """How many matches hang together without those that the geometry explains."""
    inliers: int = 0
    """How many of them agree with one pose."""
    shared: int = 0
    """How many of these are keypoints of accepted matches with another partner."""
    better: int = 0
    """For how many of those the other partner's descriptor is the nearer one."""
    turned_deg: float = 0.0
    """Between the rotations of both hypotheses."""
    elsewhere: int = 0
    """How many agree with one pose among those that lie off the accepted epipolar lines."""
    elsewhere_deg: float = 0.0


def find_rival(
    left: Features, right: Features, pairs: tuple[ViewPair, ...], i1: Int32s, i2: Int32s, R: Float64s | None, F: Float64s, seed: int = 0
) -> Rival:
    """The strongest pattern of matches besides the accepted ones.

    Parameters
    ----------
    left, right
        Keypoints of the two frames.
    pairs
        Their views, as `matching.candidates.view_pairs` gives them.
    i1, i2
        (n,) int32, the accepted matches: rows of the features.
    R
        Their rotation, None without K.
    seed
        Of the random samples.
    """
    others = tuple(_without(pair, left, right, i1, i2) for pair in pairs[:1])
    found = solve_rounds(left, right, others, _first(others), DOMINANCE, ROUNDS, None)
    if len(found.i1) < 8:
        return Rival(len(found.i1))
    x1, x2 = left.xy[found.i1], right.xy[found.i2]
    keep, turned = _one_pose(x1, x2, left.view, right.view, R, seed)
    off = symmetric_epipolar_distance(F, x1, x2) > OFF_LINES_PX
    other, other_turned = _one_pose(x1[off], x2[off], left.view, right.view, R, seed) if off.sum() >= 8 else (off[:0], 0.0)
    a, b = found.i1[keep], found.i2[keep]
    partner = np.full(len(left.xy), -1, np.int64)
    partner[i1] = i2
    both = partner[a] >= 0
    a, b = a[both], b[both]
    theirs = np.einsum("nd,nd->n", left.descriptors[a], right.descriptors[b])
    ours = np.einsum("nd,nd->n", left.descriptors[a], right.descriptors[partner[a]])
    return Rival(len(found.i1), int(keep.sum()), int(both.sum()), int((theirs > ours).sum()), turned, int(other.sum()), other_turned)


def _one_pose(x1: Float64s, x2: Float64s, view1: View, view2: View, R: Float64s | None, seed: int) -> tuple[np.ndarray, float]:
    pose = estimate_essential(x1, x2, view1, view2, 1.0, seed, max_iterations=1000)
    if pose is None or pose.R is None or R is None:
        return np.zeros(len(x1), bool), 0.0
    return pose.inliers, angle_between_deg(pose.R, R)


def _without(pair: ViewPair, left: Features, right: Features, i1: Int32s, i2: Int32s) -> ViewPair:
    """The view pair without the candidates near to where the accepted matches put them."""
    x1, x2 = left.xy[i1], right.xy[i2]
    affine = right.frames[i2] @ inverses(left.frames[i1])
    field = fit_affine_field(x1, x2, affine, np.ones(len(i1)), pair.x1)
    c = pair.candidates
    reach = EXPLAINED_PX + 2 * np.minimum(field.sigma_px, 2 * EXPLAINED_PX)
    away = np.linalg.norm(pair.x2[c.j] - field.prediction[c.i], axis=1) > reach[c.i]
    placed = np.full((len(left.xy), 2), np.inf)
    placed[i1] = x2
    mine = placed[pair.rows1]
    away &= ~(np.linalg.norm(pair.x2[c.j] - mine[c.i], axis=1) <= EXPLAINED_PX)
    return replace(pair, candidates=replace(c, i=c.i[away], j=c.j[away], q=c.q[away]))


def _first(pairs: tuple[ViewPair, ...]) -> Correspondences:
    """Candidates that are the best of both their keypoints among what is left, and that their neighbours confirm."""
    pair = pairs[0]
    c = pair.candidates
    order = np.lexsort((c.q, c.i))
    best1 = np.full(len(pair.x1), -1, np.int64)
    i_sorted = c.i[order]
    first = np.concatenate([[True], i_sorted[1:] != i_sorted[:-1]]) if len(order) else np.zeros(0, bool)
    best1[i_sorted[first]] = order[first]
    order = np.lexsort((c.q, c.j))
    best2 = np.full(len(pair.x2), -2, np.int64)
    j_sorted = c.j[order]
    first = np.concatenate([[True], j_sorted[1:] != j_sorted[:-1]]) if len(order) else np.zeros(0, bool)
    best2[j_sorted[first]] = order[first]
    mutual = np.flatnonzero((best1[c.i] == np.arange(len(c.i))) & (best2[c.j] == np.arange(len(c.j))))
    i, j, q = c.i[mutual], c.j[mutual], c.q[mutual]
    x1, x2 = pair.x1[i], pair.x2[j]
    affine = np.linalg.inv(pair.unframes2[j]) @ inverses(pair.frames1[i])
    good = confirmations(x1, x2, affine) >= CONFIRMED
    rows1, rows2 = pair.rows1[i[good]], pair.rows2[j[good]]
    keep = without_repeats(x1[good], x2[good], -q[good])
    return Correspondences(rows1[keep], rows2[keep], np.ones(int(keep.sum())))

"""Is a pair to be believed?  A score for each pair, and a check of all pairs of a site against each other.

Look-alike windows seen from opposite sides give a hundred and more matches that agree with one F: no count of inliers tells them
from the truth.  What does: whether the matches are *distinctive* (no rival in the other image, no look-alike in their own) and
cover the image; whether the clearest matches, found before any geometry, agree with it too; whether the two halves of the
inliers tell the same pose; and how much the local maps are stretched (aliases are found where views look alike).

What is left to a pair alone is settled by the site: rotations around a triangle of cameras must close.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, isfinite, log

import networkx as nx
import numpy as np

from ..matching.affine_field import fit_affine_field
from ..matching.candidates import ViewPair, mutual_neighbours, rival_distances
from ..matching.neighbours import nearest_elsewhere
from ..types import Bools, Features, Float32s, Float64s, Geometry, Int32s, Int64s, Matches, Pair, View
from .epipolar import symmetric_epipolar_distance
from .robust import TwoView, estimate_essential

GRID_COLUMNS, GRID_ROWS = 12, 8
DISTINCT_FROM_RIVALS, DISTINCT_FROM_LOOKALIKES = 0.85, 0.95
"""A match is distinctive where its descriptor distance is below this share of the nearest rival's and look-alike's."""
CLEAR_RATIO, CLEAR_PX = 0.9, 2.0
"""Clear matches: mutual nearest under this ratio, without geometry; they agree with F within so many pixels."""
LIKELY = 0.5
"""A match without keypoints counts as distinctive from this probability on."""
STANDS_ALONE = 1.0
"""Log odds that a pair needs which no third camera can confirm."""


@dataclass(frozen=True)
class PairEvidence:
    """What the score is made of; described in `Geometry`."""

    inliers: int
    distinct_cells: int
    distinct_share: float
    agreement: float
    half_rotation_deg: float
    stretch: float


def pair_evidence(
    left: Features, right: Features, pairs: tuple[ViewPair, ...], i1: Int32s, i2: Int32s, found: TwoView, seed: int = 0
) -> PairEvidence:
    """Evidence from the inliers i1--i2 (rows of the features) of a pair; pairs: from `view_pairs`."""
    x1, x2 = left.xy[i1], right.xy[i2]
    dots = np.einsum("nd,nd->n", left.descriptors[i1], right.descriptors[i2]).astype(np.float64)
    distance = np.sqrt(np.maximum(2 - 2 * dots, 1e-9))
    rivalry = distance / np.maximum(rival_distances(left, right, pairs, i1, i2), 1e-6)
    likeness = distance / np.maximum(np.minimum(_lookalikes(left)[i1], _lookalikes(right)[i2]), 1e-6)
    distinct = (rivalry < DISTINCT_FROM_RIVALS) & (likeness < DISTINCT_FROM_LOOKALIKES)
    return PairEvidence(
        inliers=len(i1),
        distinct_cells=min(_cells(x1[distinct], left.view), _cells(x2[distinct], right.view)),
        distinct_share=float((likeness < DISTINCT_FROM_LOOKALIKES).mean()),
        agreement=_agreement(pairs, found.F),
        half_rotation_deg=_half_rotation_deg(x1, x2, left.view, right.view, seed),
        stretch=_stretch(x1, x2, right.frames[i2] @ np.linalg.inv(left.frames[i1])),
    )


def point_evidence(before: Matches, inliers: Matches, found: TwoView, seed: int = 0) -> PairEvidence:
    """The same for points that are no keypoints, in which the matcher's word stands for what descriptors tell.

    A match of probability 0.5 and more counts as distinctive, and so do those `before` geometry as clear.
    """
    x1, x2 = inliers.x1, inliers.x2
    distinct = inliers.probability >= LIKELY
    clear = before.probability >= LIKELY
    distance = symmetric_epipolar_distance(found.F, before.x1[clear], before.x2[clear])
    return PairEvidence(
        inliers=len(x1),
        distinct_cells=min(_cells(x1[distinct], inliers.view1), _cells(x2[distinct], inliers.view2)),
        distinct_share=float(distinct.mean()),
        agreement=_share_near(distance),
        half_rotation_deg=_half_rotation_deg(x1, x2, inliers.view1, inliers.view2, seed),
        stretch=_stretch(x1, x2, None),
    )


def _lookalikes(features: Features) -> Float32s:
    """Distance of each keypoint to the most similar one elsewhere in its own image."""
    if len(features.lookalikes) == len(features.xy):
        return features.lookalikes
    return nearest_elsewhere(features.descriptors, features.xy, len(features.xy))


def pair_score(evidence: PairEvidence, contradicted: bool = False) -> float:
    """Log odds that the geometry is right.

    contradicted: the intrinsics contradict F, or another pose has as much support; such a pair is never believed on its own.
    Fitted by logistic regression on 263 labelled pairs of four scenes, 118 of them wrong; 5 fall on the wrong side.  On 432 pairs
    found anew with more keypoints (78 of them wrong) 7 do.  The epipolar distance of each half of the inliers to the F of the
    other half adds nothing, with or without K: left out.
    """
    e = evidence
    cells, inliers, stretch = log(1 + e.distinct_cells), log(1 + e.inliers), log(e.stretch + 0.01)
    if isfinite(e.half_rotation_deg):
        halves = log(e.half_rotation_deg + 0.01)
        score = 0.54 * cells + 8.9 * e.distinct_share + 4.8 * e.agreement + 2.7 * stretch + 0.53 * inliers - 0.84 * halves - 4.0
    else:
        score = 0.9 * cells + 12.0 * e.distinct_share + 5.5 * e.agreement + 3.0 * stretch + 0.6 * inliers - 6.5
    return min(score, 0.0) if contradicted else score


def probability(score: float) -> float:
    """Log odds as a probability."""
    return 1 / (1 + exp(-max(min(score, 30.0), -30.0)))


def _cells(x: Float64s, view: View) -> int:
    """How many cells of the grid hold a point."""
    column = (x[:, 0] * GRID_COLUMNS / view.width).astype(np.int64)
    row = (x[:, 1] * GRID_ROWS / view.height).astype(np.int64)
    return len(np.unique(column * 1000 + row))


def _agreement(pairs: tuple[ViewPair, ...], F: Float64s) -> float:
    """Share of the clear matches of the plain views that lie on their epipolar lines; shrunk toward 0 where they are few."""
    if not pairs:
        return 0.0
    i, j, ratio = mutual_neighbours(pairs[0])
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
    if affine is None:
        field = fit_affine_field(x1, x2, np.zeros((len(x1), 2, 2)), np.ones(len(x1)), x1, neighbours=16, ridge=0.0)
    else:
        field = fit_affine_field(x1, x2, affine, np.ones(len(x1)), x1, neighbours=16)
    axes = np.linalg.svd(field.affine, compute_uv=False)
    return float(np.median(np.log(axes[:, 0] / np.maximum(axes[:, 1], 1e-3))))


def _first_half(x1: Float64s) -> Bools:
    """The half of the points on one side of their longest spread."""
    centred = x1 - x1.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    return np.asarray(along < np.median(along))


def _half_rotation_deg(x1: Float64s, x2: Float64s, view1: View, view2: View, seed: int) -> float:
    """Angle between the rotations that the two halves of the inliers tell; nan without K."""
    if view1.K is None or view2.K is None or not (view1.focal_known and view2.focal_known):
        return float("nan")
    first = _first_half(x1)
    poses = [estimate_essential(x1[h], x2[h], view1, view2, 1.0, seed, max_iterations=300) for h in (first, ~first)]
    if poses[0] is None or poses[1] is None or poses[0].R is None or poses[1].R is None:
        return 180.0
    return rotation_angle_deg(poses[0].R @ poses[1].R.T)


def rotation_angle_deg(R: Float64s) -> float:
    """Angle of a rotation, degrees."""
    return float(np.degrees(2 * np.arcsin(min(float(np.linalg.norm(R - np.eye(3))) / (2 * np.sqrt(2)), 1.0))))


@dataclass(frozen=True)
class LoopVerdict:
    """good_probability: after the site's check; reason: why the pair is not to be used, None where it is; triangles: loops of
    three cameras that it is in; closed: how many of them close."""

    good_probability: float
    reason: str | None
    triangles: int
    closed: int


LOOP_ROTATION_DEG, LOOP_DIRECTION_DEG = 3.0, 10.0
"""A triangle closes where its rotations return within 3 degrees and the third direction is within 10 of the arc of the others."""
P_CLOSED_GOOD, P_CLOSED_BAD = 0.95, 0.05
LOOP_WEIGHT, LOOP_CAP = 0.5, 6.0
"""Triangles share pairs, so each counts half; all together they move the log odds by at most 6."""
PRIOR_SHIFT = 0.5
TREE_DEG = 4.0


def site_verdict(geometries: Mapping[Pair, Geometry]) -> dict[Pair, LoopVerdict]:
    """Judge all pairs of a site together; for each pair whether it may enter the poses.

    Mean-field beliefs over the triangles of cameras, then a maximum spanning tree of the believed pairs: what disagrees with the
    rotations along it is dropped.  Pairs without a relative pose are judged by their score alone, and a pair that stands in no
    triangle needs a score over `STANDS_ALONE`.
    """
    posed = {pair: g for pair, g in geometries.items() if g.cam2_R_cam1 is not None and g.cam2_t_cam1 is not None}
    triangles = _triangles(posed)
    closed = np.array([_closes(posed, *triangle) for triangle in triangles], dtype=bool)
    pairs = list(geometries)
    index = {pair: k for k, pair in enumerate(pairs)}
    members = np.array([[index[a, b], index[b, c], index[a, c]] for a, b, c in triangles], dtype=np.int64).reshape(-1, 3)
    prior = np.array([float(np.clip(geometries[pair].score, -6, 6)) - PRIOR_SHIFT for pair in pairs])
    belief = _beliefs(prior, members, closed)
    count = np.bincount(members.ravel(), minlength=len(pairs))
    closing = np.bincount(members[closed].ravel(), minlength=len(pairs))
    reasons = {pair: _reason(geometries[pair], float(belief[k]), int(count[k]), int(closing[k])) for k, pair in enumerate(pairs)}
    believed = {pair: float(belief[index[pair]]) for pair in posed if reasons[pair] is None}
    for pair, degrees in _against_tree(posed, believed).items():
        reasons[pair] = f"wrong: turned by {degrees:.1f} degrees against the pairs that are believed most"
    verdicts = {}
    for k, pair in enumerate(pairs):
        p = probability(float(belief[k]))
        verdicts[pair] = LoopVerdict(p if reasons[pair] is None else min(p, 0.5), reasons[pair], int(count[k]), int(closing[k]))
    return verdicts


def _reason(geometry: Geometry, belief: float, triangles: int, closed: int) -> str | None:
    """None for a pair to be believed."""
    figures = (
        f"score {geometry.score:.1f}, {geometry.distinct_cells} cells with distinctive matches, "
        f"{closed} of {triangles} triangles close"
    )
    if triangles == 0 and 0 < geometry.score <= STANDS_ALONE:
        return f"possible look-alike: no third camera confirms it ({figures})"
    if belief > 0:
        return None
    if geometry.score > 0:
        return f"possible look-alike: other pairs contradict it ({figures})"
    return f"ambiguous: another pose fits as well ({figures})" if geometry.score == 0 else f"wrong ({figures})"


def _triangles(posed: Mapping[Pair, Geometry]) -> list[tuple[str, str, str]]:
    """(a, b, c) with pairs a--b, b--c and a--c, in the order of the cameras."""
    after: dict[str, set[str]] = {}
    for a, b in posed:
        after.setdefault(a, set()).add(b)
    return [(a, b, c) for a, b in posed for c in sorted(after.get(b, set()) & after[a])]


def _closes(posed: Mapping[Pair, Geometry], a: str, b: str, c: str) -> bool:
    """Do the rotations around the triangle return, and does the direction a to c lie between those to b and on from there?"""
    (R_ab, t_ab), (R_bc, t_bc), (R_ac, t_ac) = (_pose(posed[pair]) for pair in ((a, b), (b, c), (a, c)))
    if rotation_angle_deg(R_ac.T @ R_bc @ R_ab) > LOOP_ROTATION_DEG:
        return False
    to_b, onward, to_c = -R_ab.T @ t_ab, -R_ab.T @ (R_bc.T @ t_bc), -R_ac.T @ t_ac  # directions in the axes of a
    normal = np.cross(to_b, onward)
    if np.linalg.norm(normal) >= 0.05:
        normal /= np.linalg.norm(normal)
        flat = to_c - (to_c @ normal) * normal
        weights = np.linalg.lstsq(np.column_stack([to_b, onward]), flat, rcond=None)[0]
        if (weights >= 0).all():
            return bool(abs(to_c @ normal) < np.sin(np.radians(LOOP_DIRECTION_DEG)))
    nearest = max(to_c @ to_b, to_c @ onward)
    return bool(nearest > np.cos(np.radians(LOOP_DIRECTION_DEG)))


def _pose(geometry: Geometry) -> tuple[Float64s, Float64s]:
    assert geometry.cam2_R_cam1 is not None and geometry.cam2_t_cam1 is not None
    return geometry.cam2_R_cam1, geometry.cam2_t_cam1


def _beliefs(prior: Float64s, members: Int64s, closed: Bools) -> Float64s:
    """Log odds of each pair after 15 damped rounds of mean-field messages from the triangles."""
    belief = prior.copy()
    for _ in range(15 if len(members) else 0):
        p = 1 / (1 + np.exp(-belief))
        up, down = np.zeros(len(prior)), np.zeros(len(prior))
        for side in range(3):
            others = p[members[:, (side + 1) % 3]] * p[members[:, (side + 2) % 3]]
            closes = np.log((others * P_CLOSED_GOOD + (1 - others) * P_CLOSED_BAD) / P_CLOSED_BAD)
            opens = np.log((others * (1 - P_CLOSED_GOOD) + (1 - others) * (1 - P_CLOSED_BAD)) / (1 - P_CLOSED_BAD))
            np.add.at(up, members[closed, side], closes[closed])
            np.add.at(down, members[~closed, side], opens[~closed])
        loops = np.minimum(LOOP_WEIGHT * up, LOOP_CAP) + np.maximum(LOOP_WEIGHT * down, -LOOP_CAP)
        belief = 0.5 * belief + 0.5 * (prior + loops)
    return belief


def _against_tree(posed: Mapping[Pair, Geometry], believed: Mapping[Pair, float]) -> dict[Pair, float]:
    """Believed pairs whose rotation is off by more than `TREE_DEG` from that along the maximum spanning tree, and by how much."""
    graph = nx.Graph()
    for (a, b), belief in sorted(believed.items()):
        graph.add_edge(a, b, weight=belief)
    tree = nx.maximum_spanning_tree(graph)
    world: dict[str, Float64s] = {}
    for root in sorted(tree.nodes):
        if root in world:
            continue
        world[root] = np.eye(3)
        for a, b in nx.bfs_edges(tree, root):
            R = _pose(posed[a, b])[0] if (a, b) in posed else _pose(posed[b, a])[0].T
            world[b] = R @ world[a]
    off = {pair: rotation_angle_deg(_pose(posed[pair])[0].T @ world[pair[1]] @ world[pair[0]].T) for pair in believed}
    return {pair: degrees for pair, degrees in off.items() if degrees > TREE_DEG}

"""The check of a site (`sfm.loops`) on labelled pairs: what it believes, what its limits rest on, which cameras are turned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from verdict_fit import LabelledPair
from verdict_scenes import REPEATING, scene_of

from wbflow_stages.core.rotations import angle_between_deg
from wbflow_stages.sfm.loops import USUAL, Habits, check_loops, closes, triangles_of
from wbflow_stages.sfm.repeats import Rivalry, Shares, rivalry
from wbflow_stages.sfm.rotation_averaging import average_rotations, components
from wbflow_stages.twoview.pair_score import probability
from wbflow_stages.twoview.rivals import Rival
from wbflow_stages.types import Bools, Float64s, Geometry, Pair, View

LEAST_SCORE = -4.0
"""Pairs below do not reach the site (`estimate_geometry`)."""
WITHIN = ((3.0, 10.0), (6.0, 15.0), (9.0, 25.0))
"""Tried: degrees within which triangles close, of rotation and direction."""
AT_LEAST = 0.01
"""No share is taken to be rarer than this: there are too few pairs to know."""


def believed(pairs: list[LabelledPair], scores: Float64s, usual: Habits) -> Bools:
    """(n,) which pairs of a site the site believes."""
    checks = check_loops(_geometries(pairs, scores), None, usual)
    return np.array([(p.left, p.right) in checks and checks[p.left, p.right].rejected is None for p in pairs], bool)


def count_habits(sets: Mapping[str, list[LabelledPair]]) -> Habits:
    """What is usual in the scenes that do not repeat, each with the same weight."""
    plain: dict[str, list[list[LabelledPair]]] = {}
    for name, pairs in sets.items():
        if name != "nothing" and scene_of(name) not in REPEATING:
            plain.setdefault(scene_of(name), []).append(pairs)
    kinds = [[rivalry(g) for pairs in some for g in _geometries(pairs).values()] for some in plain.values()]
    shares = {
        kind: max(AT_LEAST, float(np.mean([[k is kind for k in scene].count(True) / len(scene) for scene in kinds])))
        for kind in (Rivalry.TURNED, Rivalry.SIDE, Rivalry.ROW)
    }
    rivals = Shares(shares[Rivalry.TURNED], shares[Rivalry.SIDE], shares[Rivalry.ROW])
    best: tuple[float, Habits] | None = None
    for rotation, direction in WITHIN:
        tried = replace(USUAL, rotation_deg=rotation, direction_deg=direction, rivals=rivals)
        right, wrong = (_share_closed(plain, tried, wrong=wrong) for wrong in (False, True))
        likelihood = sum(p * np.log(p) + (1 - p) * np.log(1 - p) for p in (right, wrong))
        if best is None or likelihood > best[0]:
            best = float(likelihood), replace(tried, closed_right=right, closed_wrong=wrong)
    assert best is not None
    return best[1]


def _share_closed(plain: Mapping[str, list[list[LabelledPair]]], usual: Habits, *, wrong: bool) -> float:
    """Of triangles of usable pairs, or of those with a wrong one; between `AT_LEAST` and 1 less that."""
    shares = []
    for sets in plain.values():
        closed = []
        for pairs in sets:
            kinds = {(p.left, p.right): p for p in pairs}
            geometries = _geometries(pairs)
            for a, b, c in triangles_of(geometries):
                sides = [kinds[side] for side in ((a, b), (b, c), (a, c))]
                if any(p.wrong for p in sides) if wrong else all(p.usable for p in sides):
                    closed.append(closes(geometries, a, b, c, usual))
        if closed:
            shares.append(np.mean(closed))
    return float(np.clip(np.mean(shares), AT_LEAST, 1 - AT_LEAST))


def worst_turn_deg(pairs: list[LabelledPair], truth: Mapping[str, Float64s], copies: list[Float64s]) -> float:
    """How far a camera is turned against the first one of those it hangs together with, at most, where each may stand for the
    nearest of its copies."""
    names = list(dict.fromkeys(name for p in pairs for name in (p.left, p.right)))
    number = {name: k for k, name in enumerate(names)}
    relative = {(number[p.left], number[p.right]): p.R for p in pairs if p.R is not None}
    found = average_rotations(relative, dict.fromkeys(relative, 1.0))
    worst = 0.0
    for part in components(list(relative), list(range(len(names)))):
        first = truth[names[part[0]]]
        for view in part[1:]:
            R = found[view] @ found[part[0]].T
            worst = max(worst, min(angle_between_deg(R, truth[names[view]] @ turn.T @ first.T) for turn in copies))
    return worst


def _geometries(pairs: list[LabelledPair], scores: Float64s | None = None) -> dict[Pair, Geometry]:
    """What the check of a site looks at, of the pairs that reach it."""
    scores = np.array([p.score for p in pairs]) if scores is None else scores
    return {(p.left, p.right): _geometry(p, float(s)) for p, s in zip(pairs, scores, strict=True) if s >= LEAST_SCORE}


def _geometry(pair: LabelledPair, score: float) -> Geometry:
    e, nothing, bare = pair.evidence, np.zeros((0, 2)), View(1, 1)
    rival = e.rival or Rival(0, 0, float("nan"))
    return Geometry(
        F=np.eye(3), x1=nothing, x2=nothing, i1=None, i2=None, probability=np.zeros(0, np.float32), view1=bare, view2=bare,
        cam2_R_cam1=pair.R, cam2_t_cam1=pair.t, matches=e.inliers, inliers=e.inliers, model="E", epipolar_px=0.0,
        angle_deg=e.angle_deg, homography_share=0.0, score=score, good_probability=probability(score),
        distinct_cells=e.distinct_cells, rival_elsewhere=rival.elsewhere, rival_turned_deg=rival.turned_deg,
    )  # fmt: skip

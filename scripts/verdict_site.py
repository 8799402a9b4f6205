"""Sites of labelled pairs: the pairs that their check (`sfm.loops`) accepts, and the rotation errors of their solved cameras."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from pairs_with_truth import pose_error_deg
from verdict_fit import LabelledPair, is_wrong
from verdict_scenes import REPEATING, scene_of

from wbflow_stages.core.cameras import relative_pose
from wbflow_stages.core.rotations import angle_between_deg
from wbflow_stages.orientation.solve import solve_from_pairs
from wbflow_stages.sfm.loops import (
    WITHOUT_REPETITION,
    AmbiguityKind,
    LoopStatistics,
    Shares,
    ambiguity_kind,
    check_loops,
    closes,
    triangles_of,
)
from wbflow_stages.sfm.rotation_averaging import average_rotations, components
from wbflow_stages.twoview.pair_score import informs_about_site, probability
from wbflow_stages.types import Bools, Camera, Float64s, Geometry, Pair, Placement, Poses, Survey

LEAST_SCORE = -4.0
"""Pairs with a lower score are passed to the site only if they carry information about it (`informs_about_site`)."""
TOLERANCES_DEG = ((3.0, 10.0), (6.0, 15.0), (9.0, 25.0))
"""Tolerances that are tried for the closure of triangles: degrees of rotation and of direction."""
MAX_ROTATION_ERROR_DEG, MAX_EPIPOLAR_PX = 4.0, 2.0
"""Default parameters of `solve_poses`."""
LEAST_SHARE = 0.01
"""Lower bound on each estimated share: there are too few pairs to measure smaller ones."""


def site_accepts(pairs: list[LabelledPair], scores: Float64s, statistics: LoopStatistics) -> Bools:
    """(n,) which pairs the site's check accepts."""
    checks = check_loops(_geometries(pairs, scores), None, statistics)
    return np.array([(p.left, p.right) in checks and checks[p.left, p.right].rejected is None for p in pairs], bool)


def loop_statistics(sets: Mapping[str, list[LabelledPair]]) -> LoopStatistics:
    """Statistics of the scenes that do not repeat, each scene with the same weight; tolerances by largest likelihood."""
    plain: dict[str, list[list[LabelledPair]]] = {}
    for name, pairs in sets.items():
        if name != "nothing" and scene_of(name) not in REPEATING:
            plain.setdefault(scene_of(name), []).append(pairs)
    kinds = [[ambiguity_kind(g) for pairs in some for g in _geometries(pairs).values()] for some in plain.values()]
    shares = {
        kind: max(LEAST_SHARE, float(np.mean([[k is kind for k in scene].count(True) / len(scene) for scene in kinds])))
        for kind in (AmbiguityKind.TURNED, AmbiguityKind.SIDE, AmbiguityKind.ROW)
    }
    rivals = Shares(shares[AmbiguityKind.TURNED], shares[AmbiguityKind.SIDE], shares[AmbiguityKind.ROW])
    best: tuple[float, LoopStatistics] | None = None
    for rotation, direction in TOLERANCES_DEG:
        tried = replace(WITHOUT_REPETITION, rotation_deg=rotation, direction_deg=direction, rivals=rivals)
        right, wrong = (_share_closed(plain, tried, wrong=wrong) for wrong in (False, True))
        likelihood = sum(p * np.log(p) + (1 - p) * np.log(1 - p) for p in (right, wrong))
        if best is None or likelihood > best[0]:
            best = float(likelihood), replace(tried, closed_right=right, closed_wrong=wrong)
    assert best is not None
    return best[1]


def _share_closed(plain: Mapping[str, list[list[LabelledPair]]], statistics: LoopStatistics, *, wrong: bool) -> float:
    """Share of closed triangles among those of usable pairs, or those with a wrong pair, kept `LEAST_SHARE` away from 0 and 1."""
    shares = []
    for sets in plain.values():
        closed = []
        for pairs in sets:
            kinds = {(p.left, p.right): p for p in pairs}
            geometries = _geometries(pairs)
            for a, b, c in triangles_of(geometries):
                sides = [kinds[side] for side in ((a, b), (b, c), (a, c))]
                if any(p.wrong for p in sides) if wrong else all(p.usable for p in sides):
                    closed.append(closes(geometries, a, b, c, statistics))
        if closed:
            shares.append(np.mean(closed))
    return float(np.clip(np.mean(shares), LEAST_SHARE, 1 - LEAST_SHARE))


def solved_poses(pairs: list[LabelledPair], scores: Float64s, statistics: LoopStatistics) -> Poses | None:
    """The cameras of a site as `poses` solves them from known intrinsics and nothing else; None if it solves none."""
    geometries = _geometries(pairs, scores)
    seen = {name: view for p in pairs for name, view in ((p.left, p.geometry.view1), (p.right, p.geometry.view2))}
    views = {name: seen[name] for name in sorted(seen)}
    nothing = {name: Placement() for name in views}
    found = solve_from_pairs(views, nothing, geometries, Survey(), {}, MAX_ROTATION_ERROR_DEG, MAX_EPIPOLAR_PX, statistics)
    return found if isinstance(found, Poses) else None


def in_use(pairs: list[LabelledPair], poses: Poses | None, truth: Mapping[str, Camera]) -> tuple[Bools, Bools]:
    """(n,) which pairs the solved site uses, and which of these have a wrong relative pose of the solved cameras."""
    kept, wrong = np.zeros(len(pairs), bool), np.zeros(len(pairs), bool)
    if poses is None:
        return kept, wrong
    for k, p in enumerate(pairs):
        check = poses.pair_checks.get(f"{p.left}--{p.right}")
        if check is not None and check.kept and {p.left, p.right} <= set(poses.cameras):
            kept[k] = True
            R, t = relative_pose(poses.cameras[p.left], poses.cameras[p.right])
            wrong[k] = is_wrong(pose_error_deg(truth[p.left], truth[p.right], R, t))
    return kept, wrong


def averaged_turn_deg(pairs: list[LabelledPair], truth: Mapping[str, Camera]) -> float:
    """Largest rotation error of a camera, in degrees, if rotations are averaged from these pairs."""
    names = list(dict.fromkeys(name for p in pairs for name in (p.left, p.right)))
    number = {name: k for k, name in enumerate(names)}
    relative = {(number[p.left], number[p.right]): R for p in pairs if (R := p.geometry.cam2_R_cam1) is not None}
    found = average_rotations(relative, dict.fromkeys(relative, 1.0))
    parts = [[names[k] for k in part] for part in components(list(relative))]
    return _worst_turn_deg({names[k]: R for k, R in found.items()}, parts, truth, [np.eye(3)])


def solved_turn_deg(poses: Poses, truth: Mapping[str, Camera], copies: list[Float64s]) -> float:
    """Largest rotation error of a solved camera, in degrees; each camera is compared with the nearest of its symmetric copies."""
    return _worst_turn_deg({name: c.R for name, c in poses.cameras.items()}, poses.components, truth, copies)


def _worst_turn_deg(
    found: Mapping[str, Float64s], parts: Iterable[Iterable[str]], truth: Mapping[str, Camera], copies: list[Float64s]
) -> float:
    """Largest rotation error relative to the first camera of each component, in degrees."""
    worst = 0.0
    for first, *others in parts:
        for name in others:
            R = found[name] @ found[first].T
            worst = max(worst, min(angle_between_deg(R, truth[name].R @ turn.T @ truth[first].R.T) for turn in copies))
    return worst


def _geometries(pairs: list[LabelledPair], scores: Float64s | None = None) -> dict[Pair, Geometry]:
    """The geometries that are passed to a site if its pairs have these scores (by default the product's)."""
    scores = np.array([p.score for p in pairs]) if scores is None else scores
    return {
        (p.left, p.right): replace(p.geometry, score=float(score), good_probability=probability(float(score)))
        for p, score in zip(pairs, scores, strict=True)
        if score >= LEAST_SCORE or informs_about_site(p.evidence)
    }

"""Loops: all pairs of a site are compared with each other, since rotations around a triangle of cameras must close.

Loops expose look-alikes that a pair's own evidence (`twoview.pair_score`) does not, and confirm pairs that it leaves open.

Where a scene looks the same from other sides, or along a row, wrong pairs may close all loops.  The ambiguity of a pair
(`twoview.ambiguity`) shows it, by the angle between its rotation and the accepted one: a part of a full turn where the scene
looks the same from another side, no turn but another step along a row.  One pair may be ambiguous by chance, and few pairs of a
scene that repeats see what shows it, so all pairs of the site decide together.  Three pairs that are each as distinct as right
ones, yet contradict each other by a part of a full turn, show it at once."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from math import isfinite, log

import numpy as np

from ..core.rotations import angle_between_deg
from ..reasons import Reason, Rejected
from ..twoview.ambiguity import MUCH_TURNED, SAME_ROTATION_DEG, TURNED_DEG
from ..twoview.pair_score import DISTINCT_CELLS, probability
from ..types import Bools, Float64s, Geometry, Int64s, Pair
from .rotation_averaging import View, rotations_along_tree

PARTS_DEG = (180.0, 120.0, 90.0, 60.0)
"""Of a full turn: buildings with two, three, four and six equal sides."""
PART_WITHIN_DEG = 2.0
ROW_SHARE, ROW_INLIERS = 0.2, 20
"""Of the accepted inliers, and matches, that a rival of the same rotation needs."""


class AmbiguityKind(Enum):
    """What the rival of a pair looks like."""

    NONE = "none"
    TURNED = "turned"
    SIDE = "side"
    """Turned by a part of a full turn."""
    ROW = "row"
    """Not turned at all."""


@dataclass(frozen=True)
class Shares:
    """Of the pairs of a scene that have a rival of each kind."""

    turned: float
    side: float
    row: float

    def log_odds(self, other: Shares, kind: AmbiguityKind) -> float:
        """For this scene against the other, of one pair."""
        return log(self._of(kind) / other._of(kind))

    def _of(self, kind: AmbiguityKind) -> float:
        return 1 - self.turned - self.side - self.row if kind is AmbiguityKind.NONE else float(getattr(self, kind.value))


FROM_OTHER_SIDES, IN_A_ROW = Shares(turned=0.3, side=0.2, row=0.01), Shares(turned=0.1, side=0.01, row=0.5)
"""Scenes that repeat; by what a pair can see, since there is one family of each to measure: only cameras that look around a
corner see another side, and any two of a row see another house."""
P_REPEATS = 0.2
"""Of a site to be the one or the other."""


def ambiguity_kind(geometry: Geometry) -> AmbiguityKind | None:
    """The kind of a pair's rival, None where nobody looked for one."""
    turned = geometry.rival_turned_deg
    if not isfinite(turned):
        return None
    share = geometry.rival_elsewhere / max(geometry.inliers, 1)
    if share >= MUCH_TURNED and _part_of_a_turn(turned):
        return AmbiguityKind.SIDE
    if share >= ROW_SHARE and geometry.rival_elsewhere >= ROW_INLIERS and turned < SAME_ROTATION_DEG:
        return AmbiguityKind.ROW
    return AmbiguityKind.TURNED if share >= MUCH_TURNED and turned > TURNED_DEG else AmbiguityKind.NONE


def _part_of_a_turn(degrees: float) -> bool:
    return min(abs(degrees - part) for part in PARTS_DEG) <= PART_WITHIN_DEG


def distinct_copies(posed: Mapping[Pair, Geometry], triangles: Iterable[tuple[str, str, str]]) -> bool:
    """Do pairs, each as distinct as right ones, contradict each other by parts of a full turn around triangles of cameras?

    One of the three is wrong, then, and matches one side of a building with another as well as a right pair matches what it sees.
    By chance a sixth of all rotations are so near to a part of a turn: most that contradict have to be.
    """
    turned = []
    for a, b, c in triangles:
        sides = [posed[pair] for pair in ((a, b), (b, c), (a, c))]
        first, second, direct = (g.cam2_R_cam1 for g in sides)
        if first is None or second is None or direct is None or min(g.distinct_cells for g in sides) < DISTINCT_CELLS:
            continue
        degrees = angle_between_deg(direct, second @ first)
        if degrees > TURNED_DEG:
            turned.append(_part_of_a_turn(degrees))
    return 2 * turned.count(True) > len(turned)


def why_ambiguous(geometries: Iterable[Geometry], usual: Shares) -> Reason | None:
    """In which way a scene repeats, None where it more likely does not; usual: the shares of scenes that don't."""
    kinds = [kind for geometry in geometries if (kind := ambiguity_kind(geometry)) is not None]
    prior = log(P_REPEATS / (1 - P_REPEATS))
    odds = {
        Reason.SAME_FROM_OTHER_SIDES: prior + sum(FROM_OTHER_SIDES.log_odds(usual, kind) for kind in kinds),
        Reason.SAME_ALONG_A_ROW: prior + sum(IN_A_ROW.log_odds(usual, kind) for kind in kinds),
    }
    likely = max(odds, key=lambda reason: odds[reason])
    return likely if odds[likely] > 0 else None


STANDS_ALONE = log(19)
"""Log odds that a pair needs which no third camera confirms: one such in twenty may be wrong.  One that others do confirm needs
only be more likely right than wrong."""
STANDS_ALONE_BARE = 1.0
"""The same of the other score, where no rival was looked for."""


@dataclass(frozen=True)
class LoopCheck:
    """What the triangles of a site's cameras say of one pair."""

    good_probability: float
    """After the check."""
    rejected: Rejected | None
    """Why the pair is not to be used, None where it is."""
    triangles: int
    """Loops of three cameras that the pair is in..."""
    closed: int
    """...and how many of them close."""


@dataclass(frozen=True)
class Habits:
    """What is usual in scenes that do not repeat, as `scripts/bench_verdict.py` counts it."""

    rotation_deg: float
    direction_deg: float
    """A triangle closes where its rotations return within the first, and the third direction is within the second of the arc of
    the others."""
    closed_right: float
    """Share of the triangles of right pairs that close..."""
    closed_wrong: float
    """...and of those with a wrong one."""
    rivals: Shares


USUAL = Habits(6.0, 15.0, closed_right=0.99, closed_wrong=0.05, rivals=Shares(turned=0.2, side=0.012, row=0.01))
FEW_PAIRS = 15
"""Of so many pairs (six cameras) all combinations of right and wrong ones are weighed."""
LOOP_WEIGHT, LOOP_CAP = 0.5, 6.0
"""Of more pairs beliefs are approximate: triangles share pairs, so each counts half; all together they move the log odds by at
most 6."""
PRIOR_SHIFT = 0.5


def check_loops(
    geometries: Mapping[Pair, Geometry], unsure_deg: Mapping[Pair, float] | None = None, usual: Habits = USUAL
) -> dict[Pair, LoopCheck]:
    """Judge all pairs of a site together; for each pair whether it may enter the poses.

    Beliefs from the triangles of cameras (exact where pairs are few, else mean-field), then a maximum spanning tree of the
    believed pairs: what disagrees with the rotations along it is dropped.  Pairs without a relative pose are judged by their
    score alone, and a pair that stands in no triangle needs a score over `STANDS_ALONE`.

    unsure_deg: by how much rotations may be off besides the noise, where lenses are only guessed: a triangle that a wrong focal
    length may hold open says nothing against its pairs.
    """
    posed = {pair: g for pair, g in geometries.items() if g.cam2_R_cam1 is not None and g.cam2_t_cam1 is not None}
    triangles = triangles_of(posed)
    unsure = unsure_deg or {}
    slack = [max(unsure.get(side, 0.0) for side in ((a, b), (b, c), (a, c))) for a, b, c in triangles]
    closed = np.array([closes(posed, *three, usual, most) for three, most in zip(triangles, slack, strict=True)], dtype=bool)
    pairs = list(geometries)
    index = {pair: k for k, pair in enumerate(pairs)}
    members = np.array([[index[a, b], index[b, c], index[a, c]] for a, b, c in triangles], dtype=np.int64).reshape(-1, 3)
    prior = np.array([float(np.clip(geometries[pair].score, -6, 6)) - PRIOR_SHIFT for pair in pairs])
    belief = (_exact_beliefs if len(pairs) <= FEW_PAIRS else _beliefs)(prior, members, closed, usual)
    count = np.bincount(members.ravel(), minlength=len(pairs))
    closing = np.bincount(members[closed].ravel(), minlength=len(pairs))
    figures: dict[Pair, dict[str, float]] = {}
    for k, (pair, g) in enumerate(geometries.items()):
        loops = {"closed": int(closing[k]), "triangles": int(count[k])}
        figures[pair] = {"score": g.score, "distinct_cells": g.distinct_cells, **loops}
    why = {pair: _refusal(geometries[pair], float(belief[k]), figures[pair]) for k, pair in enumerate(pairs)}
    for pair, code in _unsupported({p for p in posed if why[p] is None}, geometries, triangles, closed).items():
        why[pair] = Rejected(code, figures[pair])
    believed = {pair: float(belief[index[pair]]) for pair in posed if why[pair] is None}
    for pair, degrees in _against_tree(posed, believed, unsure, usual.rotation_deg).items():
        why[pair] = Rejected(Reason.TURNED, {"turned_deg": degrees})
    copies = Reason.SAME_FROM_OTHER_SIDES if distinct_copies(posed, triangles) else None
    if repeats := copies or why_ambiguous(posed.values(), usual.rivals):
        for pair in posed:
            why[pair] = why[pair] or Rejected(repeats, figures[pair])
    checks = {}
    for k, pair in enumerate(pairs):
        p = probability(float(belief[k]))
        checks[pair] = LoopCheck(p if why[pair] is None else min(p, 0.5), why[pair], int(count[k]), int(closing[k]))
    return checks


def _refusal(geometry: Geometry, belief: float, figures: dict[str, float]) -> Rejected | None:
    """None for a pair to be believed."""
    if figures["triangles"] == 0 and 0 < geometry.score <= _alone(geometry):
        return Rejected(Reason.UNCONFIRMED, figures)
    if belief > 0:
        return None
    if geometry.score > 0:
        return Rejected(Reason.LOOK_ALIKE, figures)
    return Rejected(Reason.AMBIGUOUS if geometry.score == 0 else Reason.NOT_BELIEVED, figures)


def _alone(geometry: Geometry) -> float:
    """The score that this pair needs where no other confirms it."""
    return STANDS_ALONE if isfinite(geometry.rival_turned_deg) else STANDS_ALONE_BARE


def _unsupported(
    believed: set[Pair], geometries: Mapping[Pair, Geometry], triangles: list[tuple[str, str, str]], closed: Bools
) -> dict[Pair, Reason]:
    """Believed pairs that no camera may be hung on.

    Where a triangle of three believed pairs does not close, one of them is wrong, and nothing says which: copies of a building
    contradict each other, with scores like those of right pairs.  So a pair needs at least as many of its triangles of believed
    pairs closed as open; and where none of them is closed, a score that stands alone.
    """
    agree, object_ = dict.fromkeys(believed, 0), dict.fromkeys(believed, 0)
    for (a, b, c), closes in zip(triangles, closed.tolist(), strict=True):
        sides = ((a, b), (b, c), (a, c))
        if believed.issuperset(sides):
            for side in sides:
                (agree if closes else object_)[side] += 1
    found = {}
    for pair in believed:
        if object_[pair] > agree[pair]:
            found[pair] = Reason.LOOK_ALIKE
        elif agree[pair] == 0 and geometries[pair].score <= _alone(geometries[pair]):
            found[pair] = Reason.UNCONFIRMED
    return found


def triangles_of(pairs: Collection[tuple[View, View]]) -> list[tuple[View, View, View]]:
    """(a, b, c) with pairs a--b, b--c and a--c, in the order of the cameras."""
    after: dict[View, set[View]] = {}
    for a, b in pairs:
        after.setdefault(a, set()).add(b)
    return [(a, b, c) for a, b in pairs for c in sorted(after.get(b, set()) & after[a])]


def closes(posed: Mapping[Pair, Geometry], a: str, b: str, c: str, usual: Habits = USUAL, slack_deg: float = 0.0) -> bool:
    """Do the rotations around the triangle return, and does the direction a to c lie between those to b and on from there?

    Parameters
    ----------
    posed : geometries by pair.
    a, b, c : ids of the cameras.
    usual : how well triangles close where all is right.
    slack_deg : more than that, for what else is uncertain.
    """
    (R_ab, t_ab), (R_bc, t_bc), (R_ac, t_ac) = (_pose(posed[pair]) for pair in ((a, b), (b, c), (a, c)))
    if angle_between_deg(R_ac, R_bc @ R_ab) > usual.rotation_deg + slack_deg:
        return False
    to_b, onward, to_c = -R_ab.T @ t_ab, -R_ab.T @ (R_bc.T @ t_bc), -R_ac.T @ t_ac  # directions in the axes of a
    normal = np.cross(to_b, onward)
    if np.linalg.norm(normal) >= 0.05:
        normal /= np.linalg.norm(normal)
        flat = to_c - (to_c @ normal) * normal
        weights = np.linalg.lstsq(np.column_stack([to_b, onward]), flat, rcond=None)[0]
        if (weights >= 0).all():
            return bool(abs(to_c @ normal) < np.sin(np.radians(usual.direction_deg + slack_deg)))
    nearest = max(to_c @ to_b, to_c @ onward)
    return bool(nearest > np.cos(np.radians(usual.direction_deg + slack_deg)))


def _pose(geometry: Geometry) -> tuple[Float64s, Float64s]:
    assert geometry.cam2_R_cam1 is not None and geometry.cam2_t_cam1 is not None
    return geometry.cam2_R_cam1, geometry.cam2_t_cam1


def _exact_beliefs(prior: Float64s, members: Int64s, closed: Bools, usual: Habits) -> Float64s:
    """Log odds of each pair, over all combinations of right and wrong pairs.

    Of few pairs, two wrong ones that agree with each other would talk each other up in the rounds of the approximation: views
    from the opposite side, each turned by half a turn, close triangles with what is right.
    """
    right = (np.arange(1 << len(prior))[:, None] >> np.arange(len(prior)) & 1).astype(bool)
    likelihood = np.zeros(len(right))
    for one, odds in zip(right.T, prior.tolist(), strict=True):
        likelihood[one] += odds
    for sides, closes in zip(members, closed.tolist(), strict=True):
        of_right, of_wrong = usual.closed_right, usual.closed_wrong
        chances = (of_right, of_wrong) if closes else (1 - of_right, 1 - of_wrong)
        likelihood += np.where(right[:, sides].all(axis=1), *np.log(chances))
    weight = np.exp(likelihood - likelihood.max())
    share = [(weight[one].sum() + 1e-12) / (weight[~one].sum() + 1e-12) for one in right.T]
    return np.asarray(np.log(share), dtype=np.float64)


def _beliefs(prior: Float64s, members: Int64s, closed: Bools, usual: Habits) -> Float64s:
    """Log odds of each pair after 15 damped rounds of mean-field messages from the triangles."""
    belief, right, wrong = prior.copy(), usual.closed_right, usual.closed_wrong
    for _ in range(15 if len(members) else 0):
        p = 1 / (1 + np.exp(-belief))
        up, down = np.zeros(len(prior)), np.zeros(len(prior))
        for side in range(3):
            others = p[members[:, (side + 1) % 3]] * p[members[:, (side + 2) % 3]]
            closes = np.log((others * right + (1 - others) * wrong) / wrong)
            opens = np.log((others * (1 - right) + (1 - others) * (1 - wrong)) / (1 - wrong))
            np.add.at(up, members[closed, side], closes[closed])
            np.add.at(down, members[~closed, side], opens[~closed])
        loops = np.minimum(LOOP_WEIGHT * up, LOOP_CAP) + np.maximum(LOOP_WEIGHT * down, -LOOP_CAP)
        belief = 0.5 * belief + 0.5 * (prior + loops)
    return belief


def _against_tree(
    posed: Mapping[Pair, Geometry], believed: Mapping[Pair, float], unsure_deg: Mapping[Pair, float], most_deg: float
) -> dict[Pair, float]:
    """Believed pairs whose rotation is off by more than `most_deg` from that along the maximum spanning tree, and by how much."""
    relative = {pair: _pose(posed[pair])[0] for pair in believed}
    world = rotations_along_tree(relative, believed)
    off = {(a, b): angle_between_deg(R, world[b] @ world[a].T) for (a, b), R in relative.items()}
    return {pair: degrees for pair, degrees in off.items() if degrees > most_deg + unsure_deg.get(pair, 0.0)}

"""Loop checks: compare all pairs of a site, since the rotations around a triangle of cameras must compose to the identity.

Loops expose look-alikes that a pair's own evidence (`twoview.pair_score`) does not, and confirm pairs that it leaves undecided.

If a scene looks the same from other sides, or along a row, wrong pairs may close all loops.  The ambiguity of pairs
(`twoview.rival_search`) shows this, by the angle between the rotations of the rival and of the accepted pose: part of a full turn
if the scene looks the same from another side, none for another step along a row.  One pair may be ambiguous by chance, and few
pairs of a repetitive scene see its repetition, so all pairs of the site decide together.  Three pairs that are as distinctive as
right ones, yet contradict each other by part of a full turn, are proof on their own."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from math import isfinite, log

import numpy as np

from ..contracts.reasons import Reason, Rejected
from ..core.rotations import angle_between_deg
from ..twoview.pair_score import DISTINCT_CELLS, probability
from ..twoview.rival_pose import SAME_ROTATION_DEG, TURNED_DEG, TURNED_RIVAL_SHARE
from ..types import Bools, Float64s, Geometry, Int64s, Pair
from .rotation_averaging import View, rotations_along_tree

PARTS_DEG = (180.0, 120.0, 90.0, 60.0)
"""Rotations between equal sides of a building, as parts of a full turn: two, three, four and six sides."""
PART_TOLERANCE_DEG = 2.0
"""A rotation is part of a full turn if it differs from one of `PARTS_DEG` by at most this, degrees."""
ROW_SHARE = 0.2
"""A rival with the same rotation indicates a row only if it has at least this share of the accepted inliers."""
ROW_INLIERS = 20
"""A rival with the same rotation indicates a row only if it has at least this many matches: a share of few may be chance."""
LEAST_SCORE_UNCONFIRMED = log(19)
"""Log odds that a pair needs if no third camera confirms it: one in twenty such pairs may be wrong.  A confirmed pair need only
be more likely right than wrong."""
LEAST_SCORE_WITHOUT_SEARCH = 1.0
"""Score that an unconfirmed pair needs if no rival was searched for."""
FEW_PAIRS = 15
"""Up to this many pairs (six cameras), all combinations of right and wrong pairs are evaluated; for more the time would grow as
their number's power of two, so the result is approximate."""
LOOP_WEIGHT = 0.5
"""Weight of a triangle in the approximation: triangles share pairs, so their evidence is not independent."""
LOOP_CAP = 6.0
"""Most by which all closed triangles of a pair, and likewise all open ones, change its log odds in the approximation."""
ROUNDS = 15
"""Rounds of the approximation, each of which goes halfway to the new log odds."""
PRIOR_SHIFT = 0.5
"""Subtracted from the score of a pair for its log odds before loops are considered."""


class AmbiguityKind(Enum):
    """How the pose of a pair's rival differs from the accepted one."""

    NONE = "none"
    TURNED = "turned"
    SIDE = "side"
    """Turned by part of a full turn."""
    ROW = "row"
    """Not turned at all."""


@dataclass(frozen=True)
class Shares:
    """Shares of the pairs of a scene whose rivals are of each kind."""

    turned: float
    side: float
    row: float

    @property
    def none(self) -> float:
        """The share of the other pairs."""
        return 1 - self.turned - self.side - self.row

    def log_odds(self, other: Shares, kind: AmbiguityKind) -> float:
        """Log likelihood ratio of this scene over the other, given the kind of one pair's rival."""
        return log(getattr(self, kind.value) / getattr(other, kind.value))


FROM_OTHER_SIDES = Shares(turned=0.3, side=0.2, row=0.01)
"""Shares in scenes that look the same from other sides.  Derived from what pairs can see, as only one family of such scenes could
be measured: only cameras around a corner see another side."""
IN_A_ROW = Shares(turned=0.1, side=0.01, row=0.5)
"""Shares in scenes that look the same along a row, derived likewise: any two cameras at a row see another house."""
P_REPEATS = 0.2
"""Prior probability of a scene to look the same from other sides, and likewise along a row."""


def ambiguity_kind(geometry: Geometry) -> AmbiguityKind | None:
    """The kind of a pair's rival, None if none was searched for."""
    turned = geometry.rival_turned_deg
    if not isfinite(turned):
        return None
    share = geometry.rival_elsewhere / max(geometry.inliers, 1)
    if share >= TURNED_RIVAL_SHARE and _is_part_of_turn(turned):
        return AmbiguityKind.SIDE
    if share >= ROW_SHARE and geometry.rival_elsewhere >= ROW_INLIERS and turned < SAME_ROTATION_DEG:
        return AmbiguityKind.ROW
    if share >= TURNED_RIVAL_SHARE and turned > TURNED_DEG:
        return AmbiguityKind.TURNED
    return AmbiguityKind.NONE


def _is_part_of_turn(degrees: float) -> bool:
    """Whether a rotation by this angle turns a building with equal sides onto itself."""
    return min(abs(degrees - part) for part in PARTS_DEG) <= PART_TOLERANCE_DEG


def distinct_copies(posed: Mapping[Pair, Geometry], triangles: Iterable[tuple[str, str, str]]) -> bool:
    """Whether triangles of distinctive pairs that do not close are mostly off by part of a full turn.

    One of the three pairs is wrong then, and matches two different sides of a building as well as a right pair matches one.
    By chance, a sixth of all rotations are this close to part of a turn; so most of the open triangles must be.
    """
    turned = []
    for triangle in triangles:
        pairs = [posed[side] for side in sides_of(triangle)]
        if min(g.distinct_cells for g in pairs) < DISTINCT_CELLS:
            continue
        R_ab, R_bc, R_ac = (_pose(g)[0] for g in pairs)
        degrees = angle_between_deg(R_ac, R_bc @ R_ab)
        if degrees > TURNED_DEG:
            turned.append(_is_part_of_turn(degrees))
    return 2 * turned.count(True) > len(turned)


def why_ambiguous(geometries: Iterable[Geometry], unrepeated: Shares) -> Reason | None:
    """In which way a scene repeats, None if it more likely does not; unrepeated: the shares of scenes that do not repeat."""
    prior = log(P_REPEATS / (1 - P_REPEATS))
    evidence_of_sides = 0.0
    evidence_of_row = 0.0
    for geometry in geometries:
        kind = ambiguity_kind(geometry)
        if kind is not None:
            evidence_of_sides += FROM_OTHER_SIDES.log_odds(unrepeated, kind)
            evidence_of_row += IN_A_ROW.log_odds(unrepeated, kind)
    odds_of_sides = prior + evidence_of_sides
    odds_of_row = prior + evidence_of_row
    if max(odds_of_sides, odds_of_row) <= 0:
        return None
    return Reason.SAME_FROM_OTHER_SIDES if odds_of_sides >= odds_of_row else Reason.SAME_ALONG_A_ROW


@dataclass(frozen=True)
class LoopCheck:
    """Result of the loop check for one pair."""

    good_probability: float
    """Probability of the pair after the check."""
    rejected: Rejected | None
    """Why the pair must not be used, None if it may be."""
    triangles: int
    """Number of loops of three cameras with the pair."""
    closed: int
    """Number of those loops that close."""


@dataclass(frozen=True)
class LoopStatistics:
    """Statistics of scenes that do not repeat, as measured by `scripts/bench_verdict.py`."""

    rotation_deg: float
    direction_deg: float
    """A triangle closes if its rotations return within `rotation_deg`, and its third direction is within `direction_deg` of the
    arc between the other two."""
    closed_right: float
    """Share of the triangles of right pairs that close."""
    closed_wrong: float
    """Share of the triangles with a wrong pair that close."""
    rivals: Shares


WITHOUT_REPETITION = LoopStatistics(
    rotation_deg=6.0,
    direction_deg=15.0,
    closed_right=0.99,
    closed_wrong=0.05,
    rivals=Shares(turned=0.2, side=0.012, row=0.01),
)
"""As measured by `scripts/bench_verdict.py` on scenes that do not repeat."""


def check_loops(
    geometries: Mapping[Pair, Geometry],
    uncertainty_deg: Mapping[Pair, float] | None = None,
    statistics: LoopStatistics = WITHOUT_REPETITION,
) -> dict[Pair, LoopCheck]:
    """Judge all pairs of a site together: which of them may be used for solving poses.

    The triangles of cameras give posterior log odds (exact for few pairs, else mean-field).  Then pairs that disagree with the
    rotations along the maximum spanning tree of the accepted pairs are dropped.  Pairs without a relative pose are judged by
    their score alone; a pair in no triangle needs a score above `LEAST_SCORE_UNCONFIRMED` (or `LEAST_SCORE_WITHOUT_SEARCH`).

    uncertainty_deg: additional tolerance for the rotations of pairs whose lenses are only guessed: a triangle that a wrong focal
    length may keep open is no evidence against its pairs.
    """
    posed = {pair: g for pair, g in geometries.items() if g.cam2_R_cam1 is not None and g.cam2_t_cam1 is not None}
    uncertainty = uncertainty_deg or {}

    # 1. Which triangles close; members: (t, 3) rows of their pairs.
    triangles = triangles_of(posed)
    sides = [sides_of(triangle) for triangle in triangles]
    is_closed = np.zeros(len(triangles), dtype=bool)
    for k, triangle in enumerate(triangles):
        slack_deg = max(uncertainty.get(side, 0.0) for side in sides[k])
        is_closed[k] = closes(posed, *triangle, statistics, slack_deg)
    row = {pair: k for k, pair in enumerate(geometries)}
    members = np.array([[row[side] for side in three] for three in sides], dtype=np.int64).reshape(-1, 3)

    # 2. The posterior of each pair.
    prior = np.array([float(np.clip(g.score, -6, 6)) - PRIOR_SHIFT for g in geometries.values()])
    posterior = _exact_log_odds if len(geometries) <= FEW_PAIRS else _approximate_log_odds
    log_odds = posterior(prior, members, is_closed, statistics).tolist()

    # 3. Reject improbable pairs, then those that contradict other accepted ones.
    total = np.bincount(members.ravel(), minlength=len(geometries)).tolist()
    closing = np.bincount(members[is_closed].ravel(), minlength=len(geometries)).tolist()
    figures: dict[Pair, dict[str, float]] = {}
    rejections: dict[Pair, Rejected | None] = {}
    for k, (pair, g) in enumerate(geometries.items()):
        figures[pair] = {"score": g.score, "distinct_cells": g.distinct_cells, "closed": closing[k], "triangles": total[k]}
        rejections[pair] = _rejection(g, log_odds[k], figures[pair])
    accepted_pairs = {pair for pair in posed if rejections[pair] is None}
    for pair, reason in _unsupported(accepted_pairs, geometries, sides, is_closed).items():
        rejections[pair] = Rejected(reason, figures[pair])
    accepted = {pair: log_odds[row[pair]] for pair in posed if rejections[pair] is None}
    for pair, degrees in _against_tree(posed, accepted, uncertainty, statistics.rotation_deg).items():
        rejections[pair] = Rejected(Reason.TURNED, {"turned_deg": degrees})

    # 4. In a scene that repeats, wrong pairs may close all loops: no pose can be trusted.
    if distinct_copies(posed, triangles):
        repeats: Reason | None = Reason.SAME_FROM_OTHER_SIDES
    else:
        repeats = why_ambiguous(posed.values(), statistics.rivals)
    if repeats is not None:
        for pair in posed:
            rejections[pair] = rejections[pair] or Rejected(repeats, figures[pair])

    checks = {}
    for k, (pair, rejected) in enumerate(rejections.items()):
        p = probability(log_odds[k])
        checks[pair] = LoopCheck(p if rejected is None else min(p, 0.5), rejected, total[k], closing[k])
    return checks


def _rejection(geometry: Geometry, log_odds: float, figures: dict[str, float]) -> Rejected | None:
    """Why a pair is rejected, None if it is accepted; log_odds: its posterior log odds."""
    if figures["triangles"] == 0 and 0 < geometry.score <= _least_score_alone(geometry):
        return Rejected(Reason.UNCONFIRMED, figures)
    if log_odds > 0:
        return None
    if geometry.score > 0:
        return Rejected(Reason.LOOK_ALIKE, figures)
    if geometry.score == 0:  # the score is capped at 0 for a pair that is ambiguous, or contradicted by its intrinsics
        return Rejected(Reason.AMBIGUOUS, figures)
    return Rejected(Reason.NOT_BELIEVED, figures)


def _least_score_alone(geometry: Geometry) -> float:
    """The score that this pair needs if no third camera confirms it."""
    has_been_searched = isfinite(geometry.rival_turned_deg)
    return LEAST_SCORE_UNCONFIRMED if has_been_searched else LEAST_SCORE_WITHOUT_SEARCH


def _unsupported(
    accepted: set[Pair], geometries: Mapping[Pair, Geometry], triangle_sides: list[tuple[Pair, Pair, Pair]], closed: Bools
) -> dict[Pair, Reason]:
    """Accepted pairs that must not place any camera.

    If a triangle of three accepted pairs does not close, one of them is wrong, but it is unknown which: copies of a building
    contradict each other, with scores like those of right pairs.  So at least as many of a pair's triangles of accepted pairs
    must be closed as open; if none is closed, the pair needs the score of an unconfirmed one.
    """
    closed_count = dict.fromkeys(accepted, 0)
    open_count = dict.fromkeys(accepted, 0)
    for sides, is_closed in zip(triangle_sides, closed.tolist(), strict=True):
        if not accepted.issuperset(sides):
            continue
        count = closed_count if is_closed else open_count
        for side in sides:
            count[side] += 1
    unsupported = {}
    for pair in accepted:
        if open_count[pair] > closed_count[pair]:
            unsupported[pair] = Reason.LOOK_ALIKE
        elif closed_count[pair] == 0 and geometries[pair].score <= _least_score_alone(geometries[pair]):
            unsupported[pair] = Reason.UNCONFIRMED
    return unsupported


def triangles_of(pairs: Collection[tuple[View, View]]) -> list[tuple[View, View, View]]:
    """Triangles (a, b, c) with pairs a--b, b--c and a--c, in the order of the cameras."""
    successors: dict[View, set[View]] = {}
    for a, b in pairs:
        successors.setdefault(a, set()).add(b)
    triangles = []
    for a, b in pairs:
        triangles += [(a, b, c) for c in sorted(successors.get(b, set()) & successors[a])]
    return triangles


def sides_of(triangle: tuple[View, View, View]) -> tuple[tuple[View, View], tuple[View, View], tuple[View, View]]:
    """The pairs of a triangle."""
    a, b, c = triangle
    return (a, b), (b, c), (a, c)


def closes(
    posed: Mapping[Pair, Geometry],
    a: str,
    b: str,
    c: str,
    statistics: LoopStatistics = WITHOUT_REPETITION,
    slack_deg: float = 0.0,
) -> bool:
    """Do the rotations around the triangle return, and does the direction a to c lie between a to b and b to c?

    Parameters
    ----------
    posed : geometries by pair.
    a, b, c : ids of the cameras.
    statistics : with the tolerances.
    slack_deg : additional tolerance, for lenses that are only guessed.
    """
    R_ab, t_ab = _pose(posed[a, b])
    R_bc, t_bc = _pose(posed[b, c])
    R_ac, t_ac = _pose(posed[a, c])
    if angle_between_deg(R_ac, R_bc @ R_ab) > statistics.rotation_deg + slack_deg:
        return False
    # unit directions in the axes of a
    to_b = -R_ab.T @ t_ab
    b_to_c = -R_ab.T @ (R_bc.T @ t_bc)
    to_c = -R_ac.T @ t_ac
    normal = np.cross(to_b, b_to_c)
    if np.linalg.norm(normal) >= 0.05:  # cameras almost in line span no plane
        normal /= np.linalg.norm(normal)
        in_plane = to_c - (to_c @ normal) * normal
        weights = np.linalg.lstsq(np.column_stack([to_b, b_to_c]), in_plane, rcond=None)[0]
        if (weights >= 0).all():  # over the arc between both directions: only the angle to their plane counts
            return bool(abs(to_c @ normal) < np.sin(np.radians(statistics.direction_deg + slack_deg)))
    nearest = max(to_c @ to_b, to_c @ b_to_c)  # cosine of the angle to the nearer end of the arc
    return bool(nearest > np.cos(np.radians(statistics.direction_deg + slack_deg)))


def _pose(geometry: Geometry) -> tuple[Float64s, Float64s]:
    """`cam2_R_cam1` (3, 3) and `cam2_t_cam1` (3,) of a pair that has them."""
    assert geometry.cam2_R_cam1 is not None and geometry.cam2_t_cam1 is not None
    return geometry.cam2_R_cam1, geometry.cam2_t_cam1


def _exact_log_odds(prior: Float64s, members: Int64s, closed: Bools, statistics: LoopStatistics) -> Float64s:
    """Posterior log odds of each pair, over all combinations of right and wrong pairs.

    For few pairs, the approximation would let two wrong pairs that agree reinforce each other: views from the opposite side, each
    turned by half a turn, close triangles with right pairs.
    """
    # (2^n, n): a row for each combination, with a bit for each pair
    is_right = (np.arange(1 << len(prior))[:, None] >> np.arange(len(prior)) & 1).astype(bool)
    log_likelihood = np.zeros(len(is_right))
    for column, odds in zip(is_right.T, prior.tolist(), strict=True):
        log_likelihood[column] += odds
    for triangle, is_closed in zip(members, closed.tolist(), strict=True):
        p_all_right = statistics.closed_right if is_closed else 1 - statistics.closed_right
        p_any_wrong = statistics.closed_wrong if is_closed else 1 - statistics.closed_wrong
        if_right, if_wrong = np.log([p_all_right, p_any_wrong])
        log_likelihood += np.where(is_right[:, triangle].all(axis=1), if_right, if_wrong)
    weight = np.exp(log_likelihood - log_likelihood.max())
    # the addend keeps the ratio finite for a pair that is right, or wrong, in every plausible combination
    ratios = [(weight[column].sum() + 1e-12) / (weight[~column].sum() + 1e-12) for column in is_right.T]
    return np.asarray(np.log(ratios), dtype=np.float64)


def _approximate_log_odds(prior: Float64s, members: Int64s, closed: Bools, statistics: LoopStatistics) -> Float64s:
    """Approximate posterior log odds of each pair, after damped rounds of mean-field messages from the triangles."""
    log_odds = prior.copy()
    if not len(members):
        return log_odds
    p_right = statistics.closed_right
    p_wrong = statistics.closed_wrong
    for _ in range(ROUNDS):
        p = 1 / (1 + np.exp(-log_odds))
        support = np.zeros(len(prior))
        opposition = np.zeros(len(prior))
        for side in range(3):
            # likelihood ratio of the triangle for this pair: 1 if another pair of it is wrong anyway
            p_others = p[members[:, (side + 1) % 3]] * p[members[:, (side + 2) % 3]]
            if_closed = np.log((p_others * p_right + (1 - p_others) * p_wrong) / p_wrong)
            if_open = np.log((p_others * (1 - p_right) + (1 - p_others) * (1 - p_wrong)) / (1 - p_wrong))
            np.add.at(support, members[closed, side], if_closed[closed])
            np.add.at(opposition, members[~closed, side], if_open[~closed])
        evidence = np.minimum(LOOP_WEIGHT * support, LOOP_CAP) + np.maximum(LOOP_WEIGHT * opposition, -LOOP_CAP)
        log_odds = 0.5 * log_odds + 0.5 * (prior + evidence)
    return log_odds


def _against_tree(
    posed: Mapping[Pair, Geometry], accepted: Mapping[Pair, float], uncertainty_deg: Mapping[Pair, float], limit_deg: float
) -> dict[Pair, float]:
    """Accepted pairs whose rotation is off by more than `limit_deg` from the maximum spanning tree's, and by how much."""
    relative = {pair: _pose(posed[pair])[0] for pair in accepted}
    world = rotations_along_tree(relative, accepted)
    against = {}
    for (a, b), R in relative.items():
        error_deg = angle_between_deg(R, world[b] @ world[a].T)
        if error_deg > limit_deg + uncertainty_deg.get((a, b), 0.0):
            against[a, b] = error_deg
    return against

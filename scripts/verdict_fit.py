"""Logistic regression for the score of a pair, fitted on some scenes and judged on others.

The few terms are constrained to their plausible signs, and a small penalty draws the weights toward an earlier fit.  All scenes
have the same weight, and so have the right and the wrong pairs of a scene; otherwise the number of cameras, or of pairs without
overlap, would determine the offset.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from wbflow_stages.twoview.pair_score import PairEvidence, pair_score, terms
from wbflow_stages.twoview.rival_pose import RivalPose
from wbflow_stages.types import Bools, Camera, Float64s, Geometry


@dataclass(frozen=True)
class Term:
    """A term of the score: its name, and the sign of its weight (1: larger values make a pair more likely right; -1: less)."""

    name: str
    sign: int


TERMS = (
    Term("ln(1 + distinct_cells)", 1),
    Term("distinct_share", 1),
    Term("agreement", 1),
    Term("ln(1 + inliers)", 1),
    Term("ln(stretch + .01)", 1),
    Term("ln(min(angle_deg, 15) + .3)", 1),
    Term("ln(half_rotation_deg + .01)", -1),
    Term("ln((rival inliers + 20) / (inliers + 20))", -1),
)

BEFORE = (0.54, 8.9, 4.8, 0.53, 2.7, 0.0, -0.84, 0.0)
"""Weights of the terms in an earlier fit, on 263 pairs of other scenes (look-alike walls, a courtyard).  They remain where the
pairs here carry no information."""
PENALTY = 0.005
"""Penalty on the squared differences of the weights (of standardised terms) from `BEFORE`, added to the mean loss of a pair."""


Errors = tuple[float, float]
"""Errors in degrees of the relative rotation, and of the direction of the baseline."""
USABLE, WRONG = (3.0, 10.0), (10.0, 30.0)
"""A pair is usable if both errors are below those of `USABLE`, and wrong if either error is above that of `WRONG`."""
LEAST_RIGHT = 0.2
"""Smallest share of right matches of a usable pair: in a row of houses, a wrong house may give the true pose by accident."""


@dataclass(frozen=True)
class LabelledPair:
    """A pair with its geometry and the true errors of that geometry."""

    set: str
    left: str
    right: str
    geometry: Geometry
    error_deg: Errors
    error_of_copy_deg: Errors
    """Errors against the nearest symmetric copy of the camera, for scenes that look the same after a part of a turn."""
    right_share: float
    """Share of its matches that are right, by the true depth, or by the true epipolar lines for scenes without depth."""

    @cached_property
    def evidence(self) -> PairEvidence:
        g = self.geometry
        rival = RivalPose(g.rival_inliers, g.rival_elsewhere, g.rival_turned_deg) if np.isfinite(g.rival_turned_deg) else None
        return PairEvidence(
            g.inliers, g.distinct_cells, g.distinct_share, g.agreement, g.half_rotation_deg, g.stretch, g.angle_deg, rival
        )

    @property
    def contradicted(self) -> bool:
        """The intrinsics contradict F."""
        return self.geometry.model == "F"

    @property
    def ambiguous(self) -> bool:
        rival = self.evidence.rival
        return rival is not None and rival.ambiguous(self.evidence.inliers)

    @property
    def score(self) -> float:
        """The score with the product's current weights."""
        return pair_score(self.evidence, self.contradicted)

    @property
    def usable(self) -> bool:
        return is_usable(self.error_deg) and self.right_share >= LEAST_RIGHT

    @property
    def wrong(self) -> bool:
        return is_wrong(self.error_deg)


@dataclass(frozen=True)
class LabelledSet:
    """The pairs of a set that have a geometry, and the true cameras by name."""

    pairs: tuple[LabelledPair, ...]
    cameras: Mapping[str, Camera]


def is_usable(error: Errors) -> bool:
    return error[0] < USABLE[0] and error[1] < USABLE[1]


def is_wrong(error: Errors) -> bool:
    return error[0] > WRONG[0] or error[1] > WRONG[1]


@dataclass(frozen=True)
class Weights:
    """Weights of the terms (in the terms' own units), and the offset."""

    terms: Float64s
    offset: float

    def scores(self, pairs: list[LabelledPair]) -> Float64s:
        """(n,) log odds of the pairs; the product's own score for pairs to which these weights do not apply (see `fitted`)."""
        own = [np.array(terms(p.evidence)) @ self.terms + self.offset if fitted(p) else p.score for p in pairs]
        return np.array([min(s, 0.0) if p.ambiguous else s for s, p in zip(own, pairs, strict=True)], np.float64)


def fitted(pair: LabelledPair) -> bool:
    """Whether the weights apply to the pair: it has an essential matrix, and a rival pose was searched for."""
    return pair.evidence.rival is not None and not pair.contradicted


def fit(pairs: list[LabelledPair], penalty: float = PENALTY) -> Weights:
    """Weights from the clearly usable or wrong pairs; symmetric copies count as right, since no pair can exclude them."""
    plain = [p for p in pairs if fitted(p) and (is_usable(p.error_of_copy_deg) or is_wrong(p.error_of_copy_deg))]
    x = np.array([terms(p.evidence) for p in plain], np.float64)
    right = np.array([is_usable(p.error_of_copy_deg) for p in plain])
    mean, spread = x.mean(axis=0), x.std(axis=0) + 1e-9
    z, weight, sign = (x - mean) / spread, balance(plain, right), np.array([term.sign for term in TERMS])

    before = np.array(BEFORE) * spread

    def loss(w: Float64s) -> tuple[float, Float64s]:
        s = z @ w[:-1] + w[-1]
        p = 1 / (1 + np.exp(-s))
        away = w[:-1] - before
        value = weight @ np.logaddexp(0, np.where(right, -s, s)) + penalty * away @ away
        pull = weight * (p - right)
        return float(value), np.append(z.T @ pull + 2 * penalty * away, pull.sum())

    bounds = [(0, None) if s > 0 else (None, 0) for s in sign] + [(None, None)]
    found = minimize(loss, np.zeros(x.shape[1] + 1), jac=True, bounds=bounds, method="L-BFGS-B").x
    own = found[:-1] / spread
    return Weights(own, float(found[-1] - own @ mean))


def balance(pairs: list[LabelledPair], right: Bools) -> Float64s:
    """(n,) weights that add to 1: equal totals for the right and the wrong pairs of each scene, less if these are under 10."""
    key = [(pair.set.split("-")[0], bool(r)) for pair, r in zip(pairs, right, strict=True)]
    count = {k: key.count(k) for k in set(key)}
    weight = np.array([1 / max(count[k], 10) for k in key])
    return np.asarray(weight / weight.sum())

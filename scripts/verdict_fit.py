"""The logistic score of a pair, fitted on some scenes and judged on others.

Few terms, each with the sign that makes sense, and a small penalty on leaving an earlier fit.  Every scene weighs the same, and
within a scene its right and its wrong pairs, so that neither the number of cameras nor that of pairs without overlap sets the
offset.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from wbflow_stages.twoview.ambiguity import Ambiguity
from wbflow_stages.twoview.pair_score import PairEvidence, pair_score, terms
from wbflow_stages.types import Bools, Camera, Float64s, Geometry


@dataclass(frozen=True)
class Term:
    """A term of the score: its name, and whether more of it speaks for a pair (1) or against it (-1)."""

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
"""Weights of the terms in an earlier fit, on 263 pairs of other scenes (look-alike walls, a courtyard): where the pairs here tell
nothing, these stay."""
PENALTY = 0.005
"""On the squares of what the weights of standardised terms differ by from `BEFORE`, against the mean loss of a pair."""


Errors = tuple[float, float]
"""Degrees: of the relative rotation, and of the direction of the baseline."""
USABLE, WRONG = (3.0, 10.0), (10.0, 30.0)
"""A pair is usable below both errors, and wrong above one of them."""
LEAST_RIGHT = 0.2
"""Nor is it usable if fewer of its matches are right: in a row of houses the next house may tell the true pose by accident."""


@dataclass(frozen=True)
class LabelledPair:
    """A pair with its geometry, and what it is in truth."""

    set: str
    left: str
    right: str
    geometry: Geometry
    error_deg: Errors
    error_of_copy_deg: Errors
    """Against the nearest copy of the cameras, where the scene is the same after a part of a turn."""
    right_share: float
    """Of its matches, by the true depth, or the true lines where no depth is known."""

    @cached_property
    def evidence(self) -> PairEvidence:
        g = self.geometry
        rival = Ambiguity(g.rival_inliers, g.rival_elsewhere, g.rival_turned_deg) if np.isfinite(g.rival_turned_deg) else None
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
        """As the product has it."""
        return pair_score(self.evidence, self.contradicted)

    @property
    def usable(self) -> bool:
        return is_usable(self.error_deg) and self.right_share >= LEAST_RIGHT

    @property
    def wrong(self) -> bool:
        return is_wrong(self.error_deg)


@dataclass(frozen=True)
class LabelledSet:
    """The pairs of a set that have a geometry, and the true cameras."""

    pairs: tuple[LabelledPair, ...]
    cameras: Mapping[str, Camera]


def is_usable(error: Errors) -> bool:
    return error[0] < USABLE[0] and error[1] < USABLE[1]


def is_wrong(error: Errors) -> bool:
    return error[0] > WRONG[0] or error[1] > WRONG[1]


@dataclass(frozen=True)
class Weights:
    """Of the terms, in their own units, and what is added."""

    terms: Float64s
    offset: float

    def scores(self, pairs: list[LabelledPair]) -> Float64s:
        """(n,) log odds of the pairs; of those that these weights are not for (`fitted`), as the product has them."""
        own = [np.array(terms(p.evidence)) @ self.terms + self.offset if fitted(p) else p.score for p in pairs]
        return np.array([min(s, 0.0) if p.ambiguous else s for s, p in zip(own, pairs, strict=True)], np.float64)


def fitted(pair: LabelledPair) -> bool:
    """Is the pair one that the weights are for: with an essential matrix, of which rivals were looked for?"""
    return pair.evidence.rival is not None and not pair.contradicted


def fit(pairs: list[LabelledPair], penalty: float = PENALTY) -> Weights:
    """Weights from the pairs that are plainly usable or wrong; copies count as right, since no pair tells them apart."""
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
    """(n,) weights that add to 1: each scene as much as any other, up to its number of pairs where it has few of a kind."""
    key = [(pair.set.split("-")[0], bool(r)) for pair, r in zip(pairs, right, strict=True)]
    count = {k: key.count(k) for k in set(key)}
    weight = np.array([1 / max(count[k], 10) for k in key])
    return np.asarray(weight / weight.sum())

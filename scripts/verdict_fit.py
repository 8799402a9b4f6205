"""The logistic score of a pair, fitted on some scenes and judged on others.

Few terms, each with the sign that makes sense, and a small penalty on leaving an earlier fit.  Every scene weighs the same, and within a
scene its right and its wrong pairs, so that neither the number of cameras nor that of pairs without overlap sets the offset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from wbflow_stages.twoview.pair_score import TERMS, PairEvidence, terms
from wbflow_stages.types import Bools, Float64s

BEFORE = (0.54, 8.9, 4.8, 0.53, 2.7, 0.0, -0.84, 0.0)
"""Weights of the terms in an earlier fit, on 263 pairs of other scenes (look-alike walls, a courtyard): where the pairs here tell
nothing, these stay."""
PENALTY = 0.005
"""On the squares of what the weights of standardised terms differ by from `BEFORE`, against the mean loss of a pair."""


@dataclass(frozen=True)
class LabelledPair:
    """A pair with what speaks for it and what it is in truth."""

    scene: str
    left: str
    right: str
    evidence: PairEvidence
    contradicted: bool
    rotation_deg: float
    """Error of the relative rotation..."""
    translation_deg: float
    """...and of the direction of the baseline."""

    @property
    def ambiguous(self) -> bool:
        rival = self.evidence.rival
        return rival is not None and rival.ambiguous(self.evidence.inliers)

    @property
    def usable(self) -> bool:
        return self.rotation_deg < 3 and self.translation_deg < 10

    @property
    def wrong(self) -> bool:
        return self.rotation_deg > 10 or self.translation_deg > 30


@dataclass(frozen=True)
class Weights:
    """Of the terms, in their own units, and what is added."""

    terms: Float64s
    offset: float

    def scores(self, pairs: list[LabelledPair]) -> Float64s:
        raw = table(pairs) @ self.terms + self.offset
        return np.where([pair.contradicted or pair.ambiguous for pair in pairs], np.minimum(raw, 0), raw)


def table(pairs: list[LabelledPair]) -> Float64s:
    """(n, terms) of the pairs."""
    return np.array([terms(pair.evidence) for pair in pairs], np.float64).reshape(-1, len(TERMS))


def fit(pairs: list[LabelledPair], penalty: float = PENALTY) -> Weights:
    """Weights from the pairs that are plainly usable or wrong."""
    plain = [pair for pair in pairs if (pair.usable or pair.wrong) and not pair.contradicted]
    x, right = table(plain), np.array([pair.usable for pair in plain])
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
    key = [(pair.scene, bool(r)) for pair, r in zip(pairs, right, strict=True)]
    count = {k: key.count(k) for k in set(key)}
    weight = np.array([1 / max(count[k], 10) for k in key])
    return np.asarray(weight / weight.sum())

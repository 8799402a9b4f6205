"""How probable it is that a depth is right: one number from all that speaks for and against it.

A depth is right if its point lies within three pixels' widths of a surface.  Three logistic regressions, each on what the one
before it says: what a view knows of its own depths; what the other views say of them, each as far as it is right itself; and how
right the depths are that lie around on the same plane.

The coefficients are those of `scripts/fit_posterior.py` on rendered scenes with exact truth, depths of pairs and refined ones
alike: a small yard and a small hall, both by night.
"""

from __future__ import annotations

import numpy as np

from ..core.jit import kernel
from ..types import Bools, DepthMap, Float32s, Float64s, Uint32s
from .surface_support import surface_support
from .visibility import CrossCheck, probability

_OWN = np.array([-1.29, 0.68, 3.16, 4.8, 0.11])
"""Of one, a depth that is sure, the logarithm of one more than its pairs, the share of its surroundings that is sure and on its
plane, and the logarithm of its relative standard deviation."""

_OTHERS = np.array([-0.11, 0.64, 0.38, 0.28, 1.3, -0.25, -0.66])
"""Of one, the logit of the above, and what `evidence_of_others` returns."""

_AROUND = np.array([-0.12, 0.93, 0.81])
"""Of one, the logit of the above, and the mean of its probability over the surroundings."""

_LEAST_RELATIVE, _MOST_RELATIVE = 1e-4, 0.1
"""Standard deviations beyond, as shares of the depth, say no more than these."""

_MOST_AGAINST = 8.0
"""Log-likelihood: more than this doesn't count against a depth."""


def own_logit(depth: DepthMap, usable: Bools) -> Float32s:
    """(h, w) log-odds that a view's depths are right, as far as it knows itself; -inf where it has none."""
    return _logit(_OWN, evidence_of_itself(depth, usable), usable & np.isfinite(depth.depth))


def posterior(depth: DepthMap, usable: Bools, own: Float32s, check: CrossCheck) -> Float32s:
    """(h, w) probability that depths are right; 0 where there are none.

    Parameters
    ----------
    depth, usable : of a view, and which of its pixels may be used.
    own : (h, w) of `own_logit`.
    check : what the other views say.
    """
    known = usable & np.isfinite(depth.depth)
    logit = _logit(_OTHERS, [own, *evidence_of_others(check)], known)
    return probability(_logit(_AROUND, [logit, surface_support(depth, known, probability(logit))], known))


def evidence_of_itself(depth: DepthMap, usable: Bools) -> list[Float32s]:
    """(h, w) each: what a view knows of its depths; see `_OWN`."""
    pairs = np.zeros(depth.depth.shape, np.float32)
    _count_bits(depth.support, pairs)
    sure = depth.sure.astype(np.float32)
    with np.errstate(invalid="ignore"):
        relative = np.log(np.clip(depth.sigma / depth.depth, _LEAST_RELATIVE, _MOST_RELATIVE))
    return [sure, np.log1p(pairs), surface_support(depth, usable, sure), relative]


def evidence_of_others(check: CrossCheck) -> list[Float32s]:
    """(h, w) each: what speaks for a depth and against it; its pairs; of the views that could see it, the share that has nothing
    there, and that which has something in front of it."""
    visible = check.visible.astype(np.float32)
    missing = (visible - check.agreeing) / (visible + np.float32(1.0))
    hiding = check.hiding / (visible + check.hiding + np.float32(1.0))
    return [np.log1p(check.supporting), np.maximum(check.opposing, -_MOST_AGAINST), np.log1p(check.pairs), missing, hiding]


def _logit(coefficients: Float64s, evidence: list[Float32s], known: Bools) -> Float32s:
    total = np.full(known.shape, coefficients[0], np.float32)
    for coefficient, values in zip(coefficients[1:], evidence, strict=True):
        total += np.float32(coefficient) * values
    return np.where(known, total, np.float32(-np.inf))


@kernel
def _count_bits(words: Uint32s, count: Float32s) -> None:
    h, w = words.shape
    for y in range(h):
        for x in range(w):
            bits = words[y, x]
            while bits:
                bits &= bits - np.uint32(1)
                count[y, x] += np.float32(1.0)

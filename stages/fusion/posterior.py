"""How probable it is that a depth is right: one number from all that speaks for and against it.

A depth is right if its point lies within two pixels' widths of a surface.  Three logistic regressions, each on what the one
before it says: what a view knows of its own depths; what the other views say of them, each as far as it is right itself; and how
right the depths are that lie around on the same plane, and how much of what is seen there is noise.

The coefficients are those of `scripts/fit_posterior.py` on scenes with exact truth: a small yard and a small hall by night, small
houses by day, and four photographs of the fountain.  They were fitted before a pair could be doubted: fitted anew, they trust
single pairs more, which costs photographs 0.3 points of F at 2 cm and gains nothing elsewhere.  That of noise is fitted on a yard
and a hall without lamps, the others held.  It speaks last, so that it takes points away and never adds any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from ..core.luminance import luminance
from ..types import MOST_PARTNERS, Bools, DepthMap, Float32s, Float64s, Frame
from .surface_support import spacing_px, surface_support
from .visibility import CrossCheck, TrustedDepth, probability

_OWN = np.array([-5.45, 0.56, 2.16, 2.5, -0.66])
"""Of one, a depth that is sure, the logarithm of one more than its pairs, the share of its surroundings that is sure and on its
plane, and the logarithm of its relative standard deviation."""

_OTHERS = np.array([-0.03, 0.52, 0.42, 1.91, -0.39, -1.39])
"""Of one, the logit of the above, and what `evidence_of_others` returns."""

_AROUND = np.array([-0.75, 0.7, 2.94, -0.98])
"""Of one, the logit of the above, the mean of its probability over the surroundings, and `noisiness`."""

_PATCH_PX = 3
"""How far a patch reaches from its middle in an image 768 wide, and as far in larger ones: as those that `refine` compares."""

_QUANTIZED = 1 / 12
"""Variance of grey levels that rounding alone leaves."""

_MOST_LEFT_OUT = 0.5
"""Of a cloud: where more would have to go, too little is sure for a choice."""


def surest(right: Float32s, share: float) -> Bools:
    """(n,) which points stay when the least probable go until a share of the rest is expected to be right.

    right: (n,) their probabilities of being right.
    """
    ranked = np.sort(right)[::-1]
    expected = np.cumsum(ranked, dtype=np.float64) / np.arange(1, len(ranked) + 1)
    count, least = int((expected >= share).sum()), int(np.ceil((1 - _MOST_LEFT_OUT) * len(ranked)))
    if count == len(ranked):
        return np.ones(len(right), np.bool_)
    return np.asarray(right > ranked[count] if count >= least else right >= ranked[least - 1])


def own_logit(depth: DepthMap, usable: Bools) -> Float32s:
    """(h, w) log-odds that a view's depths are right, as far as it knows itself; -inf where it has none."""
    return _logit(_OWN, evidence_of_itself(depth, usable), usable & np.isfinite(depth.depth))


def likelier(found: Sequence[TrustedDepth]) -> TrustedDepth:
    """The first of one or two depths of a view, with the second where the first is not sure and the second is likelier.

    Refined depths are finer than those of pairs, which a probability of being right to two pixels does not show: sure ones stay.
    """
    first, *others = found
    for other in others:
        taken = ~first.depth.sure & (other.own > first.own)
        first = TrustedDepth(_overlaid(first.depth, other.depth, taken), np.where(taken, other.own, first.own))
    return first


def _overlaid(depth: DepthMap, other: DepthMap, taken: Bools) -> DepthMap:
    """Depth of a view with that of another map of the same view where that is `taken` (h, w)."""
    partners = tuple(dict.fromkeys((*depth.partners, *other.partners)))[:MOST_PARTNERS]
    names = ("depth", "sigma", "slope_x", "slope_y", "sure")
    mixed: dict[str, Any] = {name: np.where(taken, getattr(other, name), getattr(depth, name)) for name in names}
    return replace(depth, **mixed, support=np.where(taken, other.support_of(partners), depth.support), partners=partners)


def posterior(depth: DepthMap, frame: Frame, own: Float32s, check: CrossCheck) -> Float32s:
    """(h, w) probability that depths are right; 0 where there are none, or none that a pair shows.

    Parameters
    ----------
    depth, frame : of a view.
    own : (h, w) of `own_logit`.
    check : what the other views say.
    """
    known = frame.mask & np.isfinite(depth.depth) & (check.pairs > 0)
    logit = _logit(_OTHERS, [own, *evidence_of_others(check)], known)
    around = surface_support(depth, known, probability(logit))
    return probability(_logit(_AROUND, [logit, around, noisiness(frame)], known))


def evidence_of_itself(depth: DepthMap, usable: Bools) -> list[Float32s]:
    """(h, w) each: what a view knows of its depths; see `_OWN`."""
    pairs = np.zeros(depth.depth.shape, np.float32)
    for k in range(len(depth.partners)):
        pairs += depth.support & np.uint32(1 << k) > 0
    sure = depth.sure.astype(np.float32)
    with np.errstate(invalid="ignore"):
        relative = np.log(depth.sigma / depth.depth)
    return [sure, np.log1p(pairs), surface_support(depth, usable, sure), relative]


def evidence_of_others(check: CrossCheck) -> list[Float32s]:
    """(h, w) each: what speaks against a depth; the expected number of its pairs that are right; of the views that could see it,
    the share that has nothing there, and that which has something in front of it.  Views that agree add nothing to their pairs,
    which are independent evidence."""
    visible = check.visible.astype(np.float32)
    missing = (visible - check.agreeing) / (visible + np.float32(1.0))
    hiding = check.hiding / (visible + check.hiding + np.float32(1.0))
    pairs = np.maximum(check.pairs - check.doubted, np.float32(0.0))
    return [check.opposing, np.log1p(pairs), missing, hiding]


def noisiness(frame: Frame) -> Float32s:
    """(h, w) logarithm of one more than the variance of the frame's noise over that of the grey levels of the patch around.

    Where it is high a patch shows little but noise, and matches somewhere by chance.
    """
    grey = luminance(frame.image)
    side = 2 * _PATCH_PX * spacing_px(grey.shape) + 1
    mean = cv2.blur(grey, (side, side))
    variance = np.maximum(cv2.blur(grey * grey, (side, side)) - mean * mean, np.float32(_QUANTIZED))
    return np.asarray(np.log1p(np.float32(frame.noise_left**2) / variance), np.float32)


def _logit(coefficients: Float64s, evidence: list[Float32s], known: Bools) -> Float32s:
    total = np.full(known.shape, coefficients[0], np.float32)
    for coefficient, values in zip(coefficients[1:], evidence, strict=True):
        total += np.float32(coefficient) * values
    return np.where(known, total, np.float32(-np.inf))

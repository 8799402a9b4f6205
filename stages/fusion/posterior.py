"""Probability that a depth is right, from all evidence for and against it.

A depth is right if its point lies within two pixel widths of a surface.  Three logistic regressions are chained, each with the
result of the previous one as an input: of the view's own evidence; of the evidence of the other views, each weighted by the
probability that its own depth is right; and of the probability of the surrounding depths on the same plane, and image noise.

The coefficients were fitted by `scripts/fit_posterior.py` on scenes with exact truth: those of `_OWN` on a small yard and a small
hall by night, small houses by day, and four photographs of the fountain; the others on a yard (as it is, behind railings, behind
webs), a market and six photographs of the fountain, because most depths are in doubt where images are hard to match.  That of
noise was fitted on a yard and a hall without lamps, with the others fixed.  It comes last, so that it only ever removes points.
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
"""Coefficients of: the constant 1, whether the depth is sure, log(1 + number of its pairs), the share of its surroundings that is
sure and on its plane, and the logarithm of its relative standard deviation."""

_OTHERS = np.array([-0.63, 0.53, 0.51, 1.68, 0.21])
"""Coefficients of: the constant 1, the logit from `_OWN`, and the three values of `evidence_of_others`."""

_AROUND = np.array([-0.91, 0.65, 4.11, -0.98])
"""Coefficients of: 1, the logit from `_OTHERS`, the mean probability of the depths around on its plane, and `noisiness`."""

_PATCH_PX = 3
"""Half side of the patch of `noisiness`, in pixels of an image 768 wide (scaled for larger ones), as in `refine`."""

_ROUNDING_VARIANCE = 1 / 12
"""Variance of grey levels due to rounding alone."""

_MOST_LEFT_OUT = 0.5
"""Largest share of a cloud that `most_probable` removes: if more had to go, the cloud is too uncertain for a choice."""


def most_probable(probabilities: Float32s, correct_share: float) -> Bools:
    """(n,) points that stay when the least probable ones are removed until `correct_share` of the rest is expected to be right.

    probabilities: (n,) probabilities that the points are right.
    """
    ranked = np.sort(probabilities)[::-1]
    expected = np.cumsum(ranked, dtype=np.float64) / np.arange(1, len(ranked) + 1)
    # expected[k]: expected share of right points if the k + 1 most probable ones are kept; it falls with k
    count = int((expected >= correct_share).sum())
    fewest = int(np.ceil((1 - _MOST_LEFT_OUT) * len(ranked)))
    if count == len(ranked):
        return np.ones(len(probabilities), np.bool_)
    # points of equal probability go, or stay, together: the answer must not depend on their order
    if count >= fewest:
        return np.asarray(probabilities > ranked[count])
    return np.asarray(probabilities >= ranked[fewest - 1])


def own_logit(depth: DepthMap, usable: Bools) -> Float32s:
    """(h, w) log-odds that a view's depths are right, from its own evidence alone; -inf where it has no usable depth."""
    return _logit(_OWN, own_evidence(depth, usable), usable & np.isfinite(depth.depth))


def merge_likelier(depths: Sequence[TrustedDepth]) -> TrustedDepth:
    """The first of one or two depth maps of a view, replaced by the second where it is not sure and the second is likelier.

    Refined depths are finer than those of pairs, which a probability of being right to two pixels does not show: sure ones stay.
    """
    first, *others = depths
    for other in others:
        replaced = ~first.depth.sure & (other.own_logit > first.own_logit)
        logit = np.where(replaced, other.own_logit, first.own_logit)
        first = TrustedDepth(first.frame, _merged(first.depth, other.depth, replaced), logit)
    return first


def _merged(depth: DepthMap, other: DepthMap, replaced: Bools) -> DepthMap:
    """Depth map of a view, with the values of another map of the same view where `replaced` (h, w)."""
    partners = tuple(dict.fromkeys((*depth.partners, *other.partners)))[:MOST_PARTNERS]
    names = ("depth", "sigma", "slope_x", "slope_y", "sure")
    values: dict[str, Any] = {name: np.where(replaced, getattr(other, name), getattr(depth, name)) for name in names}
    return replace(depth, **values, support=np.where(replaced, other.support_of(partners), depth.support), partners=partners)


def posterior(view: TrustedDepth, check: CrossCheck) -> Float32s:
    """(h, w) probability that the depths of a view are right; 0 where there is none, or no pair supports it.

    check: cross-check of the view against the others.
    """
    known = view.frame.mask & np.isfinite(view.depth.depth) & (check.pairs > 0)
    logit = _logit(_OTHERS, [view.own_logit, *evidence_of_others(check)], known)
    # by now, each depth has a probability, which weighs it as a neighbour of others
    surroundings = surface_support(view.depth, known, probability(logit))
    return probability(_logit(_AROUND, [logit, surroundings, noisiness(view.frame)], known))


def own_evidence(depth: DepthMap, usable: Bools) -> list[Float32s]:
    """The view's own evidence, (h, w) each, in the order of `_OWN` without its constant."""
    pairs = np.zeros(depth.depth.shape, np.float32)
    for k in range(len(depth.partners)):
        pairs += depth.support & np.uint32(1 << k) > 0
    sure = depth.sure.astype(np.float32)
    with np.errstate(invalid="ignore"):
        log_relative_sigma = np.log(depth.sigma / depth.depth)
    return [sure, np.log1p(pairs), surface_support(depth, usable, sure), log_relative_sigma]


def evidence_of_others(check: CrossCheck) -> list[Float32s]:
    """Evidence of the other views, (h, w) each: `opposing`, log(1 + number of pairs), and `colours`.  Agreeing views are not
    counted, because their pairs are the independent evidence."""
    return [check.opposing, np.log1p(check.pairs.astype(np.float32)), check.colours]


def noisiness(frame: Frame) -> Float32s:
    """(h, w) log(1 + variance of the frame's noise / variance of the grey levels in the surrounding patch).

    Where it is high, a patch shows little but noise, and matches somewhere by chance.
    """
    grey = luminance(frame.image)
    # E[g^2] - E[g]^2 can be slightly negative in single precision, hence the lower limit
    side = 2 * _PATCH_PX * spacing_px(grey.shape) + 1
    mean = cv2.blur(grey, (side, side))
    variance = np.maximum(cv2.blur(grey * grey, (side, side)) - mean * mean, np.float32(_ROUNDING_VARIANCE))
    return np.asarray(np.log1p(np.float32((frame.noise_left or 0.0) ** 2) / variance), np.float32)


def _logit(coefficients: Float64s, evidence: list[Float32s], known: Bools) -> Float32s:
    total = np.full(known.shape, coefficients[0], np.float32)
    for coefficient, values in zip(coefficients[1:], evidence, strict=True):
        total += np.float32(coefficient) * values
    return np.where(known, total, np.float32(-np.inf))

"""Do other views show a point in the colour that it has in its own view?

Every view that could see a point is a witness, even one without a depth there: two bars of a railing that were taken for one have
lawn behind them in the other views.  How much the colours of one surface differ between two views, and those of different ones,
is measured from both pictures: so surfaces, exposures and grey cameras need no model.
"""

from __future__ import annotations

import numpy as np

from ..types import Bools, Float32s, Int64s, Uint8s

_FEWEST = 200
"""Fewest points on which two views agree from which colours can be compared."""

_MOST_COMPARED = 20_000
"""Largest number of points from which differences are measured."""

_BINS = 16
"""Number of bins of differences, the last one for all larger ones."""

_BINS_PER_SIGMA = 2
"""Bins per standard deviation of the differences on one surface."""

_MOST = np.float32(2.5)
"""Largest log-likelihood ratio of one view: its colour may be that of something in front of the point, or of a reflection."""


def colour_evidence(own: Uint8s, other: Uint8s, agreeing: Bools) -> Float32s:
    """(n,) log-likelihood ratios of points' colours in another view, right depth to wrong depth; 0 if too few points agree.

    Parameters
    ----------
    own, other : (n, 3) RGB of the points in their own view, and in the other one.
    agreeing : (n,) points on whose depth both views agree.
    """
    if np.count_nonzero(agreeing) < _FEWEST:
        return np.zeros(len(own), np.float32)
    # 1. Differences on one surface, where depths agree; and by chance, with a place far away in the picture.
    difference = other.astype(np.float32) - own
    elsewhere = np.roll(other, len(other) // 2, axis=0)
    same = _sampled(difference[agreeing])
    chance = _sampled(elsewhere).astype(np.float32) - _sampled(own)

    # 2. Both in units of the spread on one surface: robust standard deviation of each colour, plus the rounding of grey levels.
    usual = np.median(same, axis=0)
    rounding = np.float32(0.5)
    sigma = np.float32(1.4826) * np.median(np.abs(same - usual), axis=0) + rounding

    # 3. The ratio of their histograms; one more in each bin keeps empty ones from being certain.
    same_counts = np.bincount(_bins(same, usual, sigma), minlength=_BINS) + 1.0
    chance_counts = np.bincount(_bins(chance, usual, sigma), minlength=_BINS) + 1.0
    ratio = np.log(same_counts / same_counts.sum()) - np.log(chance_counts / chance_counts.sum())
    limited = ratio.astype(np.float32).clip(-_MOST, _MOST)
    return np.asarray(limited[_bins(difference, usual, sigma)])


def _sampled(values: np.ndarray) -> np.ndarray:
    """At most about `_MOST_COMPARED` of the values (n, 3), evenly spread."""
    return values[:: max(1, len(values) // _MOST_COMPARED)]


def _bins(difference: Float32s, usual: Float32s, sigma: Float32s) -> Int64s:
    """(n,) bin of each difference (n, 3), by its root mean square over the colours in sigmas."""
    squared = np.square((difference - usual) / sigma)
    deviation = np.sqrt((squared[:, 0] + squared[:, 1] + squared[:, 2]) / np.float32(3))
    return np.asarray(np.minimum(deviation * _BINS_PER_SIGMA, _BINS - 1), np.int64)

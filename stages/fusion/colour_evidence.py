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
_BINS, _BINS_PER_SIGMA = 16, 2
"""Number of bins of differences, the last one for all larger ones; and bins per standard deviation."""
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
    difference = other.astype(np.float32) - own
    elsewhere = np.roll(other, len(other) // 2, axis=0)  # far away in the picture: colours of other surfaces
    same, chance = _sampled(difference[agreeing]), _sampled(elsewhere).astype(np.float32) - _sampled(own)
    usual = np.median(same, axis=0)
    rounding = np.float32(0.5)  # of grey levels
    sigma = np.float32(1.4826) * np.median(np.abs(same - usual), axis=0) + rounding
    counts = [np.bincount(_bins(some, usual, sigma), minlength=_BINS) + 1.0 for some in (same, chance)]
    ratio = np.log(counts[0] / counts[0].sum()) - np.log(counts[1] / counts[1].sum())
    return np.asarray(ratio.astype(np.float32).clip(-_MOST, _MOST)[_bins(difference, usual, sigma)])


def _sampled(values: np.ndarray) -> np.ndarray:
    return values[:: max(1, len(values) // _MOST_COMPARED)]


def _bins(difference: Float32s, usual: Float32s, sigma: Float32s) -> Int64s:
    squared = np.square((difference - usual) / sigma)
    deviation = np.sqrt((squared[:, 0] + squared[:, 1] + squared[:, 2]) / np.float32(3))
    return np.asarray(np.minimum(deviation * _BINS_PER_SIGMA, _BINS - 1), np.int64)

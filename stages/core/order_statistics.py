"""Medians, percentiles and extremes of a few thousand values, in half the time of numpy's own or less."""

from __future__ import annotations

import numpy as np

from ..types import Float64s


def median(values: Float64s) -> float:
    """The median of values (n,), to the bit that of numpy."""
    k = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, k)[k])
    ordered = np.partition(values, (k - 1, k))
    return 0.5 * float(ordered[k - 1] + ordered[k])


def percentiles(values: Float64s, *shares: float) -> list[float]:
    """The values (n,) below which `shares` percent of them lie, linear between two, as numpy's default has it."""
    last = len(values) - 1
    places = [share / 100 * last for share in shares]
    ordered = np.partition(values, sorted({min(int(place) + k, last) for place in places for k in (0, 1)}))
    return [float((1 - place % 1) * ordered[int(place)] + place % 1 * ordered[min(int(place) + 1, last)]) for place in places]


def extremes(points: Float64s) -> tuple[Float64s, Float64s]:
    """Smallest and largest coordinates (2,), (2,) of points (n, 2)."""
    columns = np.ascontiguousarray(points.T)  # several times faster than along the long axis
    return columns.min(axis=1), columns.max(axis=1)

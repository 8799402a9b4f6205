"""The first matches of a pair: mutual nearest neighbours that their own neighbours confirm, each by its local affine frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.jit import kernel
from ..core.nearest_points import nearest_points
from ..types import Float64s, Int32s
from .assignment import without_repeats
from .candidates import ViewPair, inverses, mutual_neighbours

MAX_RATIO = 0.85
"""First over second descriptor distance of a first match, at most."""
CONFIRMING_NEIGHBOURS = 24
CONFIRM_PX, CONFIRM_PER_PX, CONFIRM_RAD, CONFIRM_LOG_SCALE = 8.0, 0.3, 0.6, 0.8
"""A neighbour confirms a match within 8 px + 0.3 of their distance, 0.6 rad and a log scale of 0.8."""


@dataclass(frozen=True)
class Correspondences:
    """Matches to start from."""

    i1: Int32s
    i2: Int32s
    """(n,) int32 rows of the two `Features`."""
    probability: Float64s
    """(n,) float64, p of the accepted match."""


def initial_matches(pairs: tuple[ViewPair, ...]) -> Correspondences:
    """Mutual nearest neighbours that are clearly nearest, or that their neighbours confirm; weight 1 each."""
    if not pairs:
        return Correspondences(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0))
    i1, i2, x1, x2, affine, ratio = (np.concatenate(parts) for parts in zip(*map(_clear, pairs), strict=True))
    if len(pairs) > 1:
        keep = without_repeats(x1, x2, 1 - ratio)
        i1, i2, x1, x2, affine, ratio = (part[keep] for part in (i1, i2, x1, x2, affine, ratio))
    confirmed = confirmations(x1, x2, affine)
    good = (confirmed >= 2) | ((confirmed >= 1) & (ratio < 0.75)) | (ratio < 0.55)
    if good.sum() < 8:
        good = np.zeros(len(ratio), dtype=bool)
        good[np.argsort(ratio - 0.2 * confirmed, kind="stable")[:8]] = True
    return Correspondences(i1[good], i2[good], np.ones(int(good.sum())))


def _clear(pair: ViewPair) -> tuple[Int32s, Int32s, Float64s, Float64s, Float64s, Float64s]:
    """Rows of the `Features`, places, frame affines and ratios of the mutual nearest neighbours that may be first matches."""
    i, j, ratio = mutual_neighbours(pair)
    keep = ratio < MAX_RATIO
    i, j = i[keep], j[keep]
    affine = np.linalg.inv(pair.unframes2[j]) @ inverses(pair.frames1[i])
    return pair.rows1[i], pair.rows2[j], pair.x1[i], pair.x2[j], affine, ratio[keep]


def confirmations(x1: Float64s, x2: Float64s, affine: Float64s) -> Int32s:
    """(n,) how many of a match's nearest matches predict it, place and frame."""
    count = np.zeros(len(x1), np.int32)
    if len(x1) >= 4:
        _, index = nearest_points(x1, x1, min(CONFIRMING_NEIGHBOURS, len(x1) - 1) + 1)
        _count_confirmations(index, x1, x2, affine, count)
    return count


@kernel
def _count_confirmations(index: Int32s, x1: Float64s, x2: Float64s, affine: Float64s, count: Int32s) -> None:
    for n in range(len(x1)):
        a = affine[n]
        det = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
        for k in range(index.shape[1]):
            o = index[n, k]
            du, dv = x1[n, 0] - x1[o, 0], x1[n, 1] - x1[o, 1]
            if abs(du) + abs(dv) <= 1.5:
                continue
            b = affine[o]
            eu = x2[o, 0] + b[0, 0] * du + b[0, 1] * dv - x2[n, 0]
            ev = x2[o, 1] + b[1, 0] * du + b[1, 1] * dv - x2[n, 1]
            reach = np.hypot(x2[n, 0] - x2[o, 0], x2[n, 1] - x2[o, 1])
            if np.hypot(eu, ev) >= CONFIRM_PX + CONFIRM_PER_PX * reach:
                continue
            r00 = (a[1, 1] * b[0, 0] - a[0, 1] * b[1, 0]) / det
            r01 = (a[1, 1] * b[0, 1] - a[0, 1] * b[1, 1]) / det
            r10 = (a[0, 0] * b[1, 0] - a[1, 0] * b[0, 0]) / det
            r11 = (a[0, 0] * b[1, 1] - a[1, 0] * b[0, 1]) / det
            turn = abs(np.arctan2(r10 - r01, r00 + r11))
            zoom = 0.5 * abs(np.log(abs(r00 * r11 - r01 * r10) + 1e-9))
            if turn < CONFIRM_RAD and zoom < CONFIRM_LOG_SCALE:
                count[n] += 1

"""One partner for each keypoint: Sinkhorn balancing on a sparse set of candidates, and removal of repeated matches.

Sinkhorn & Knopp (1967); the dustbin for keypoints without a partner is that of partial assignment (Rangarajan, Chui & Bookstein,
1997).
"""

from __future__ import annotations

import numpy as np

from ..core.jit import helper, kernel
from ..types import Bools, Float64s, Int32s


def assign(i: Int32s, j: Int32s, log_odds: Float64s, n1: int, n2: int, iterations: int = 12) -> Float64s:
    """Probability (c,) of each candidate i[c]--j[c]; those of a row or a column sum to at most 1.

    Parameters
    ----------
    i, j : (c,) int32 row and column of each candidate.
    log_odds : (c,) evidence for the candidate against "no partner", whose mass is 1 in every row and column.
    n1, n2 : numbers of rows and columns.
    iterations : number of times that rows and columns are scaled in turn.
    """
    probability = np.empty(len(i))
    if len(i):
        # beyond 30 nats nothing changes, and sums stay finite
        _sinkhorn(i, j, np.exp(np.clip(log_odds, -30, 30)), n1, n2, iterations, probability)
    return probability


_TOO_NEAR_PX = 1.5
"""Matches nearer to each other than this in either image are repeats of one, pixels; also the cell of the grid they lie in."""


def without_repeats(x1: Float64s, x2: Float64s, probability: Float64s) -> Bools:
    """(n,) True for matches that stay: no more probable match that stays is within `_TOO_NEAR_PX` in image 1 or in image 2.

    x1, x2: (n, 2) pixels of the matches in either image; probability: (n,) of each match.
    """
    keep = np.zeros(len(x1), dtype=bool)
    if len(x1):
        order = np.argsort(-probability, kind="stable").astype(np.int32)
        cells1 = _cells(x1)
        cells2 = _cells(x2)
        _suppress(order, cells1, cells2, x1, x2, _empty_lists(cells1), _empty_lists(cells2), keep)
    return keep


def _cells(x: Float64s) -> Int32s:
    """(n, 2) grid cell of each point, counted from 1, so that each cell has neighbours on all sides."""
    return np.asarray(np.floor((x - x.min(axis=0)) / _TOO_NEAR_PX) + 1, dtype=np.int32)


def _empty_lists(cells: Int32s) -> Int32s:
    """For each grid cell the head of its list of kept matches: -1, as the lists are empty at first."""
    columns, rows = cells.max(axis=0) + 2
    return np.full((rows, columns), -1, np.int32)


@kernel
def _sinkhorn(i: Int32s, j: Int32s, mass: Float64s, rows: int, columns: int, iterations: int, probability: Float64s) -> None:
    """Scale rows and columns of the masses in turn, so that each sums to 1 with its dustbin, and write the scaled masses."""
    u = np.ones(rows)  # factor of each row
    v = np.ones(columns)
    row = np.ones(rows)  # sum of each row
    column = np.ones(columns)
    for _ in range(iterations):
        # a sum begins with the mass of the dustbin, which is not scaled: u = 1 / (1 + sum)
        for c in range(len(row)):
            row[c] = 1.0
        for c in range(len(i)):
            row[i[c]] += mass[c] * v[j[c]]
        for c in range(len(u)):
            u[c] = 1.0 / row[c]
        for c in range(len(column)):
            column[c] = 1.0
        for c in range(len(i)):
            column[j[c]] += mass[c] * u[i[c]]
        for c in range(len(v)):
            v[c] = 1.0 / column[c]
    for c in range(len(i)):
        probability[c] = mass[c] * u[i[c]] * v[j[c]]


@kernel
def _suppress(
    order: Int32s, cells1: Int32s, cells2: Int32s, x1: Float64s, x2: Float64s, head1: Int32s, head2: Int32s, keep: Bools
) -> None:
    """Keep matches in order, unless one already kept is near in either image; each grid cell heads a linked list of these."""
    next1 = np.full(len(x1), -1, np.int32)
    next2 = np.full(len(x1), -1, np.int32)
    for n in order:
        if _has_near(head1, next1, cells1, x1, n) or _has_near(head2, next2, cells2, x2, n):
            continue
        keep[n] = True
        # it becomes the head of its cell's list in both images
        next1[n] = head1[cells1[n, 1], cells1[n, 0]]
        head1[cells1[n, 1], cells1[n, 0]] = n
        next2[n] = head2[cells2[n, 1], cells2[n, 0]]
        head2[cells2[n, 1], cells2[n, 0]] = n


@helper
def _has_near(head: Int32s, next_match: Int32s, cells: Int32s, x: Float64s, n: int) -> bool:
    """Is a kept match of the nine cells around match n too near to it?"""
    for row in range(cells[n, 1] - 1, cells[n, 1] + 2):
        for column in range(cells[n, 0] - 1, cells[n, 0] + 2):
            other = head[row, column]
            while other >= 0:
                if (x[other, 0] - x[n, 0]) ** 2 + (x[other, 1] - x[n, 1]) ** 2 < _TOO_NEAR_PX**2:
                    return True
                other = next_match[other]
    return False

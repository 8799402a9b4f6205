"""Counting sort, sorting networks, and order statistics of a few thousand values: faster than the general routines."""

from __future__ import annotations

import numpy as np

from ..types import Float64s, Int64s
from .jit import kernel


def by_cell(cells: Int64s, count: int) -> tuple[Int64s, Int64s]:
    """Indices (n,) that sort items by their cells (n,), numbers below `count`, and where each cell starts there, (count + 1,).

    The sort is stable.
    """
    starts = np.zeros(count + 1, np.int64)
    np.cumsum(np.bincount(cells, minlength=count), out=starts[1:])
    order = np.empty(len(cells), np.int64)
    _fill_order(cells, starts[:-1].copy(), order)
    return order, starts


@kernel
def _fill_order(cells: Int64s, next_slots: Int64s, order: Int64s) -> None:
    for k in range(len(cells)):
        # items of a cell keep their order: each takes the cell's next slot
        order[next_slots[cells[k]]] = k
        next_slots[cells[k]] += 1


def rank_within(groups: Int64s, worth: Float64s | Int64s) -> Int64s:
    """(n,) rank of each item within its group by ascending worth, counted from 0."""
    order = np.lexsort((worth, groups))  # by group, then by worth; a rank is the distance from the group's first item
    rank = np.empty(len(groups), np.int64)
    rank[order] = np.arange(len(groups)) - np.searchsorted(groups[order], groups[order])
    return rank


def sorting_network(count: int) -> Int64s:
    """(m, 2) pairs of indices to compare, and to swap if the first value is larger, that sort `count` values (Batcher's merge
    exchange, Knuth 5.2.2 M).  The pairs do not depend on the values."""
    pairs = []
    p = 1  # length of the sorted runs that are merged to runs of twice the length
    while p < count:
        k = p  # distance of the two values of a pair
        while k >= 1:
            for j in range(k % p, count - k, 2 * k):
                for i in range(j, min(j + k, count - k)):
                    # both in the same run of twice the length
                    if i // (2 * p) == (i + k) // (2 * p):
                        pairs.append((i, i + k))
            k //= 2
        p *= 2
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def percentiles(values: Float64s, *shares: float) -> list[float]:
    """The percentiles `shares` (0 to 100) of the values (n,), interpolated linearly as by numpy's default."""
    last = len(values) - 1
    places = [share / 100 * last for share in shares]
    # only the values on both sides of each place have to be where sorting would put them
    needed = set()
    for place in places:
        needed |= {int(place), min(int(place) + 1, last)}
    ordered = np.partition(values, sorted(needed))
    result = []
    for place in places:
        before = ordered[int(place)]
        after = ordered[min(int(place) + 1, last)]
        fraction = place % 1
        result.append(float((1 - fraction) * before + fraction * after))
    return result

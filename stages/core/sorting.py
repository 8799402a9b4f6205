"""Sorting without branches, for kernels that sort many short columns at once."""

from __future__ import annotations

import numpy as np

from ..types import Int64s


def sorting_network(count: int) -> Int64s:
    """(m, 2) places to compare, and to exchange where the first is larger, that sort `count` values (Batcher's merge exchange,
    Knuth 5.2.2 M).  What is compared never depends on the values."""
    pairs = []
    for p in (2**i for i in range((count - 1).bit_length())):
        for k in (p >> i for i in range(p.bit_length())):
            for j in range(k % p, count - k, 2 * k):
                pairs += [(i, i + k) for i in range(j, min(j + k, count - k)) if i // (2 * p) == (i + k) // (2 * p)]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)

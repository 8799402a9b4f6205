"""Things in the order of the cells that they lie in, by counting: cells are numbered, so nothing needs to be compared."""

from __future__ import annotations

import numpy as np

from ..types import Int64s
from .jit import kernel


def by_cell(cells: Int64s, count: int) -> tuple[Int64s, Int64s]:
    """Places (n,) of things in the order of their cells (n,), numbers below `count`; where each cell begins in it, (count + 1,).

    What shares a cell keeps its order.
    """
    starts = np.zeros(count + 1, np.int64)
    np.cumsum(np.bincount(cells, minlength=count), out=starts[1:])
    order = np.empty(len(cells), np.int64)
    _place(cells, starts[:-1].copy(), order)
    return order, starts


@kernel
def _place(cells: Int64s, free: Int64s, order: Int64s) -> None:
    for k in range(len(cells)):
        order[free[cells[k]]] = k
        free[cells[k]] += 1

"""How many places of an image hold something: what lies close together tells little more than one point of it."""

from __future__ import annotations

import numpy as np

from ..types import Float64s

GRID_COLUMNS, GRID_ROWS = 12, 8


def places(x: Float64s, size: tuple[int, int], more: float = 1.0) -> int:
    """How many cells of an image of this width and height hold one of the points x (n, 2), pixels.

    more: the grid has so many times the cells of `GRID_COLUMNS` x `GRID_ROWS`.
    """
    finer = np.sqrt(more)
    column = (x[:, 0] * GRID_COLUMNS * finer / size[0]).astype(np.int64)
    row = (x[:, 1] * GRID_ROWS * finer / size[1]).astype(np.int64)
    return len(np.unique(column * 100_000 + row))

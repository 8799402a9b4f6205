"""Coverage of an image: the number of grid cells with points, since points close together add little information to one."""

from __future__ import annotations

import numpy as np

from ..types import Float64s

GRID_COLUMNS = 12
"""Cells of the grid across an image."""
GRID_ROWS = 8
"""Cells of the grid down an image."""


def covered_cells(x: Float64s, size: tuple[int, int], cells_factor: float = 1.0) -> int:
    """Number of grid cells that hold at least one of the points x (n, 2), pixels, in an image of this size (width, height).

    cells_factor: number of cells of the grid, as a multiple of `GRID_COLUMNS` x `GRID_ROWS`.
    """
    scale = np.sqrt(cells_factor)  # of the number of columns, and of rows
    column = (x[:, 0] * GRID_COLUMNS * scale / size[0]).astype(np.int64)
    row = (x[:, 1] * GRID_ROWS * scale / size[1]).astype(np.int64)
    return len(np.unique(column * 100_000 + row))  # one number for each cell: there are far fewer rows than that

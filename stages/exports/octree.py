"""An octree of points for viewers that fetch only what they show: each node keeps some of its points, spread evenly."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..types import Float64s, Int64s

CELLS = 128
"""Cells along each axis of a node, which keeps one point per cell and passes the others to its children."""
MOST_IN_LEAF = 20_000
"""A node with at most this many points keeps them all."""
LEAST_SIDE = 1e-3
"""Shortest edge of the root's cube, for clouds whose points coincide."""

Key = tuple[int, int, int, int]
"""Level of a node, and its index along x, y and z on that level."""


def octree(points: Float64s, low: Float64s, side: float) -> Iterator[tuple[Key, Int64s]]:
    """Yield each node of an octree with the rows (n,) of the points (n, 3) that it keeps.

    low, side: corner (3,) and edge of its cube.  Each point is in exactly one node; those of a node are spread evenly over it.
    """
    pending: list[tuple[Key, Int64s]] = [((0, 0, 0, 0), np.arange(len(points)))]
    while pending:
        (level, *index), rows = pending.pop()
        edge = side / 2**level
        # (n, 3) within the node, 0 to below 1: points on the outer faces of the cube belong to the last cells
        positions = np.clip((points[rows] - low) / edge - index, 0, 1 - 1e-9)

        # 1. The node keeps the first point of each cell; a small node keeps all.
        if len(rows) > MOST_IN_LEAF:
            i, j, k = (positions * CELLS).astype(np.int64).T
            kept_indices = np.sort(np.unique((i * CELLS + j) * CELLS + k, return_index=True)[1])
        else:
            kept_indices = np.arange(len(rows))
        yield (level, *index), rows[kept_indices]  # type: ignore[misc]

        # 2. The others go to its children, one for each octant that holds any.
        remaining = np.setdiff1d(np.arange(len(rows)), kept_indices, assume_unique=True)
        octant = (positions[remaining] * 2).astype(np.int64)
        for child in np.unique(octant, axis=0):
            inside = rows[remaining[(octant == child).all(axis=1)]]
            x, y, z = (2 * np.array(index) + child).tolist()
            pending.append(((level + 1, x, y, z), inside))

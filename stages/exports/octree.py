"""An octree of points: each node keeps some of its own, spread evenly; viewers fetch only the nodes that they show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..types import Float64s, Int64s

CELLS = 128
"""A node keeps one point for each of so many cells along an axis, and hands the others down."""
MOST_IN_LEAF = 20_000
"""A node with fewer points keeps them all."""

Key = tuple[int, int, int, int]
"""Level, and the node's place along x, y and z on it."""


def octree(points: Float64s, low: Float64s, side: float) -> Iterator[tuple[Key, Int64s]]:
    """Yield each node of an octree with the rows (n,) of the points (n, 3) that it keeps.

    low, side: corner (3,) and edge of its cube.  Each point is in one node; those of a node are spread evenly over it.
    """
    pending: list[tuple[Key, Int64s]] = [((0, 0, 0, 0), np.arange(len(points)))]
    while pending:
        (level, *place), rows = pending.pop()
        edge = side / 2**level
        at = np.clip((points[rows] - low) / edge - place, 0, 1 - 1e-9)
        if len(rows) > MOST_IN_LEAF:
            i, j, k = (at * CELLS).astype(np.int64).T
            kept = np.sort(np.unique((i * CELLS + j) * CELLS + k, return_index=True)[1])
        else:
            kept = np.arange(len(rows))
        yield (level, *place), rows[kept]  # type: ignore[misc]
        left = np.setdiff1d(np.arange(len(rows)), kept, assume_unique=True)
        half = (at[left] * 2).astype(np.int64)
        for child in np.unique(half, axis=0):
            inside = rows[left[(half == child).all(axis=1)]]
            x, y, z = (2 * np.array(place) + child).tolist()
            pending.append(((level + 1, x, y, z), inside))

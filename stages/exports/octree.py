"""An octree of points for viewers that fetch only what they show: each node keeps some of its points, spread evenly."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..types import Float64s, Int64s

CELLS = 128
"""Cells along each axis of a node, which keeps one point per cell and passes the others to its children."""
MOST_IN_LEAF = 20_000
"""A node with at most this many points keeps them all."""

Key = tuple[int, int, int, int]
"""Level of a node, and its index along x, y and z on that level."""


def octree(points: Float64s, low: Float64s, side: float) -> Iterator[tuple[Key, Int64s]]:
    """Yield each node of an octree with the rows (n,) of the points (n, 3) that it keeps.

    low, side: corner (3,) and edge of its cube.  Each point is in exactly one node; those of a node are spread evenly over it.
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

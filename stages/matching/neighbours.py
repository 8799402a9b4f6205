"""Exact nearest neighbours of two descriptor sets, both ways, from one matrix product."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..kernels import kernel
from ..types import Float32s, Float64s, Int32s

_BLOCK = 512


@dataclass(frozen=True)
class Neighbours:
    """The k nearest of the other set, nearest first: rows: (n1, k) of set 2 for set 1, columns: (n2, k) of set 1 for set 2;
    `*_distance`: their Euclidean distances, float32."""

    rows: Int32s
    row_distance: Float32s
    columns: Int32s
    column_distance: Float32s


def nearest_neighbours(descriptors1: Float32s, descriptors2: Float32s, k: int) -> Neighbours:
    """The k nearest neighbours both ways of unit-length descriptors (n1, d), (n2, d); k is cut to the smaller set."""
    n1, n2 = len(descriptors1), len(descriptors2)
    k = max(min(k, n1, n2), 0)
    rows, row_best = np.full((n1, k), -1, np.int32), np.full((n1, k), -2, np.float32)
    columns, column_best = np.full((n2, k), -1, np.int32), np.full((n2, k), -2, np.float32)
    other = np.ascontiguousarray(descriptors2.T)
    for start in range(0, n1 if k else 0, _BLOCK):
        _keep_best(descriptors1[start : start + _BLOCK] @ other, start, rows, row_best, columns, column_best)
    return Neighbours(rows, _distance(row_best), columns, _distance(column_best))


def nearest_elsewhere(
    descriptors: Float32s, xy: Float64s, others: Float32s, others_xy: Float64s, apart_px: float = 6.0
) -> Float32s:
    """(n,) distance of each descriptor to the most similar of `others` that lies at least `apart_px` from it in the image."""
    best = np.full(len(descriptors), -2, np.float32)
    transposed = np.ascontiguousarray(others.T)
    for start in range(0, len(descriptors), _BLOCK):
        _best_elsewhere(descriptors[start : start + _BLOCK] @ transposed, start, xy, others_xy, apart_px**2, best)
    return _distance(np.maximum(best, -1))


def _distance(similarity: Float32s) -> Float32s:
    """Euclidean distance of unit vectors from their dot product."""
    return np.sqrt(np.maximum(2 - 2 * similarity, 0), dtype=np.float32)


@kernel
def _keep_best(
    similarity: Float32s, start: int, rows: Int32s, row_best: Float32s, columns: Int32s, column_best: Float32s
) -> None:
    """Merge a block of similarities into the best k of its rows and of all columns; of equals, the first index stays."""
    k = rows.shape[1]
    for i in range(similarity.shape[0]):
        row = start + i
        for j in range(similarity.shape[1]):
            s = similarity[i, j]
            if s > row_best[row, k - 1]:
                at = k - 1
                while at > 0 and s > row_best[row, at - 1]:
                    row_best[row, at] = row_best[row, at - 1]
                    rows[row, at] = rows[row, at - 1]
                    at -= 1
                row_best[row, at] = s
                rows[row, at] = j
            if s > column_best[j, k - 1]:
                at = k - 1
                while at > 0 and s > column_best[j, at - 1]:
                    column_best[j, at] = column_best[j, at - 1]
                    columns[j, at] = columns[j, at - 1]
                    at -= 1
                column_best[j, at] = s
                columns[j, at] = row


@kernel
def _best_elsewhere(similarity: Float32s, start: int, xy: Float64s, others_xy: Float64s, limit: float, best: Float32s) -> None:
    for i in range(similarity.shape[0]):
        row = start + i
        for j in range(similarity.shape[1]):
            s = similarity[i, j]
            if s > best[row] and (xy[row, 0] - others_xy[j, 0]) ** 2 + (xy[row, 1] - others_xy[j, 1]) ** 2 >= limit:
                best[row] = s

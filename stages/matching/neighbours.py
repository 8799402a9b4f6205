"""Exact nearest neighbours of two descriptor sets, both ways, from one matrix product."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.jit import helper, kernel
from ..types import Float32s, Float64s, Int32s, Int64s, Uint8s, Uint64s

_BLOCK = 512
"""Rows of similarities that are computed at a time: 512 rows of 6,000 take 12 MB."""
_SPAN = 32
"""Similarities of a row that are compared first with the same limits; each further span is twice as long."""
LEAST_DISTANCE_PX = 6.0
"""Keypoints nearer to each other than this in an image count as the same thing."""


@dataclass(frozen=True)
class Neighbours:
    """The k nearest neighbours in the other set, nearest first."""

    rows: Int32s
    """(n1, k) rows of set 2, for each of set 1."""
    row_distance: Float32s
    """(n1, k) their Euclidean distances."""
    columns: Int32s
    """(n2, k) rows of set 1, for each of set 2."""
    column_distance: Float32s
    """(n2, k) their Euclidean distances."""

    def mutual(self) -> tuple[Int64s, Int32s, Float64s]:
        """i, j of mutual nearest neighbours, and their ratio of first to second distance, the larger one of both directions."""
        i = np.flatnonzero(self.columns[self.rows[:, 0], 0] == np.arange(len(self.rows)))
        j = self.rows[i, 0]
        # identical descriptors have a second distance of 0, too
        forward = self.row_distance[i, 0] / np.maximum(self.row_distance[i, 1], 1e-9)
        backward = self.column_distance[j, 0] / np.maximum(self.column_distance[j, 1], 1e-9)
        return i, j, np.maximum(forward, backward).astype(np.float64)


def nearest_neighbours(descriptors1: Float32s, descriptors2: Float32s, k: int) -> Neighbours:
    """The k nearest neighbours both ways of unit-length descriptors (n1, d), (n2, d); k is limited to the smaller set's size."""
    n1 = len(descriptors1)
    n2 = len(descriptors2)
    k = max(min(k, n1, n2), 0)
    # similarity: the dot product, at least -1 for unit vectors, so that -2 is below all of them
    rows = np.full((n1, k), -1, np.int32)
    row_best = np.full((n1, k), -2, np.float32)
    columns = np.full((n2, k), -1, np.int32)
    column_best = np.full((n2, k), -2, np.float32)
    column_limit = np.full(n2, -2, np.float32)
    if k > 0:
        transposed = np.ascontiguousarray(descriptors2.T)
        buffer = np.empty(_BLOCK * n2, np.float32)
        marks = np.zeros((n2 + 7) // 8, np.uint64)
        for start in range(0, n1, _BLOCK):
            similarity = _products(descriptors1[start : start + _BLOCK], transposed, buffer)
            _keep_best(similarity, start, rows, row_best, columns, column_best, column_limit, marks, marks.view(np.uint8))
    return Neighbours(rows, _distance(row_best), columns, _distance(column_best))


def nearest_lookalike(descriptors: Float32s, xy: Float64s, others: int, begin: int = 0) -> Float32s:
    """(n - begin,) distance of each descriptor to the most similar one, among the first `others`, at least `LEAST_DISTANCE_PX`
    away in the image.

    Parameters
    ----------
    descriptors : (n, d) float32.
    xy : (n, 2) pixels.
    others : number of descriptors, from the first, that are compared with.
    begin : first descriptor whose distance is returned: 0, or `others`.
    """
    best = np.full(len(descriptors), -2, np.float32)
    transposed = np.ascontiguousarray(descriptors[:others].T)
    buffer = np.empty(_BLOCK * others, np.float32)
    limit = LEAST_DISTANCE_PX**2
    # among themselves: similarity is symmetric, so that each two of the first `others` are compared once
    for start in range(begin, others, _BLOCK):
        rows = descriptors[start : min(start + _BLOCK, others)]
        _raise_best(_products(rows, transposed[:, start:], buffer), start, start, xy, limit, True, best)
    # the remaining ones with the first `others`
    for start in range(others, len(descriptors), _BLOCK):
        rows = descriptors[start : start + _BLOCK]
        _raise_best(_products(rows, transposed, buffer), start, 0, xy, limit, False, best)
    # -1: nothing is far enough away; the distance is then the largest of unit vectors
    return _distance(np.maximum(best[begin:], -1))


def _products(rows: Float32s, columns: Float32s, buffer: Float32s) -> Float32s:
    """(n, m) products of (n, d) and (d, m), written to `buffer`: allocating memory for each block costs a tenth of the time."""
    out = buffer[: len(rows) * columns.shape[1]].reshape(len(rows), columns.shape[1])
    return np.asarray(np.matmul(rows, columns, out=out))


def _distance(similarity: Float32s) -> Float32s:
    """Euclidean distance of unit vectors from their dot product."""
    return np.sqrt(np.maximum(2 - 2 * similarity, 0), dtype=np.float32)


@kernel
def _keep_best(
    similarity: Float32s, start: int, rows: Int32s, row_best: Float32s, columns: Int32s, column_best: Float32s,
    column_limit: Float32s, marks: Uint64s, mark_bytes: Uint8s,
) -> None:  # fmt: skip
    """Merge a block of similarities into the best k of its rows and of all columns; of equal ones, the first index stays.

    column_limit: (n2,) the last of each column's best k.  Few similarities enter a list: a row is scanned in spans of doubling
    length, and in each only values above the limits at its start are inspected.  marks, mark_bytes: the same memory, zeros first.
    """
    k = rows.shape[1]
    n = similarity.shape[1]
    for i in range(similarity.shape[0]):
        row = start + i
        first = 0
        last = min(_SPAN, n)
        while first < n:
            _mark(similarity[i, first:last], row_best[row, k - 1], column_limit[first:last], mark_bytes)
            for group in range((last - first + 7) // 8):
                if marks[group] == 0:
                    continue
                for j in range(first + 8 * group, min(first + 8 * group + 8, last)):
                    # again with the present limits, which may have risen since the marks were set
                    value = similarity[i, j]
                    if value > row_best[row, k - 1]:
                        _insert(row_best[row], rows[row], value, j)
                    if value > column_limit[j]:
                        _insert(column_best[j], columns[j], value, row)
                        column_limit[j] = column_best[j, k - 1]
            first = last
            last = min(2 * last, n)


@helper
def _mark(values: Float32s, row_limit: float, column_limit: Float32s, marks: Uint8s) -> None:
    """Mark the values that exceed `row_limit`, or their own entry of `column_limit`."""
    for n in range(len(values)):
        marks[n] = np.uint8(values[n] > row_limit) | np.uint8(values[n] > column_limit[n])


@helper
def _insert(best: Float32s, index: Int32s, value: float, entry: int) -> None:
    """Insert a value into a list in descending order; the last value drops out."""
    rank = len(best) - 1
    while rank > 0 and value > best[rank - 1]:
        best[rank] = best[rank - 1]
        index[rank] = index[rank - 1]
        rank -= 1
    best[rank] = value
    index[rank] = entry


@kernel
def _raise_best(similarity: Float32s, top: int, left: int, xy: Float64s, limit: float, symmetric: bool, best: Float32s) -> None:
    """Raise the best similarity of the rows, which begin at `top`, and if `symmetric`, of the columns, which begin at `left`."""
    for i in range(similarity.shape[0]):
        row = top + i
        for j in range(similarity.shape[1]):
            value = similarity[i, j]
            column = left + j
            # first by similarity, which rarely passes, then by distance in the image
            if value <= best[row] and not (symmetric and value > best[column]):
                continue
            if (xy[row, 0] - xy[column, 0]) ** 2 + (xy[row, 1] - xy[column, 1]) ** 2 >= limit:
                best[row] = max(best[row], value)
                if symmetric:
                    best[column] = max(best[column], value)

"""Points of many views merged on a grid that is coarser where the cameras resolve less.

Each level doubles the voxels' edge: level 0 has the basic edge, and a point whose pixel covers more than two, four, ... edges
goes to level 1, 2, ...  Sites with both near and far things thus keep the detail of both.  A depth with a large sigma gets a
smaller weight, not a coarser voxel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..core.jit import kernel
from ..core.parallel import parallel_map
from ..types import Float32s, Float64s, Int64s

_HALF_CELLS = 1 << 19
"""Cells to either side of the origin, per axis: 20 bits of a key for each axis."""

_LEVELS = 8
"""Number of levels; a key's level takes the bits above the three axes."""

_BLOCK = 1 << 18
"""Voxels that are merged at a time: bounds the memory beyond the sums themselves."""

# Columns of a voxel's sums; positions are relative to the voxel's centre, which keeps single precision exact enough.
_POSITION = 0
"""Three columns: position times weight."""
_NORMAL = 3
"""Three columns: normal times weight."""
_COLOUR = 6
"""Three columns: colour times confidence."""
_WEIGHT = 9
_CONFIDENCE = 10
_COUNT = 11
_WEIGHTED_SIGMA = 12
"""Standard deviation times weight."""
_WEIGHTED_VARIANCE = 13
"""Variance times squared weight."""
_LARGEST_CONFIDENCE = 14
"""This column and the next are maxima, not sums."""
_MOST_CAMERAS = 15
_COLUMNS = 16

_CORRELATION = 0.25
"""Error correlation of a voxel's samples: views share pairs, and pixels share patches (fitted as in `fusion.uncertainty`)."""


class Samples(NamedTuple):
    """Points before or after merging, (n, ...): position, unit normal, colour 0 to 255, weight 1 / sigma^2 (sigma of the noise
    model), confidence 0 to 1, number of cameras, edge of the pixel's footprint in world lengths, and squared standard deviation
    along the nearest camera's ray, as observed in the images (`fusion.uncertainty`)."""

    points: Float64s
    normals: Float32s
    colors: Float32s
    weight: Float32s
    confidence: Float32s
    cameras: Float32s
    footprint: Float32s
    variance: Float32s


@dataclass(frozen=True)
class VoxelSums:
    """Samples of one view, summed by occupied voxel: sorted keys (n,), and columns (n, 16) as above."""

    keys: Int64s
    columns: Float32s


class VoxelGrid:
    """Collects samples view by view.  Memory is 72 bytes for each occupied voxel, however many samples it has."""

    def __init__(self, edge: float, origin: Float64s) -> None:
        self.edge = edge
        self.origin = origin
        self._keys = np.zeros(0, np.int64)
        self._sums = np.zeros((0, _COLUMNS), np.float32)

    def sums_of(self, samples: Samples) -> VoxelSums:
        """The samples of one view, summed by voxel; those beyond half a million edges from the origin are left out."""
        doublings = np.floor(np.log2(np.maximum(samples.footprint / self.edge, 1.0)))
        level = np.clip(doublings, 0, _LEVELS - 1).astype(np.int64)
        keys = np.empty(len(level), np.int64)
        offsets = np.empty((len(level), 3), np.float32)
        _locate(samples.points, level, self.origin, self.edge, keys, offsets)
        # bring samples of one voxel together; a stable sort keeps the order of summation, and so the last bits
        order = np.flatnonzero(keys >= 0)
        order = order[np.argsort(keys[order], kind="stable")]
        keys = keys[order]
        starts = np.flatnonzero(np.diff(keys, prepend=-1))
        columns = np.empty((len(starts), _COLUMNS), np.float32)
        _sum_by_voxel(order, np.append(starts, len(order)), offsets, samples, columns)
        return VoxelSums(keys[starts], columns)

    def add(self, sums: VoxelSums) -> None:
        """Merge in the sums of one view, in place, so that memory never holds the known voxels twice."""
        old_count = len(self._keys)
        new_count = old_count + _count_new(self._keys, sums.keys)
        self._keys.resize(new_count, refcheck=False)
        self._sums.resize((new_count, _COLUMNS), refcheck=False)
        _merge_from_the_end(self._keys, self._sums, old_count, sums.keys, sums.columns)

    def merged(self) -> Iterator[Samples]:
        """One sample for each voxel, in blocks of voxels.

        Position and normal are means weighted by weight, the colour by confidence; `weight` is the samples' mean; `variance` is
        that of the position for error correlation `_CORRELATION`; confidence and cameras are the largest of the samples.
        """
        count = len(self._keys)
        pieces = [slice(first, min(first + _BLOCK, count)) for first in range(0, count, _BLOCK)]
        yield from parallel_map(self._means, pieces)

    def _means(self, rows: slice) -> Samples:
        """Merged samples of some of the voxels."""
        keys = self._keys[rows]
        sums = self._sums[rows]
        weight = sums[:, _WEIGHT, None]
        confidence = sums[:, _CONFIDENCE, None]
        count = sums[:, _COUNT, None]
        # variance of a weighted mean if all errors were the same, and if they were independent
        correlated = (sums[:, _WEIGHTED_SIGMA] / weight[:, 0]) ** 2
        independent = sums[:, _WEIGHTED_VARIANCE] / weight[:, 0] ** 2
        normals = sums[:, _NORMAL : _NORMAL + 3]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        # take the keys apart again: 20 bits for each axis, and the level above them
        cells = np.column_stack([keys >> shift & (2 * _HALF_CELLS - 1) for shift in (40, 20, 0)]) - _HALF_CELLS
        edges = self.edge * 2.0 ** (keys >> 60)
        centres = self.origin + (cells + 0.5) * edges[:, None]
        return Samples(
            points=centres + sums[:, _POSITION : _POSITION + 3] / weight,
            normals=np.asarray(normals / np.maximum(length, 1e-30), dtype=np.float32),
            colors=sums[:, _COLOUR : _COLOUR + 3] / confidence,
            weight=(weight / count)[:, 0],
            confidence=sums[:, _LARGEST_CONFIDENCE].copy(),  # an array view would keep all the block's sums in memory
            cameras=sums[:, _MOST_CAMERAS].copy(),
            footprint=edges.astype(np.float32),
            variance=_CORRELATION * correlated + (1.0 - _CORRELATION) * independent,
        )


@kernel
def _locate(points: Float64s, level: Int64s, origin: Float64s, edge: float, keys: Int64s, offsets: Float32s) -> None:
    """Write the key of each point's voxel, -1 if it is too far out, and the point's offset from the voxel's centre."""
    for n in range(len(points)):
        edge_length = edge * 2.0 ** level[n]
        key = level[n]
        is_inside = True
        for axis in range(3):
            position = (points[n, axis] - origin[axis]) / edge_length
            cell = np.floor(position)
            offsets[n, axis] = (position - cell - 0.5) * edge_length
            is_inside &= -_HALF_CELLS <= cell < _HALF_CELLS
            key = key << 20 | (int(cell) + _HALF_CELLS)
        keys[n] = key if is_inside else -1


@kernel
def _sum_by_voxel(order: Int64s, starts: Int64s, offsets: Float32s, samples: Samples, sums: Float32s) -> None:
    """Sum each voxel's samples, which are contiguous in `order`, from one of `starts` to the next."""
    _, normals, colors, weight, confidence, cameras, _, variance = samples
    for voxel in range(len(sums)):
        row = sums[voxel]
        row[:] = 0
        for n in range(starts[voxel], starts[voxel + 1]):
            sample = order[n]
            w = weight[sample]
            c = confidence[sample]
            v = variance[sample]
            for axis in range(3):
                row[_POSITION + axis] += offsets[sample, axis] * w
                row[_NORMAL + axis] += normals[sample, axis] * w
                row[_COLOUR + axis] += colors[sample, axis] * c
            row[_WEIGHT] += w
            row[_CONFIDENCE] += c
            row[_COUNT] += 1
            row[_WEIGHTED_SIGMA] += w * np.sqrt(v)
            row[_WEIGHTED_VARIANCE] += w * w * v
            row[_LARGEST_CONFIDENCE] = max(row[_LARGEST_CONFIDENCE], c)
            row[_MOST_CAMERAS] = max(row[_MOST_CAMERAS], cameras[sample])


@kernel
def _count_new(known: Int64s, keys: Int64s) -> int:
    """Number of `keys` that are not in `known`; both are sorted."""
    count = 0
    row = 0
    for k in range(len(keys)):
        while row < len(known) and known[row] < keys[k]:
            row += 1
        if row == len(known) or known[row] != keys[k]:
            count += 1
    return count


@kernel
def _merge_from_the_end(keys: Int64s, sums: Float32s, old_count: int, new_keys: Int64s, new_sums: Float32s) -> None:
    """Merge new sorted rows into an array whose first `old_count` rows are sorted and whose length is that of the result.

    From the end, a row is never written before it has been read.
    """
    old = old_count - 1
    new = len(new_keys) - 1
    for row in range(len(keys) - 1, -1, -1):
        if new < 0:
            return  # the remaining rows are in place already
        if old >= 0 and keys[old] > new_keys[new]:
            keys[row] = keys[old]
            for column in range(_COLUMNS):
                sums[row, column] = sums[old, column]
            old -= 1
        elif old >= 0 and keys[old] == new_keys[new]:
            keys[row] = keys[old]
            for column in range(_LARGEST_CONFIDENCE):
                sums[row, column] = sums[old, column] + new_sums[new, column]
            for column in range(_LARGEST_CONFIDENCE, _COLUMNS):
                sums[row, column] = max(sums[old, column], new_sums[new, column])
            old -= 1
            new -= 1
        else:
            keys[row] = new_keys[new]
            for column in range(_COLUMNS):
                sums[row, column] = new_sums[new, column]
            new -= 1

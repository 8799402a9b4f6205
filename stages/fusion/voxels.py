"""Points of many views merged on a grid that grows coarser where the cameras see coarser, and lonely ones dropped.

A voxel's level doubles its edge: level 0 has the basic edge, and a point whose pixel covers more than two, four, ... edges goes
to level 1, 2, ...  Sites in which near and far things are seen at once keep both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..kernels import kernel
from ..types import Bools, Float32s, Float64s, Int32s

Int64s = npt.NDArray[np.int64]

_HALF = 1 << 19  # cells to either side of the origin, per axis
_LEVELS = 8


@dataclass(frozen=True)
class Samples:
    """Points before or after merging, (n, ...): position, unit normal, colour 0 to 255, weight 1 / sigma^2, confidence 0 to 1,
    number of cameras, and edge of the pixel's footprint in world lengths."""

    points: Float64s
    normals: Float32s
    colors: Float32s
    weight: Float64s
    confidence: Float32s
    cameras: Int32s
    footprint: Float32s


class VoxelGrid:
    """Collects samples view by view.  Memory follows the number of occupied voxels, not of samples."""

    def __init__(self, edge: float, origin: Float64s) -> None:
        self.edge = edge
        self.origin = origin
        self._cells = _Cells(np.zeros(0, np.int64), np.zeros((0, 13)), np.zeros((0, 2)))
        self._waiting: list[_Cells] = []

    def add(self, samples: Samples) -> None:
        """Merge in the samples of one view; what lies beyond half a million edges from the origin is left out."""
        level = np.clip(np.floor(np.log2(np.maximum(samples.footprint / self.edge, 1.0))), 0, _LEVELS - 1).astype(np.int64)
        away = samples.points - self.origin
        cells = np.floor(away / (self.edge * 2.0**level)[:, None]).astype(np.int64) + _HALF
        inside = ((cells >= 0) & (cells < 2 * _HALF)).all(axis=1)
        keys = level << 60 | cells[:, 0] << 40 | cells[:, 1] << 20 | cells[:, 2]
        w, c = samples.weight, samples.confidence.astype(np.float64)
        weighted = [away * w[:, None], samples.normals * w[:, None], samples.colors * c[:, None]]
        sums = np.column_stack([*weighted, w, c, np.ones(len(w)), samples.footprint])
        best = np.column_stack([c, samples.cameras])
        self._waiting.append(_merged([_Cells(keys[inside], sums[inside], best[inside])]))
        if sum(len(cells.keys) for cells in self._waiting) > len(self._cells.keys):
            self._settle()

    def merged(self, neighbours: int) -> Samples:
        """One sample for each voxel that has at least so many occupied ones within three edges of it.

        Position and normal are means by weight, the colour by confidence; `weight` is the samples' mean, not their sum: views
        share pairs, so their errors are not independent; confidence and cameras are the best sample's.
        """
        self._settle()
        cells = self._cells
        kept = sociable(cells.keys, neighbours)
        sums, best = cells.sums[kept], cells.best[kept]
        w, c, n = sums[:, 9:10], sums[:, 10:11], sums[:, 11]
        normals = sums[:, 3:6] / np.maximum(np.linalg.norm(sums[:, 3:6], axis=1, keepdims=True), 1e-12)
        return Samples(
            sums[:, 0:3] / w + self.origin,
            normals.astype(np.float32),
            (sums[:, 6:9] / c).astype(np.float32),
            w[:, 0] / n,
            best[:, 0].astype(np.float32),
            best[:, 1].astype(np.int32),
            (sums[:, 12] / n).astype(np.float32),
        )

    def _settle(self) -> None:
        self._cells = _merged([self._cells, *self._waiting])
        self._waiting = []


@dataclass(frozen=True)
class _Cells:
    """Occupied voxels in the order of their keys: sums of what is averaged, and of what the best sample decides."""

    keys: Int64s
    sums: Float64s
    best: Float64s


def _merged(parts: list[_Cells]) -> _Cells:
    keys = np.concatenate([part.keys for part in parts])
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    if not len(keys):
        return parts[0]
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    sums = np.concatenate([part.sums for part in parts])[order]
    best = np.concatenate([part.best for part in parts])[order]
    return _Cells(keys[starts], np.add.reduceat(sums, starts, axis=0), np.maximum.reduceat(best, starts, axis=0))


def sociable(keys: Int64s, neighbours: int) -> Bools:
    """Which voxels (sorted keys) have at least `neighbours` others of their own or a finer level within three edges."""
    kept = np.zeros(len(keys), np.bool_)
    levels = keys >> 60
    for level in np.unique(levels):
        members = np.flatnonzero(levels == level)
        present = np.unique(np.concatenate([_coarser(keys[levels == fine], int(level - fine)) for fine in range(level + 1)]))
        kept[members] = _count_near(keys[members] & ((1 << 60) - 1), present, neighbours + 1) > neighbours
    return kept


def _coarser(keys: Int64s, steps: int) -> Int64s:
    """Keys without their level, as cells `steps` levels coarser."""
    axes = [((keys >> shift & (2 * _HALF - 1)) - _HALF >> steps) + _HALF for shift in (40, 20, 0)]
    return axes[0] << 40 | axes[1] << 20 | axes[2]


@kernel
def _count_near(keys: Int64s, present: Int64s, enough: int) -> Int32s:
    """How many of `present` lie within three cells of each of `keys`, itself included; counting stops at `enough`.

    Both are sorted, and cells along z have consecutive keys: the neighbours in one column of cells are a run of `present`, and
    for each of the 29 columns the start of that run only ever moves forward.
    """
    column, reach, n = np.empty(49, np.int64), np.empty(49, np.int64), 0
    for dx in range(-3, 4):
        for dy in range(-3, 4):
            if dx * dx + dy * dy <= 9:
                column[n] = dx * (1 << 40) + dy * (1 << 20)
                reach[n] = int(np.sqrt(9.0 - dx * dx - dy * dy))
                n += 1
    start = np.zeros(n, np.int64)
    found = np.zeros(len(keys), np.int32)
    for k in range(len(keys)):
        for c in range(n):
            first = keys[k] + column[c] - reach[c]
            at = start[c]
            while at < len(present) and present[at] < first:
                at += 1
            start[c] = at
            while at < len(present) and present[at] <= first + 2 * reach[c] and found[k] < enough:
                found[k] += 1
                at += 1
    return found

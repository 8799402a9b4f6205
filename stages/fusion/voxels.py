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
    weight: Float32s
    confidence: Float32s
    cameras: Float32s
    footprint: Float32s


class VoxelGrid:
    """Collects samples view by view.  Memory follows the number of occupied voxels, not of samples: 64 bytes for each."""

    def __init__(self, edge: float, origin: Float64s) -> None:
        self.edge = edge
        self.origin = origin
        self._cells = _Cells(np.zeros(0, np.int64), [np.zeros(0, np.float32)] * 12, [np.zeros(0, np.float32)] * 2)
        self._waiting: list[_Cells] = []

    def add(self, samples: Samples) -> None:
        """Merge in the samples of one view; what lies beyond half a million edges from the origin is left out."""
        level = np.clip(np.floor(np.log2(np.maximum(samples.footprint / self.edge, 1.0))), 0, _LEVELS - 1).astype(np.int64)
        cells = np.floor((samples.points - self.origin) / (self.edge * 2.0**level)[:, None]).astype(np.int64) + _HALF
        inside = ((cells >= 0) & (cells < 2 * _HALF)).all(axis=1)
        keys = level << 60 | cells[:, 0] << 40 | cells[:, 1] << 20 | cells[:, 2]
        del cells
        away = (samples.points - self._centres(keys)).astype(np.float32)
        w, c = samples.weight, samples.confidence
        sums = [away[:, k] * w for k in range(3)] + [samples.normals[:, k] * w for k in range(3)]
        sums += [samples.colors[:, k] * c for k in range(3)] + [w, c, np.ones_like(w)]
        kept = [column[inside] for column in (*sums, c, samples.cameras)]
        self._waiting.append(_merged([_Cells(keys[inside], kept[:12], kept[12:])]))
        if sum(len(cells.keys) for cells in self._waiting) > len(self._cells.keys) // 2:
            self._settle()

    def merged(self, neighbours: int) -> Samples:
        """One sample for each voxel that has at least so many occupied ones within three edges of it.

        Position and normal are means by weight, the colour by confidence; `weight` is the samples' mean, not their sum: views
        share pairs, so their errors are not independent; confidence and cameras are the best sample's.
        """
        self._settle()
        kept = sociable(self._cells.keys, neighbours)
        keys = self._cells.keys[kept]
        sums, best = ([column[kept] for column in columns] for columns in (self._cells.sums, self._cells.best))
        w, c, n = sums[9:12]
        normals = np.column_stack(sums[3:6])
        return Samples(
            self._centres(keys) + np.column_stack([column / w for column in sums[0:3]]),
            normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30),
            np.column_stack([column / c for column in sums[6:9]]),
            w / n,
            best[0],
            best[1],
            (self.edge * 2.0 ** (keys >> 60)).astype(np.float32),
        )

    def _settle(self) -> None:
        self._cells = _merged([self._cells, *self._waiting])
        self._waiting = []

    def _centres(self, keys: Int64s) -> Float64s:
        """(n, 3) middles of voxels; positions are summed relative to them, in single precision."""
        cells = np.column_stack([keys >> shift & (2 * _HALF - 1) for shift in (40, 20, 0)]) - _HALF
        return np.asarray(self.origin + (cells + 0.5) * (self.edge * 2.0 ** (keys >> 60))[:, None], dtype=np.float64)


@dataclass(frozen=True)
class _Cells:
    """Occupied voxels in the order of their keys: sums of what is averaged (position, normal, colour, weight, confidence, count),
    and what the best sample decides (confidence, cameras); each column (n,) float32."""

    keys: Int64s
    sums: list[Float32s]
    best: list[Float32s]


def _merged(parts: list[_Cells]) -> _Cells:
    """Uses its parts up, one column at a time, so that no second copy of all of them is ever held."""
    keys = np.concatenate([part.keys for part in parts])
    if not len(keys):
        return parts[0]
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))

    def gather(columns: list[Float32s]) -> Float32s:
        return np.asarray(np.concatenate(columns)[order])

    sums = [np.add.reduceat(gather([part.sums.pop(0) for part in parts]), starts) for _ in range(12)]
    best = [np.maximum.reduceat(gather([part.best.pop(0) for part in parts]), starts) for _ in range(2)]
    return _Cells(keys[starts], sums, best)


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

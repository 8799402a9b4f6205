"""The reference cloud: what at least two cameras truly see, from the exact depth of the empty yard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wbflow_stages.core.cameras import backproject, same_camera
from wbflow_stages.evaluate import count_views
from wbflow_stages.types import Camera, Cloud, Float32s, Float64s, Uint8s, Uint16s


def reference_cloud(
    cameras: Sequence[Camera], depths: Sequence[Float32s], normals: Sequence[Float32s], colors: Sequence[Uint8s], voxel_m: float
) -> Cloud:
    """Return one point, the mean, for each cell of `voxel_m` metres of all that two cameras or more see.

    `views` of the cloud: the most cameras that see a point of the cell (its own among them)."""
    cells: _Cells | None = None
    for k, (camera, depth, normal, color) in enumerate(zip(cameras, depths, normals, colors, strict=True)):
        v, u = np.nonzero(depth > 0)
        points = backproject(camera, np.column_stack([u, v]).astype(np.float64), depth[v, u].astype(np.float64))
        others = [i for i in range(len(cameras)) if i != k and not same_camera(cameras[i], camera)]
        views = 1 + count_views(points, [cameras[i] for i in others], [depths[i] for i in others])
        shared = views >= 2
        seen = _Cells(
            key=_cell_keys(points[shared], voxel_m),
            count=np.ones(int(shared.sum())),
            total=np.column_stack([points[shared], normal[v[shared], u[shared]], color[v[shared], u[shared]]]),
            views=views[shared].astype(np.uint16),
        )
        cells = _gathered([seen] if cells is None else [cells, seen])
    if cells is None:
        raise ValueError("a reference cloud needs cameras")
    mean = cells.total / np.maximum(cells.count, 1)[:, None]
    direction = mean[:, 3:6] / np.maximum(np.linalg.norm(mean[:, 3:6], axis=1, keepdims=True), 1e-9)
    return Cloud(
        points=mean[:, :3].astype(np.float32),
        normals=direction.astype(np.float32),
        colors=(mean[:, 6:] + 0.5).astype(np.uint8),
        confidence=np.ones(len(mean), np.float32),
        views=cells.views,
        sigma_mm=np.zeros(len(mean), np.float32),
    )


@dataclass(frozen=True)
class _Cells:
    """Sums over cells of a grid."""

    key: npt.NDArray[np.int64]
    """(n,) int64, one number for each cell."""
    count: Float64s
    """(n,) float64, points in it."""
    total: Float64s
    """(n, 9) float64, position, normal and colour."""
    views: Uint16s
    """(n,) uint16, the most of any point."""


def _cell_keys(points: Float64s, voxel_m: float) -> npt.NDArray[np.int64]:
    """Return one number for each cell of a grid anchored at 0, up to a million cells away from it."""
    cell = np.floor(points / voxel_m).astype(np.int64) + (1 << 20)
    return np.asarray((cell[:, 2] << 42) | (cell[:, 1] << 21) | cell[:, 0], np.int64)


def _gathered(parts: list[_Cells]) -> _Cells:
    """Return all parts as one, each cell once, in the order of the keys."""
    key, inverse = np.unique(np.concatenate([p.key for p in parts]), return_inverse=True)
    views = np.zeros(len(key), np.uint16)
    np.maximum.at(views, inverse, np.concatenate([p.views for p in parts]))
    total = np.concatenate([p.total for p in parts])
    sums = np.column_stack([np.bincount(inverse, total[:, k], len(key)) for k in range(total.shape[1])]).astype(np.float64)
    count = np.bincount(inverse, np.concatenate([p.count for p in parts]), len(key)).astype(np.float64)
    return _Cells(key, count, sums, views)

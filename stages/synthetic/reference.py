"""The reference cloud: what at least two cameras truly see, from the exact depth of the empty yard."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..epipolar import backproject
from ..kernels import kernel
from ..types import Camera, Cloud, Float32s, Float64s, Uint8s


@kernel
def _count_views(views: Uint8s, points: Float64s, depth: Float32s, K: Float64s, R: Float64s, C: Float64s) -> None:
    """Add 1 to `views` of each point that lies on the surface `depth` (h, w) that a camera sees."""
    h, w = depth.shape
    for k in range(points.shape[0]):
        dx, dy, dz = points[k, 0] - C[0], points[k, 1] - C[1], points[k, 2] - C[2]
        z = R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
        if z <= 0:
            continue
        x = K[0, 0] * (R[0, 0] * dx + R[0, 1] * dy + R[0, 2] * dz) / z + K[0, 2]
        y = K[1, 1] * (R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz) / z + K[1, 2]
        i, j = int(np.floor(y)), int(np.floor(x))
        if i < 0 or j < 0 or i > h - 2 or j > w - 2:
            continue
        low, high = np.inf, 0.0
        for a in range(2):
            for b in range(2):
                d = depth[i + a, j + b]
                low, high = min(low, d), max(high, d)
        # between its four neighbours in the depth map, and not in the gap of a silhouette
        if low > 0 and low * 0.999 <= z <= high * 1.001 and high < 1.05 * low:
            views[k] += 1


def reference_cloud(
    cameras: Sequence[Camera], depths: Sequence[Float32s], normals: Sequence[Float32s], colors: Sequence[Uint8s], voxel_m: float
) -> Cloud:
    """One point, the mean, per cell of `voxel_m` of all that two cameras or more see.

    depths: (h, w) of each camera, 0 where nothing; normals: (h, w, 3) towards the camera; colors: (h, w, 3) of the same pixels.
    `views` of the cloud: the most cameras that see a point of the cell (its own among them).
    """
    parts: list[tuple[Float64s, Float32s, Uint8s, Uint8s]] = []
    for camera, depth, normal, color in zip(cameras, depths, normals, colors, strict=True):
        v, u = np.nonzero(depth > 0)
        points = backproject(camera, np.column_stack([u, v]).astype(np.float64), depth[v, u].astype(np.float64))
        views = np.ones(len(points), np.uint8)
        for other, theirs in zip(cameras, depths, strict=True):
            if other is not camera:
                _count_views(views, points, theirs, other.K, other.R, other.C)
        shared = views >= 2
        parts.append((points[shared], normal[v, u][shared], color[v, u][shared], views[shared]))
    points, facing, paint, seen = (np.concatenate([part[k] for part in parts]) for k in range(4))
    return _thinned(points, facing, paint, seen, voxel_m)


def _thinned(points: Float64s, normals: Float32s, colors: Uint8s, views: Uint8s, voxel_m: float) -> Cloud:
    """Means per cell of a grid anchored at 0."""
    cell = np.floor(points / voxel_m).astype(np.int64)
    cell -= cell.min(axis=0) if len(cell) else 0
    span = cell.max(axis=0) + 1 if len(cell) else np.ones(3, np.int64)
    key = (cell[:, 2] * span[1] + cell[:, 1]) * span[0] + cell[:, 0]
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    n = len(count)

    def mean(values: Float64s | Float32s | Uint8s) -> Float64s:
        return np.column_stack([np.bincount(inverse, values[:, k], n) / count for k in range(3)])

    normal = mean(normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    most = np.zeros(n, np.uint16)
    np.maximum.at(most, inverse, views.astype(np.uint16))
    return Cloud(
        points=mean(points).astype(np.float32),
        normals=normal.astype(np.float32),
        colors=(mean(colors) + 0.5).astype(np.uint8),
        confidence=np.ones(n, np.float32),
        views=most,
        sigma_mm=np.zeros(n, np.float32),
    )

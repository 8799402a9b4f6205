"""The reference cloud: the surfaces that at least two cameras see, from the exact depth of the empty scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from wbflow_stages.core.cameras import backproject, same_camera
from wbflow_stages.core.jit import kernel
from wbflow_stages.types import Camera, Cloud, Float32s, Float64s, Uint8s

_HALF_CELLS = 1 << 20
"""Cells to either side of the origin, per axis."""

CELL_NUMBER = np.array([1, 1 << 21, 1 << 42])
"""Weights that combine the cell indices along x, y and z into one number; the grid reaches a million cells from the origin."""


class TrueView(NamedTuple):
    """A pinhole view of the empty scene."""

    camera: Camera
    depth: Float32s
    """(h, w), 0 where unknown."""
    normals: Float32s
    colors: Uint8s
    """Normals and colours, (h, w, 3) each."""


def reference_cloud(views: Sequence[TrueView], voxel_m: float) -> Cloud:
    """Return the mean point of each cell of `voxel_m` metres, from all points that at least two cameras see.

    The cloud's `views` is the largest number of cameras, including its own, that see a point of the cell."""
    # for each cell: its number, the sum of (1, position, normal, colour) of its points, and their largest number of views
    keys = np.zeros(0, np.int64)
    sums = np.zeros((0, 10))
    most = np.zeros(0, np.uint16)
    for view in views:
        # 1. The view's points that another camera sees, too.
        v, u = np.nonzero(view.depth > 0)
        depth = view.depth[v, u].astype(np.float64)
        points = backproject(view.camera, np.column_stack([u, v]).astype(np.float64), depth)
        others = [each for each in views if each is not view and not same_camera(each.camera, view.camera)]
        seen_by = 1 + count_views(points, [each.camera for each in others], [each.depth for each in others])
        shared = seen_by >= 2
        v, u, points = v[shared], u[shared], points[shared]

        # 2. Add them to the cells, old and new ones together.
        new = np.column_stack([np.ones(len(points)), points, view.normals[v, u], view.colors[v, u]])
        steps = np.floor(points / voxel_m).astype(np.int64) + _HALF_CELLS
        keys, cell = np.unique(np.concatenate([keys, steps @ CELL_NUMBER]), return_inverse=True)
        columns = np.concatenate([sums, new]).T
        sums = np.column_stack([np.bincount(cell, column, len(keys)) for column in columns])
        before = most
        most = np.zeros(len(keys), np.uint16)
        np.maximum.at(most, cell, np.concatenate([before, seen_by[shared]]))
    mean = sums[:, 1:] / sums[:, :1]
    direction = mean[:, 3:6] / np.maximum(np.linalg.norm(mean[:, 3:6], axis=1, keepdims=True), 1e-9)
    return Cloud(
        points=mean[:, :3].astype(np.float32),
        normals=direction.astype(np.float32),
        colors=(mean[:, 6:] + 0.5).astype(np.uint8),
        confidence=np.ones(len(mean), np.float32),
        views=most,
        sigma_mm=np.zeros(len(mean), np.float32),
    )


def count_views(points: Float64s, cameras: Sequence[Camera], depths: Sequence[Float32s]) -> Uint8s:
    """Return (n,) uint8: how many cameras see each point according to their true depth maps (h, w), 0 where unknown."""
    views = np.zeros(len(points), np.uint8)
    for camera, depth in zip(cameras, depths, strict=True):
        _count(views, points.astype(np.float64), depth.astype(np.float32), camera.K, camera.R, camera.C)
    return views


@kernel
def _count(views: Uint8s, points: Float64s, depth: Float32s, K: Float64s, R: Float64s, C: Float64s) -> None:
    """Add 1 to `views` of each point that is on the surface seen by one camera."""
    h, w = depth.shape
    for k in range(points.shape[0]):
        # 1. Where does the camera see the point?
        dx = points[k, 0] - C[0]
        dy = points[k, 1] - C[1]
        dz = points[k, 2] - C[2]
        z = R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
        if z <= 0:
            continue
        camera_x = R[0, 0] * dx + R[0, 1] * dy + R[0, 2] * dz
        camera_y = R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz
        x = (K[0, 0] * camera_x + K[0, 1] * camera_y) / z
        y = K[1, 1] * camera_y / z + K[1, 2]
        i = int(np.floor(y))
        j = int(np.floor(x + K[0, 2]))
        if i < 0 or j < 0 or i > h - 2 or j > w - 2:
            continue

        # 2. Is it on the surface there?
        low = np.inf
        high = 0.0
        for a in range(2):
            for b in range(2):
                low = min(low, depth[i + a, j + b])
                high = max(high, depth[i + a, j + b])
        # between the depths of its four neighbouring pixels, and not at a depth discontinuity
        if low > 0 and low * 0.999 <= z <= high * 1.001 and high < 1.05 * low:
            views[k] += 1

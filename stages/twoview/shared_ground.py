"""How much of one posed view another one sees, and at what angle, from sample points on rays of each view near the scene.

Only ratios of lengths enter, so a desk and a quarry are treated alike.
"""

from __future__ import annotations

from itertools import combinations
from math import radians

import numpy as np

from ..core.cameras import backproject, project, ray_angles
from ..types import Bools, Camera, Float32s, Float64s, Int64s

FEW_VIEWS = 32
"""Up to this many views, every pair is sampled on the fine grid, and the axes of all views enter the scene distances.  For more
views, the grid is coarse (a quarter of a million pairs of 500 views take a second), and a view's scene distance comes from the
axes of its `FEW_VIEWS` nearest views only: on a large site, the axes of most other views cross far behind what the view shows."""

_Grid = tuple[int, int, int]
"""Sample points of a view: rays across an image, rays down it, and depths on each ray."""
_FINE: _Grid = (8, 6, 5)
"""Sample points up to `FEW_VIEWS` views."""
_COARSE: _Grid = (6, 4, 3)
"""Sample points above `FEW_VIEWS` views."""


def shared_ground(cameras: list[Camera]) -> tuple[Int64s, Float64s, Float64s]:
    """Viewing angle and overlap of pairs of posed views.

    Returns
    -------
    pairs : (m, 2) indices into `cameras`, in ascending order.  Above `FEW_VIEWS` views, only pairs that share something.
    angle : (m,) angle in radians between the two views' rays to shared samples (all if none is); the mean of both medians.
    shared : (m,) share of one view's sample points that the other sees, 0 to 1; the mean of both directions.
    """
    if len(cameras) < 2:
        return np.zeros((0, 2), np.int64), np.zeros(0), np.zeros(0)
    distances = _scene_distances(cameras)
    if len(cameras) > FEW_VIEWS:
        return _shared_by_many(cameras, distances)
    n = len(cameras)
    angle = np.full((n, n), np.nan)
    overlap = np.zeros((n, n))
    for i, camera in enumerate(cameras):
        points = _samples(camera, distances[i], _FINE)
        for j, other in enumerate(cameras):
            if i == j:
                continue
            x, depth = project(other, points)
            # an image reaches half a pixel beyond the centres of its outermost pixels
            is_inside = (x >= -0.5).all(axis=1) & (x < (other.width - 0.5, other.height - 0.5)).all(axis=1)
            is_visible = is_inside & (depth > 0)
            overlap[i, j] = is_visible.mean()
            shared = points[is_visible] if is_visible.any() else points
            angle[i, j] = np.median(ray_angles(shared - camera.C, shared - other.C))
    pairs = np.array(list(combinations(range(n), 2)), np.int64)
    i, j = pairs.T
    return pairs, 0.5 * (angle[i, j] + angle[j, i]), 0.5 * (overlap[i, j] + overlap[j, i])


def _shared_by_many(cameras: list[Camera], distances: Float64s) -> tuple[Int64s, Float64s, Float64s]:
    """The result of `shared_ground` for many views.  If only one view of a pair has visible samples, its angle is used alone."""
    n = len(cameras)
    C = np.stack([camera.C for camera in cameras])
    sides = np.concatenate([_frustum(camera) for camera in cameras]).astype(np.float32)
    angle = np.full((n, n), np.nan, np.float32)
    overlap = np.zeros((n, n), np.float32)
    for i, camera in enumerate(cameras):
        # relative to the view's own centre, single precision is exact enough
        rays = (_samples(camera, distances[i], _COARSE) - C[i]).astype(np.float32)
        offsets = (C - C[i]).astype(np.float32)
        # a sample is inside a side of another view's frustum if it lies farther along the side's normal than that view's centre
        limits = np.einsum("ak,ak->a", sides, np.repeat(offsets, 4, axis=0))
        visible = (sides @ rays.T > limits[:, None]).reshape(n, 4, -1).all(axis=1)
        visible[i] = False
        others = np.flatnonzero(visible.any(axis=1))
        overlap[i, others] = visible[others].mean(axis=1)
        angle[i, others] = _median_angles(rays, offsets[others], visible[others])
    left, right = np.nonzero(np.triu((overlap > 0) | (overlap.T > 0), 1))
    angle1 = angle[left, right].astype(np.float64)
    angle2 = angle[right, left].astype(np.float64)
    mean_angle = 0.5 * (angle1 + angle2)
    mean_angle = np.where(np.isnan(angle2), angle1, mean_angle)
    mean_angle = np.where(np.isnan(angle1), angle2, mean_angle)
    mean_overlap = 0.5 * (overlap[left, right].astype(np.float64) + overlap[right, left])
    return np.column_stack([left, right]), mean_angle, mean_overlap


def _frustum(camera: Camera) -> Float64s:
    """(4, 3) normals, in world axes, of the four sides of a camera's frustum, pointing inward: a point is in the image if its
    vector from the camera's centre has a positive dot product with all four."""
    right = camera.width - 0.5
    bottom = camera.height - 0.5
    # the image's left, right, top and bottom edge as lines l with l x >= 0 inside; the plane of a line l is (K R)^T l
    lines = np.array([[1.0, 0, 0.5], [-1.0, 0, right], [0, 1.0, 0.5], [0, -1.0, bottom]])
    return np.asarray(lines @ camera.K @ camera.R, dtype=np.float64)


def _median_angles(rays: Float32s, offsets: Float32s, visible: Bools) -> Float32s:
    """(m,) median angle in radians between the rays to points (p, 3) from the origin and from each position in `offsets` (m, 3),
    over the visible points (m, p) only: at least one in each row."""
    # cosine between the vectors p and p - o, from their lengths and the products o p: no array of (m, p, 3) is needed
    dot = offsets @ rays.T
    squared = np.einsum("pk,pk->p", rays, rays)
    squared_distance = np.einsum("mk,mk->m", offsets, offsets)[:, None] + squared - 2 * dot
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = (squared - dot) / np.sqrt(squared * squared_distance)
    cosine[~visible] = np.inf
    cosine.sort(axis=1)  # invisible points (inf) come last
    count = visible.sum(axis=1)
    rows = np.arange(len(visible))
    middle = np.stack([cosine[rows, (count - 1) // 2], cosine[rows, count // 2]])
    return np.asarray(np.arccos(np.clip(middle, -1, 1)).mean(axis=0), dtype=np.float32)


def _scene_distances(cameras: list[Camera]) -> Float64s:
    """(n,) distance of the scene along each optical axis: the median of the points nearest to other axes, in front of both.

    Cameras whose axis meets no other get the median of the others' distances.  If no axes meet at all (a row of parallel cameras,
    or cameras that look outward), five times the median distance to the nearest camera: neighbours then differ by 11 degrees.
    """
    C = np.stack([camera.C for camera in cameras])
    axes = np.stack([camera.R[2] for camera in cameras])
    offsets = C[None, :, :] - C[:, None, :]
    cosine = axes @ axes.T
    own_along = np.einsum("ijk,ik->ij", offsets, axes)
    other_along = np.einsum("ijk,jk->ij", offsets, axes)
    # depths of the two points where the axes of views i and j are nearest to each other, (n, n)
    with np.errstate(divide="ignore", invalid="ignore"):
        own_depth = (own_along - cosine * other_along) / (1.0 - cosine**2)
        other_depth = (cosine * own_along - other_along) / (1.0 - cosine**2)
    meets = (own_depth > 0) & (other_depth > 0) & (np.abs(cosine) < np.cos(radians(2.0)))
    baseline = np.linalg.norm(offsets, axis=2)
    if len(cameras) > FEW_VIEWS:
        meets &= baseline <= np.partition(baseline, FEW_VIEWS, axis=1)[:, FEW_VIEWS : FEW_VIEWS + 1]
    distances = np.full(len(cameras), np.nan)
    for i in range(len(cameras)):
        if meets[i].any():
            distances[i] = np.median(own_depth[i, meets[i]])
    is_known = np.isfinite(distances)
    if is_known.any():
        return np.where(is_known, distances, float(np.median(distances[is_known])))
    # no axes meet at all
    nearest_baseline = np.where(baseline > 0, baseline, np.inf).min(axis=1)
    nearest_baseline = nearest_baseline[np.isfinite(nearest_baseline)]
    if not nearest_baseline.size:  # all cameras are at one place: any distance will do
        return np.full(len(cameras), 1.0)
    return np.full(len(cameras), 5.0 * float(np.median(nearest_baseline)))


def _samples(camera: Camera, distance: float, grid: _Grid) -> Float64s:
    """(n, 3) world points on a grid of rays, at depths from half to twice the scene's distance."""
    columns, rows, steps = grid
    x = (np.arange(columns) + 0.5) / columns * camera.width - 0.5
    y = (np.arange(rows) + 0.5) / rows * camera.height - 0.5
    depths = distance * 2.0 ** np.linspace(-1, 1, steps)
    u, v, z = (axis.ravel() for axis in np.meshgrid(x, y, depths, indexing="ij"))
    return backproject(camera, np.column_stack([u, v]), z)

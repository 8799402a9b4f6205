"""What the cameras saw at points in the world: free space, a surface at the point, or something in front of it.

Clouds alone cannot distinguish a surface that has vanished from one that no camera saw.  Depth maps can: a camera whose depth
lies clearly behind a place has seen through it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..core.jit import kernel
from ..types import Bools, Camera, DepthMap, Float32s, Float64s, Uint8s

_SIGMAS = 3.0
"""A depth agrees with a point within this many standard deviations of both, plus `_RELATIVE_TOLERANCE` times the depth.  With
more, changes that are closer to the old surface are missed; with less, noise counts as change."""
_RELATIVE_TOLERANCE = 0.002
"""Part of the tolerance that grows with the depth, no unit: for errors of poses, which the standard deviations do not contain."""
_CLEAR_FACTOR = 2.0
"""A camera sees through a point if its depth lies behind it by more than this many times the tolerance for agreement."""
_THROUGH_RATIO = 2.0
"""A place is free if the cameras that see through it are more than this many times those that see a surface there."""


@dataclass(frozen=True)
class Sight:
    """What the cameras saw at each of n points, (n,) each."""

    through: Uint8s
    """Number of cameras that saw through the point."""
    agreeing: Uint8s
    """Number of cameras that saw a surface at the point."""
    hidden: Uint8s
    """Number of cameras that saw something in front of the point."""
    gap: Float32s
    """Depth of the surface behind minus that of the point, smallest over the cameras that saw through; nan if none did."""
    gap_sigma: Float32s
    """Standard deviation of `gap`."""

    @property
    def is_free(self) -> Bools:
        """(n,) points where nothing stands: far more cameras saw through than saw a surface."""
        return np.asarray(self.through > _THROUGH_RATIO * self.agreeing, dtype=np.bool_)


def look_at(
    X: Float64s, sigma: Float64s, cameras: Mapping[str, Camera], names: Iterable[str], depth_of: Callable[[str], DepthMap]
) -> Sight:
    """Compare points with the depth maps of cameras.

    The neighbours of a pixel are taken into account: at a silhouette, whose edge may be a pixel off, no camera sees through.

    Parameters
    ----------
    X, sigma : (n, 3) points in the world and (n,) their standard deviations.
    cameras, names : cameras by id, and the ids of those that have a depth map.
    depth_of : loads the depth map of a camera; called once for each.
    """
    n = len(X)
    counts = np.zeros((3, n), np.uint8)
    gap = np.full(n, np.inf, np.float32)  # a minimum over the cameras
    gap_sigma = np.full(n, np.nan, np.float32)
    for name in names:
        camera = cameras[name]
        depths = depth_of(name)
        # x ~ K R (X - C) = A X - b
        A = camera.K @ camera.R
        b = camera.K @ camera.R @ camera.C
        _look(X, sigma, A, b, depths.depth, depths.sigma, counts, gap, gap_sigma)
    known_gap = np.where(np.isfinite(gap), gap, np.float32(np.nan))
    return Sight(through=counts[0], agreeing=counts[1], hidden=counts[2], gap=known_gap, gap_sigma=gap_sigma)


@kernel
def _look(
    X: Float64s, sigma: Float64s, A: Float64s, b: Float64s, depth: Float32s, depth_sigma: Float32s, counts: Uint8s,
    gap: Float32s, gap_sigma: Float32s,
) -> None:  # fmt: skip
    """Look at points X (n, 3) by one camera, with x ~ A X - b.

    Adds to `counts` (3, n): seen through, agreeing, hidden; updates `gap` and `gap_sigma` (n,).
    """
    h, w = depth.shape
    for k in range(len(X)):
        z = A[2, 0] * X[k, 0] + A[2, 1] * X[k, 1] + A[2, 2] * X[k, 2] - b[2]
        if not z > 0:
            continue
        u = (A[0, 0] * X[k, 0] + A[0, 1] * X[k, 1] + A[0, 2] * X[k, 2] - b[0]) / z
        v = (A[1, 0] * X[k, 0] + A[1, 1] * X[k, 1] + A[1, 2] * X[k, 2] - b[1]) / z
        if not (u > -0.5 and v > -0.5 and u < w - 0.5 and v < h - 0.5):
            continue
        i = int(u + 0.5)
        j = int(v + 0.5)
        if np.isnan(depth[j, i]):
            continue
        # Range of depths around the pixel: a silhouette may be a pixel off.
        nearest = np.inf
        farthest = 0.0
        worst_sigma = 0.0
        for y in range(max(j - 1, 0), min(j + 2, h)):
            for x in range(max(i - 1, 0), min(i + 2, w)):
                if not np.isnan(depth[y, x]):
                    nearest = min(nearest, depth[y, x])
                    farthest = max(farthest, depth[y, x])
                    worst_sigma = max(worst_sigma, depth_sigma[y, x])
        total_sigma = np.sqrt(worst_sigma * worst_sigma + sigma[k] * sigma[k])
        tolerance = _SIGMAS * total_sigma + _RELATIVE_TOLERANCE * z
        # A depth between "agrees" and "clearly behind" counts for neither.
        if z > farthest + tolerance:
            counts[2, k] += 1
        elif z >= nearest - tolerance:
            counts[1, k] += 1
        elif z < nearest - _CLEAR_FACTOR * tolerance:
            counts[0, k] += 1
            if nearest - z < gap[k]:
                gap[k] = nearest - z
                gap_sigma[k] = total_sigma

"""What cameras saw of the places where points are: nothing but air, the point itself, or something in front of it.

Clouds alone cannot tell what has gone from what nobody has seen.  Depth maps can: a camera whose depth lies clearly behind a
place has seen through it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..core.jit import kernel
from ..types import Camera, DepthMap, Float32s, Float64s, Uint8s

_SIGMAS = 3.0
_RELATIVE = 0.002
"""A depth agrees within so many standard deviations of both, and this share of it..."""
_CLEARLY = 2.0
"""...and lies clearly behind beyond so many times that."""


@dataclass(frozen=True)
class Sight:
    """What the cameras saw at each of n points, (n,) each."""

    through: Uint8s
    """Cameras that saw through it..."""
    agreeing: Uint8s
    """...those that saw a surface there..."""
    hidden: Uint8s
    """...and those before which something nearer stood."""
    gap: Float32s
    """How far behind it the nearest surface lies, along the ray, by the camera for which that is least; nan where none saw
    through."""
    doubt: Float32s
    """Standard deviation of that."""


def look_at(
    X: Float64s, sigma: Float64s, cameras: Mapping[str, Camera], names: Iterable[str], depth_of: Callable[[str], DepthMap]
) -> Sight:
    """Ask cameras what they saw of points.

    A pixel's neighbours have a say: a point at a silhouette is not seen through, as the edge may be a pixel off.

    Parameters
    ----------
    X, sigma : (n, 3) points in the world and (n,) their standard deviations.
    cameras, names : by id, and those that have a depth map.
    depth_of : loads it; asked once for each.
    """
    n = len(X)
    counts = np.zeros((3, n), np.uint8)
    gap, doubt = np.full(n, np.inf, np.float32), np.full(n, np.nan, np.float32)
    for name in names:
        camera, seen = cameras[name], depth_of(name)
        _look(X, sigma, camera.K @ camera.R, camera.K @ camera.R @ camera.C, seen.depth, seen.sigma, counts, gap, doubt)
    return Sight(counts[0], counts[1], counts[2], np.where(np.isfinite(gap), gap, np.float32(np.nan)), doubt)


@kernel
def _look(
    X: Float64s, sigma: Float64s, A: Float64s, b: Float64s, depth: Float32s, depth_sigma: Float32s, counts: Uint8s,
    gap: Float32s, doubt: Float32s,
) -> None:  # fmt: skip
    h, w = depth.shape
    for k in range(len(X)):
        z = A[2, 0] * X[k, 0] + A[2, 1] * X[k, 1] + A[2, 2] * X[k, 2] - b[2]
        if not z > 0:
            continue
        u = (A[0, 0] * X[k, 0] + A[0, 1] * X[k, 1] + A[0, 2] * X[k, 2] - b[0]) / z
        v = (A[1, 0] * X[k, 0] + A[1, 1] * X[k, 1] + A[1, 2] * X[k, 2] - b[1]) / z
        if not (u > -0.5 and v > -0.5 and u < w - 0.5 and v < h - 0.5):
            continue
        i, j = int(u + 0.5), int(v + 0.5)
        if np.isnan(depth[j, i]):
            continue
        nearest, farthest, worst = np.inf, 0.0, 0.0
        for y in range(max(j - 1, 0), min(j + 2, h)):
            for x in range(max(i - 1, 0), min(i + 2, w)):
                if not np.isnan(depth[y, x]):
                    nearest, farthest = min(nearest, depth[y, x]), max(farthest, depth[y, x])
                    worst = max(worst, depth_sigma[y, x])
        s = np.sqrt(worst * worst + sigma[k] * sigma[k])
        tolerance = _SIGMAS * s + _RELATIVE * z
        if z > farthest + tolerance:
            counts[2, k] += 1
        elif z >= nearest - tolerance:
            counts[1, k] += 1
        elif z < nearest - _CLEARLY * tolerance:
            counts[0, k] += 1
            if nearest - z < gap[k]:
                gap[k], doubt[k] = nearest - z, s

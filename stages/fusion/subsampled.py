"""Views subsampled to every 4th pixel: enough to plan the fusion of a whole site, small enough to be held."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from ..core.cameras import same_camera, transfer
from ..types import Camera, DepthMap, Float32s, Float64s, Frame, Uint8s

STEP = 4


@dataclass(frozen=True)
class Subsampled:
    """A view at a quarter of its size."""

    colors: Uint8s
    """(h / 4, w / 4, 3) uint8, means over blocks, which pixel noise and small errors of depth don't reach."""
    depth: Float32s
    sigma: Float32s
    """(h / 4, w / 4) float32, of the pixel beside each block's centre."""

    def points(self, step: int) -> tuple[Float64s, Float64s]:
        """Pixels (n, 3), homogeneous, and depths (n, 1) of every `step`-th place that has a depth."""
        depth = self.depth[::step, ::step]
        y, x = np.nonzero(np.isfinite(depth))
        pixels = np.column_stack([STEP * step * x + STEP // 2, STEP * step * y + STEP // 2, np.ones(len(x))])
        return pixels.astype(np.float64), depth[y, x].astype(np.float64)[:, None]


def subsample(frame: Frame, depth: DepthMap) -> Subsampled:
    """A view on every 4th pixel."""
    h, w = frame.image.shape[:2]
    colors = cv2.resize(frame.image, (max(1, w // STEP), max(1, h // STEP)), interpolation=cv2.INTER_AREA)
    cells = slice(STEP // 2, None, STEP), slice(STEP // 2, None, STEP)
    return Subsampled(np.asarray(colors, dtype=np.uint8), depth.depth[cells].copy(), depth.sigma[cells].copy())


def nearest_views(name: str, cameras: Mapping[str, Camera], small: Mapping[str, Subsampled], count: int) -> list[str]:
    """The views of other cameras that see most of what one view sees, and at least 1 % of it.

    Parameters
    ----------
    name
        The view.
    cameras, small
        Of all views, by id.
    count
        So many at most.
    """
    pixels, z = small[name].points(2)
    if not len(z):
        return []
    shares = []
    for other in cameras:
        if other == name or same_camera(cameras[name], cameras[other]):  # which says the same again
            continue
        M, b = transfer(cameras[name], cameras[other])
        with np.errstate(divide="ignore", invalid="ignore"):
            p = z * (pixels @ M.T) + b
            u, v = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
        inside = (p[:, 2] > 0) & (u >= 0) & (v >= 0) & (u <= cameras[other].width - 1) & (v <= cameras[other].height - 1)
        shares.append((float(inside.mean()), other))
    order = sorted(range(len(shares)), key=lambda k: -shares[k][0])
    return [shares[k][1] for k in order[:count] if shares[k][0] >= 0.01]


def natural_voxel(cameras: Mapping[str, Camera], small: Mapping[str, Subsampled]) -> float:
    """What a pixel covers, or one and a half sigmas if that is more, in the median over all views: finer voxels hold only noise.

    Rounded down to a preferred number, so that the grid stays the same when cameras fail or surfaces change from night to night.
    """
    edges = [np.fmax(g.depth / cameras[name].K[0, 0], 1.5 * g.sigma)[1::2, 1::2].ravel() for name, g in small.items()]
    median = float(np.nanmedian(np.concatenate(edges)))
    decade = 10.0 ** np.floor(np.log10(median))
    return float(decade * max(step for step in _PREFERRED if step <= max(median / decade, 1.0)))


_PREFERRED = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.3, 8.0)
"""Renard's series R10: ten steps to a decade."""

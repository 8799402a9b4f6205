"""Depths of other views transferred into one view, as planes to be tried where its own pairs have none.

A pair that sees a surface well gives its position in views whose own pairs do not.  Transferred depths are not evidence: a
plane is used only where this view's own photographs confirm it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..core.cameras import transfer
from ..core.jit import kernel
from ..types import Camera, DepthMap, Float32s, Float64s
from .propagation import Propagation


def transferred_planes(camera: Camera, cameras: Mapping[str, Camera], depths: Mapping[str, DepthMap]) -> Float32s:
    """(3, h, w) planes of the surface nearest to a camera, from depths of other views; nan where these have none.

    cameras, depths: of the other views; cameras of another component are skipped.
    """
    planes = np.full((3, camera.height, camera.width), np.nan, np.float32)
    for name, depth in depths.items():
        if name in cameras and cameras[name].component == camera.component:
            to_view = transfer(cameras[name], camera)
            from_view = transfer(camera, cameras[name])
            _transfer(depth.depth, depth.slope_x, depth.slope_y, *to_view, *from_view, planes)
    return planes


def with_transferred(planes: Float32s, transferred: Float32s, propagation: Propagation, max_cost: float) -> Float32s:
    """Planes of a view; where it has none, the transferred ones that a source sees.

    Parameters
    ----------
    planes, transferred : (3, h, w) each, nan for none.
    propagation, max_cost : of the view; a source sees a plane that costs less than `max_cost`.
    """
    trial = np.where(np.isnan(planes[0]), transferred, np.float32(np.nan))
    return np.where(propagation.support(trial, max_cost).first < max_cost, trial, planes)


@kernel
def _transfer(
    depth: Float32s,
    slope_x: Float32s,
    slope_y: Float32s,
    M: Float64s,
    b: Float64s,
    M_back: Float64s,
    b_back: Float64s,
    planes: Float32s,
) -> None:
    """Write planes of one view at the pixels of another that see them, where they are nearer than the planes already there.

    Parameters
    ----------
    depth, slope_x, slope_y : (h', w') of the first view.
    M, b : from the first view to the other: pixel p at depth z projects to z M p + b.
    M_back, b_back : from the other view to the first.
    planes : (3, h, w) of the other view: q, A, B, changed in place.
    """
    h, w = planes.shape[1:]
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            z = np.float64(depth[y, x])
            if np.isnan(z):
                continue
            other_z = z * (M[2, 0] * x + M[2, 1] * y + M[2, 2]) + b[2]
            if not other_z > 0:
                continue
            u = (z * (M[0, 0] * x + M[0, 1] * y + M[0, 2]) + b[0]) / other_z
            v = (z * (M[1, 0] * x + M[1, 1] * y + M[1, 2]) + b[1]) / other_z
            if not (u > -0.5 and v > -0.5 and u < w - 0.5 and v < h - 0.5):
                continue
            i = int(u + 0.5)
            j = int(v + 0.5)
            # A plane's inverse depth is linear in the pixels of both cameras: n (x, y, 1) here, changing by (across, down) there.
            n0 = np.float64(slope_x[y, x])
            n1 = np.float64(slope_y[y, x])
            n2 = 1.0 / z - n0 * x - n1 * y
            scale = 1.0 / (1.0 - n0 * b_back[0] - n1 * b_back[1] - n2 * b_back[2])
            across = scale * (n0 * M_back[0, 0] + n1 * M_back[1, 0] + n2 * M_back[2, 0])
            down = scale * (n0 * M_back[0, 1] + n1 * M_back[1, 1] + n2 * M_back[2, 1])
            # from the exact position to the middle of the pixel
            q = np.float32(1.0 / other_z + across * (i - u) + down * (j - v))
            if q > 0 and not q <= planes[0, j, i]:  # nan, where there is no plane yet, is replaced, too
                planes[0, j, i] = q
                planes[1, j, i] = across
                planes[2, j, i] = down

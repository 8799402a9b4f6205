"""A view looked at as coarsely as others that see much less, where nothing that sees as finely shows its surface.

Compared with a far coarser picture, a fine one fits at many depths; reduced to the other's pixels it fits at one.  So depth that
fine views have not given is taken from a second, small picture of the view, which costs a fraction of the first.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from ..core.cameras import scaled_intrinsics
from ..fusion.overlay import overlaid
from ..types import Camera, DepthMap, Frame, Int64s, Uint8s


def reduced(image: Uint8s, camera: Camera, times: float) -> tuple[Uint8s, Camera]:
    """The picture (h, w, 3) or (h, w) of a camera and the camera, with pixels so many times as large."""
    width, height = (max(8, round(side / times)) for side in (camera.width, camera.height))
    K = scaled_intrinsics(camera.K, width / camera.width, height / camera.height)
    small = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return small, replace(camera, K=K, width=width, height=height)


def reduced_view(frame: Frame, camera: Camera, depth: DepthMap, times: float) -> tuple[Frame, Camera, DepthMap]:
    """The same with pixels so many times as large.

    Parameters
    ----------
    frame, camera, depth : of a view.  Of the larger pixels those may be used in which all may be; depth is that of their middles.
    times : how large, in pixels of the view.
    """
    image, small = reduced(frame.image, camera, times)
    usable = reduced(np.where(frame.mask, np.uint8(255), np.uint8(0)), camera, times)[0] == 255
    coarse = depth.at(np.ix_(_middles(small.height, camera.height), _middles(small.width, camera.width)))
    step_x, step_y = np.float32(camera.width / small.width), np.float32(camera.height / small.height)
    coarse = replace(coarse, slope_x=coarse.slope_x * step_x, slope_y=coarse.slope_y * step_y)
    return replace(frame, image=image, mask=usable), small, coarse


def filled(depth: DepthMap, coarse: DepthMap) -> DepthMap:
    """Depth of a view with what its reduced picture has shown where it lacks, or where only the reduced one's can be believed."""
    h, w = depth.depth.shape
    rows, columns = _middles(h, coarse.depth.shape[0]), _middles(w, coarse.depth.shape[1])
    there = coarse.at(np.ix_(rows, columns))
    step_x, step_y = np.float32(w / coarse.depth.shape[1]), np.float32(h / coarse.depth.shape[0])
    right = ((np.arange(w, dtype=np.float32) + np.float32(0.5)) / step_x - np.float32(0.5) - columns)[None].astype(np.float32)
    down = ((np.arange(h, dtype=np.float32) + np.float32(0.5)) / step_y - np.float32(0.5) - rows)[:, None].astype(np.float32)
    q = 1.0 / there.depth + there.slope_x * right + there.slope_y * down
    taken = (q > 0) & ~depth.sure & (there.sure | np.isnan(depth.depth))
    with np.errstate(divide="ignore"):
        z = (1.0 / q).astype(np.float32)
    fine = replace(there, depth=z, slope_x=there.slope_x / step_x, slope_y=there.slope_y / step_y)
    return overlaid(depth, fine, taken)


def _middles(count: int, of: int) -> Int64s:
    """(count,) which of so many pixels lie nearest to the middles of `count` others that cover the same."""
    return np.clip(np.round((np.arange(count) + 0.5) * of / count - 0.5), 0, of - 1).astype(np.int64)

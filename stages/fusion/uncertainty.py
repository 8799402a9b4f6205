"""How sure a depth is: what its own noise model expects, put right by what is seen of its errors.

Errors of matching follow texture, shading and the slant of a surface, which no model of pixel noise knows.  Two things show them:

- views that agree put the surface elsewhere on this view's ray, by so much of what both models together let expect.  A view that
  sees a surface finely differs much from one that sees it roughly, and errs little: differences alone would not tell which;
- pixels around lie off the plane through this one, by so much of what the model lets expect.

Either tells by which factor the model is wrong, and is wrong by a factor itself: their logarithms are averaged.  By how much each
has to say is a regression of errors on all three, on demo yards of 320 to 1280 pixels: from one view that agrees to six, and from
scene to scene, it finds nearly the same.  No scale is fitted.

Two views of n + 1 share one of the n pairs that each rests on, and with it a part of their errors, which neither shows: were it
all, their errors would correlate by 1 / (n + 1), and the variance would be 1 + 1 / n times what is seen of it.

What a depth errs by along its ray depends on how the surface is turned to it: with the angle between them it becomes the error
across the surface, and that the error along another camera's ray.  Of a point that several cameras have, the nearest counts.
"""

from __future__ import annotations

import numpy as np

from ..core.jit import kernel
from ..types import Camera, DepthMap, Float32s, Float64s, Int64s, Uint8s
from .visibility import ITSELF, CrossCheck

_MODEL, _ROUGHNESS = 0.2, 1.5
"""What the model and the pixels around have to say, beside the root of the number of views that agree."""
_SHARED = 0.5
"""Of the error that views would share if nothing but their pairs made it (fitted on the demo's yards, apron and stadium)."""
_NORMAL_LOG = -0.635
"""Mean logarithm of what a normal distribution of unit variance draws, without its sign."""
_LAID = 0.05
"""Pixels off their plane by no more than this share of what is expected were laid on it: that says nothing of how right it is."""
_AROUND, _PATCHES_PX = 2, 768
"""Pixels to those around, in images so long: nearer ones were matched on nearly the same patch, which grows with the image."""
_OTHER_SURFACE = 0.02
"""What lies farther off the plane, as a share of the depth, is cut off there."""
_GRAZING = 0.05
"""Least cosine of ray and normal that is reckoned with."""


def depth_variance(depth: DepthMap, check: CrossCheck, y: Int64s, x: Int64s) -> Float64s:
    """(n,) squared standard deviation of depths along the optical axis, world lengths.

    Parameters
    ----------
    depth, check : of a view, and what the others say of it.
    y, x : (n,) rows and columns of pixels that have a depth.
    """
    sigma, views = depth.sigma[y, x].astype(np.float64), check.agreeing[y, x].astype(np.float64)
    around = _AROUND * max(1, round(max(depth.depth.shape) / _PATCHES_PX))
    rough = _roughness(depth.depth, depth.slope_x, depth.slope_y, y, x, around) * depth.depth[y, x] / sigma
    by_pixels = np.where(rough > _LAID, _ROUGHNESS, 0.0)
    apart = check.apart[y, x] / np.maximum(views, 1.0) - np.where(views > 0, _NORMAL_LOG, 0.0)
    factor = np.sqrt(views) * apart + by_pixels * np.log(np.maximum(rough, _LAID))
    seen = sigma * np.exp(factor / (_MODEL + np.sqrt(views) + by_pixels))
    return np.asarray(seen**2 * (1.0 + _SHARED / np.maximum(views, 1.0)), dtype=np.float64)


def along_nearest_rays(
    variance: Float64s, camera: Camera, others: Float64s, nearest: Uint8s, points: Float64s, normals: Float64s
) -> Float64s:
    """(n,) squared standard deviations of points along the ray of the nearest camera that has each, from those along the axis.

    Parameters
    ----------
    variance, points, normals : (n,), (n, 3) and (n, 3), of points of a view's pixels.
    camera : of the view.
    others : (k, 3) centres of the views that it was compared with.
    nearest : (n,) which of them is the nearest, `ITSELF`: the view.
    """
    centres = np.concatenate([others, camera.C[None]])
    there = centres[np.where(nearest == ITSELF, len(others), nearest)] - points
    own, axis = camera.C - points, (points - camera.C) @ camera.R[2]
    across = np.abs(np.sum(own * normals, axis=1)) / axis
    cosine = np.abs(np.sum(there * normals, axis=1)) / np.linalg.norm(there, axis=1)
    return np.asarray(variance * (across / np.maximum(cosine, _GRAZING)) ** 2, dtype=np.float64)


@kernel
def _roughness(depth: Float32s, slope_x: Float32s, slope_y: Float32s, y: Int64s, x: Int64s, around: int) -> Float32s:
    """(n,) mean distance of the eight pixels around from the plane of one, as a share of its depth; 0 where none is known."""
    h, w = depth.shape
    rough = np.zeros(len(y), np.float32)
    for n in range(len(y)):
        here, total, count = depth[y[n], x[n]], 0.0, 0
        for j in range(-around, around + 1, around):
            for i in range(-around, around + 1, around):
                row, column = y[n] + j, x[n] + i
                if (i == 0 and j == 0) or not (0 <= row < h and 0 <= column < w) or np.isnan(depth[row, column]):
                    continue
                plane = 1.0 / here + slope_x[y[n], x[n]] * i + slope_y[y[n], x[n]] * j
                total += min(abs(here / depth[row, column] - here * plane), _OTHER_SURFACE)
                count += 1
        rough[n] = total / count if count else 0.0
    return rough

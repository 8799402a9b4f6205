"""Does a place look the same on both nights to a fixed camera?  Patches are compared by correlation, as the light may change."""

from __future__ import annotations

import numpy as np

from ..core.cameras import project
from ..core.jit import kernel
from ..core.luminance import grey_levels
from ..types import Bools, Camera, Float32s, Float64s, Frame

_RADIUS = 3
"""Radius of patches, in pixels of an image 768 pixels wide."""
_CONTRAST = 2.5
"""Standard deviation of grey levels (0 to 255) below which a patch shows nothing."""
_CLEAR_CONTRAST = 9.0
"""Two patches differ (correlation 0) if one has at least this standard deviation and the other shows nothing."""
_LIT = 40.0
"""Smallest mean grey level of both patches for a patch that shows nothing to count as different: dark ones hide everything."""


Photograph = tuple[Camera, Frame]
"""A camera and its frame on one night."""


def ncc(X: Float64s, seen: Bools, tonight: Photograph, then: Photograph) -> Float32s:
    """(n,) correlation, -1 to 1, of the patches around points in both images, the best of nine shifts by a pixel.

    nan where a patch shows nothing, is masked or lies outside.

    Parameters
    ----------
    X : (n, 3) points in the world.
    seen : (n,) bool, the points that are compared.
    tonight, then : the same camera on both nights; images of different sizes give nan.
    """
    found = np.full(len(X), np.nan, np.float32)
    (camera, frame), (_, frame_then) = tonight, then
    if frame.image.shape != frame_then.image.shape:
        return found
    rows = np.flatnonzero(seen)
    (x1, z1), (x2, z2) = (project(p[0], X[rows]) for p in (tonight, then))
    ahead = (z1 > 0) & (z2 > 0) & np.isfinite(x1).all(axis=1) & np.isfinite(x2).all(axis=1)
    rows, x1, x2 = rows[ahead], x1[ahead], x2[ahead]
    step = max(1, round(camera.width / 768))
    out = np.full(len(rows), np.nan, np.float32)
    image1, image2 = (grey_levels(side.image).astype(np.float32) for side in (frame, frame_then))
    _correlate(image1, image2, frame.mask, frame_then.mask, x1, x2, step, out)
    found[rows] = out
    return found


@kernel
def _correlate(
    image1: Float32s, image2: Float32s, mask1: Bools, mask2: Bools, x1: Float64s, x2: Float64s, step: int, out: Float32s
) -> None:
    h, w = image1.shape
    radius = _RADIUS
    reach = radius * step + 1
    n = float((2 * radius + 1) ** 2)
    for k in range(len(x1)):
        if not (abs(x1[k, 0]) < 1e6 and abs(x1[k, 1]) < 1e6 and abs(x2[k, 0]) < 1e6 and abs(x2[k, 1]) < 1e6):
            continue
        a, b = int(np.floor(x1[k, 0] + 0.5)), int(np.floor(x1[k, 1] + 0.5))
        c, d = int(np.floor(x2[k, 0] + 0.5)), int(np.floor(x2[k, 1] + 0.5))
        if min(a, b, c, d) < reach or max(a, c) >= w - reach or max(b, d) >= h - reach or not (mask1[b, a] and mask2[d, c]):
            continue
        s1, s11 = 0.0, 0.0
        for y in range(-radius, radius + 1):
            for x in range(-radius, radius + 1):
                here = image1[b + y * step, a + x * step]
                s1 += here
                s11 += here * here
        spread1 = np.sqrt(max(s11 / n - (s1 / n) ** 2, 0.0))
        best, widest, darkest = -2.0, 0.0, s1 / n
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                s2, s22, s12 = 0.0, 0.0, 0.0
                for y in range(-radius, radius + 1):
                    for x in range(-radius, radius + 1):
                        there = image2[d + dy + y * step, c + dx + x * step]
                        s2 += there
                        s22 += there * there
                        s12 += there * image1[b + y * step, a + x * step]
                spread2 = np.sqrt(max(s22 / n - (s2 / n) ** 2, 0.0))
                widest, darkest = max(widest, spread2), min(darkest, s2 / n)
                if spread1 >= _CONTRAST and spread2 >= _CONTRAST:
                    best = max(best, (s12 / n - s1 * s2 / n / n) / (spread1 * spread2))
        if best >= -1.0:
            out[k] = best
        elif max(spread1, widest) >= _CLEAR_CONTRAST and darkest >= _LIT:
            out[k] = 0.0

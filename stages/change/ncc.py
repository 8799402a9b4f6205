"""Does a place look the same on both nights to a fixed camera?  Patches are compared by correlation, as the light may change."""

from __future__ import annotations

import numpy as np

from ..core.cameras import project
from ..core.jit import helper, kernel
from ..core.luminance import grey_levels
from ..types import Bools, Camera, Float32s, Float64s, Frame

_RADIUS_PX = 3
"""Radius of patches, in pixels of an image `_REFERENCE_WIDTH` pixels wide.  Larger patches are more distinct, but mix things."""
_REFERENCE_WIDTH = 768
"""Width in pixels of images that are read pixel by pixel; in wider ones, patches skip pixels so that they show as much."""
_FAR_PX = 1e6
"""Points that project farther away than this are not in view, whatever the image."""
_LEAST_CONTRAST = 2.5
"""Standard deviation of grey levels (0 to 255) below which a patch shows nothing."""
_CLEAR_CONTRAST = 9.0
"""Two patches differ (correlation 0) if one has at least this standard deviation and the other shows nothing."""
_LIT_LEVEL = 40.0
"""Smallest mean grey level of both patches for a patch that shows nothing to count as different: dark ones hide everything."""


def ncc(X: Float64s, seen: Bools, camera1: Camera, frame1: Frame, camera2: Camera, frame2: Frame) -> Float32s:
    """(n,) correlation, -1 to 1, of the patches around points in both images, the best of nine shifts by a pixel.

    nan where a patch shows nothing, is masked or lies outside.

    Parameters
    ----------
    X : (n, 3) points in the world.
    seen : (n,) bool, the points that are compared.
    camera1, frame1, camera2, frame2 : the same camera on both nights; images of different sizes give nan.
    """
    correlations = np.full(len(X), np.nan, np.float32)
    if frame1.image.shape != frame2.image.shape:
        return correlations
    rows = np.flatnonzero(seen)
    x1, z1 = project(camera1, X[rows])
    x2, z2 = project(camera2, X[rows])
    # Pixels become integers below: those of points far outside would overflow.
    near_view = (z1 > 0) & (z2 > 0) & (np.abs(x1) < _FAR_PX).all(axis=1) & (np.abs(x2) < _FAR_PX).all(axis=1)
    rows = rows[near_view]
    x1 = x1[near_view]
    x2 = x2[near_view]
    step = max(1, round(camera1.width / _REFERENCE_WIDTH))
    out = np.full(len(rows), np.nan, np.float32)
    image1 = grey_levels(frame1.image).astype(np.float32)
    image2 = grey_levels(frame2.image).astype(np.float32)
    _correlate(image1, image2, frame1.mask, frame2.mask, x1, x2, step, out)
    correlations[rows] = out
    return correlations


@kernel
def _correlate(
    image1: Float32s, image2: Float32s, mask1: Bools, mask2: Bools, x1: Float64s, x2: Float64s, step: int, out: Float32s
) -> None:
    """Correlate the patches around x1 and x2 (n, 2); out (n,) keeps its value where a patch is masked or reaches outside."""
    h, w = image1.shape
    reach = _RADIUS_PX * step + 1  # the patch, and a shift by a pixel
    for k in range(len(x1)):
        u1 = int(np.floor(x1[k, 0] + 0.5))
        v1 = int(np.floor(x1[k, 1] + 0.5))
        u2 = int(np.floor(x2[k, 0] + 0.5))
        v2 = int(np.floor(x2[k, 1] + 0.5))
        if (
            min(u1, v1, u2, v2) >= reach
            and max(u1, u2) < w - reach
            and max(v1, v2) < h - reach
            and mask1[v1, u1]
            and mask2[v2, u2]
        ):
            out[k] = _best_of_shifts(image1, image2, u1, v1, u2, v2, step)


@helper
def _best_of_shifts(image1: Float32s, image2: Float32s, u1: int, v1: int, u2: int, v2: int, step: int) -> float:
    """Largest correlation of a patch with those at and around a place of the other image; 0 if one shows something and the other,
    which is lit, nothing; nan if neither shows anything."""
    radius = _RADIUS_PX
    n = float((2 * _RADIUS_PX + 1) ** 2)
    # Sums of values and of squares, in patch 1 and below in patch 2, and of products.
    s1 = 0.0
    s11 = 0.0
    for y in range(-radius, radius + 1):
        for x in range(-radius, radius + 1):
            value1 = image1[v1 + y * step, u1 + x * step]
            s1 += value1
            s11 += value1 * value1
    spread1 = np.sqrt(max(s11 / n - (s1 / n) ** 2, 0.0))
    best = -2.0  # below every correlation
    most_spread = spread1
    least_mean = s1 / n
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            s2 = 0.0
            s22 = 0.0
            s12 = 0.0
            for y in range(-radius, radius + 1):
                for x in range(-radius, radius + 1):
                    value2 = image2[v2 + dy + y * step, u2 + dx + x * step]
                    s2 += value2
                    s22 += value2 * value2
                    s12 += value2 * image1[v1 + y * step, u1 + x * step]
            spread2 = np.sqrt(max(s22 / n - (s2 / n) ** 2, 0.0))
            most_spread = max(most_spread, spread2)
            least_mean = min(least_mean, s2 / n)
            if spread1 >= _LEAST_CONTRAST and spread2 >= _LEAST_CONTRAST:
                best = max(best, (s12 / n - s1 * s2 / n / n) / (spread1 * spread2))
    if best >= -1.0:
        return best
    # No shift has texture in both patches: they differ if one has clear texture and neither is dark.
    if most_spread >= _CLEAR_CONTRAST and least_mean >= _LIT_LEVEL:
        return 0.0
    return np.nan

"""Matches on the ground between cameras that are known to within their standard deviations.

On repetitive paving, keypoints match wrong stones as well as the right one.  But if two cameras and the ground plane are known
approximately, the position of a patch in the other image is predicted to within some pixels.  The patch, warped by the ground's
homography, is searched only there, and counts only if nothing else within reach looks the same.
"""

from __future__ import annotations

import numpy as np

from ..core.jit import helper, kernel
from ..types import Camera, Float32s, Float64s
from .ground import below_horizon, ground_homography

_PATCHES = 64
"""Patches across the wider side of a view."""

_RADIUS = 6
"""Radius of a patch, pixels."""

_LEAST_CORRELATION = 0.75
"""Smallest correlation of matching patches."""

_LEAST_LEAD = 0.12
"""Smallest lead of the best correlation over that at any other place within reach: with less, the place is ambiguous."""

_SAME_PLACE_PX = 3
"""Places within this distance of the best one do not count as others."""

_LEAST_VARIANCE = 16.0
"""Smallest variance of a patch's grey levels, squared: flatter patches look similar anywhere."""

_NOISE_VARIANCE = 4.0
"""Added to the variances in a correlation, grey levels squared: patches with less contrast than noise match nothing."""

_MOST_STRETCH = 4.0
"""Patches that cover more than this many times more or fewer pixels in the other view are not compared."""


def ground_matches(
    images: tuple[Float32s, Float32s], cameras: tuple[Camera, Camera], plane: Float64s, reach_px: float
) -> tuple[Float64s, Float64s]:
    """(n, 2), (n, 2) pixels of both views that show the same places of the ground.

    Parameters
    ----------
    images, cameras : (h, w) float32 grey images of both views, and their cameras, known approximately.
    plane : (4,) ground plane.
    reach_px : largest distance of patches from the positions predicted by cameras and ground, pixels.
    """
    camera1, camera2 = cameras
    if any(plane[:3] @ camera.C + plane[3] <= 0 for camera in cameras):
        return np.zeros((0, 2)), np.zeros((0, 2))
    patches = below_horizon(camera1, plane[:3], _PATCHES)
    results = np.full((len(patches), 4), np.nan)
    H = ground_homography(camera1, camera2, plane)
    _search(*images, patches, H, int(np.ceil(reach_px)), results)
    best = results[:, 2]
    second = results[:, 3]
    # patches that were not searched have nan, which compares as False
    with np.errstate(invalid="ignore"):
        clear = (best >= _LEAST_CORRELATION) & (best >= second + _LEAST_LEAD)
    return patches[clear], results[clear, :2]


@kernel
def _search(image1: Float32s, image2: Float32s, patches: Float64s, H: Float64s, reach: int, results: Float64s) -> None:
    """Write for each patch its position in image 2 (2 numbers), its correlation there, and that at the best other place."""
    h1, w1 = image1.shape
    h2, w2 = image2.shape
    side = 2 * _RADIUS + 1
    u = np.empty(side * side)
    v = np.empty(side * side)
    patch = np.empty(side * side)
    scores = np.empty((2 * reach + 1, 2 * reach + 1))
    for k in range(len(patches)):
        # 1. Predict the patch's place; leave it out if it is not wholly in view, distorted too much, or flat.
        x = int(patches[k, 0])
        y = int(patches[k, 1])
        if x < _RADIUS or y < _RADIUS or x >= w1 - _RADIUS or y >= h1 - _RADIUS:
            continue
        if not _map_patch(image1, x, y, H, u, v, patch):
            continue
        width = u.max() - u.min()
        height = v.max() - v.min()
        stretched = width * height > _MOST_STRETCH * side * side or width * height < side * side / _MOST_STRETCH
        inside = u.min() >= reach and v.min() >= reach and u.max() < w2 - 1 - reach and v.max() < h2 - 1 - reach
        if stretched or not inside or patch.var() < _LEAST_VARIANCE:
            continue

        # 2. Search around it, and add the shift found to the predicted position.
        _correlate(image2, u, v, patch, reach, scores)
        _best_place(scores, reach, results[k])
        z = H[2, 0] * x + H[2, 1] * y + H[2, 2]
        results[k, 0] += (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / z
        results[k, 1] += (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / z


@helper
def _map_patch(image1: Float32s, x: int, y: int, H: Float64s, u: Float64s, v: Float64s, patch: Float64s) -> bool:
    """Write where H maps the pixels around x, y (u, v), and their grey levels; False if some are behind the camera."""
    n = 0
    for j in range(y - _RADIUS, y + _RADIUS + 1):
        for i in range(x - _RADIUS, x + _RADIUS + 1):
            z = H[2, 0] * i + H[2, 1] * j + H[2, 2]
            if z <= 0:
                return False
            u[n] = (H[0, 0] * i + H[0, 1] * j + H[0, 2]) / z
            v[n] = (H[1, 0] * i + H[1, 1] * j + H[1, 2]) / z
            patch[n] = image1[j, i]
            n += 1
    return True


@helper
def _correlate(image2: Float32s, u: Float64s, v: Float64s, patch: Float64s, reach: int, scores: Float64s) -> None:
    """Correlation of a patch with image 2 at each shift from its predicted position."""
    n = len(patch)
    mean = patch.mean()
    variance = patch.var()
    for shift_y in range(-reach, reach + 1):
        for shift_x in range(-reach, reach + 1):
            # sums of image 2's grey levels, of their squares and of the products with the patch
            s2 = 0.0
            s22 = 0.0
            s12 = 0.0
            for m in range(n):
                # the shift is whole pixels, so the fractions for bilinear interpolation do not depend on it
                a = int(u[m])
                b = int(v[m])
                f = u[m] - a
                g = v[m] - b
                a += shift_x
                b += shift_y
                grey = (image2[b, a] * (1 - f) + image2[b, a + 1] * f) * (1 - g)
                grey += (image2[b + 1, a] * (1 - f) + image2[b + 1, a + 1] * f) * g
                s2 += grey
                s22 += grey * grey
                s12 += patch[m] * grey
            variance2 = max(s22 / n - (s2 / n) ** 2, 0.0)
            covariance = s12 / n - mean * s2 / n
            scale = np.sqrt((variance + _NOISE_VARIANCE) * (variance2 + _NOISE_VARIANCE))
            scores[shift_y + reach, shift_x + reach] = covariance / scale


@helper
def _best_place(scores: Float64s, reach: int, result: Float64s) -> None:
    """Write the best score's shift (2), by parabolas, that score, and the best one elsewhere; nothing if it is at the border."""
    size = 2 * reach + 1
    best = -1.0
    row = 0
    column = 0
    for r in range(size):
        for c in range(size):
            if scores[r, c] > best:
                best = scores[r, c]
                row = r
                column = c
    # a best score at the border is the flank of one out of reach
    if row == 0 or column == 0 or row == size - 1 or column == size - 1:
        return
    second = -1.0
    for r in range(size):
        for c in range(size):
            if max(abs(r - row), abs(c - column)) > _SAME_PLACE_PX:
                second = max(second, scores[r, c])
    # vertices of the parabolas through the best score and its neighbours
    curvature_x = scores[row, column - 1] - 2 * best + scores[row, column + 1]
    curvature_y = scores[row - 1, column] - 2 * best + scores[row + 1, column]
    if curvature_x < 0 and curvature_y < 0:
        result[0] = column - reach + 0.5 * (scores[row, column - 1] - scores[row, column + 1]) / curvature_x
        result[1] = row - reach + 0.5 * (scores[row - 1, column] - scores[row + 1, column]) / curvature_y
        result[2] = best
        result[3] = second

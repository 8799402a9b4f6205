"""Standard deviation of a depth: the expectation of its noise model, corrected by the errors that are observed.

Matching errors follow texture, shading and slant, unlike pixel noise.  Two distances, divided by the expected ones, reveal them:

- along this view's ray, between the surfaces of this view and an agreeing one, expected from both models.  (Undivided, a view
  with fine depth would seem as wrong as one with coarse depth from which it differs);
- between the surrounding pixels and the plane through this one, expected from this view's model.

Each ratio estimates the factor by which the model is wrong, itself uncertain by a factor: their logarithms are averaged.  Weights
are from a regression of errors on demo yards of 320 to 1280 pixels, nearly the same for one agreeing view as for six, and from
scene to scene.  No scale is fitted.

Any two of n + 1 views share one of the n pairs behind each depth, and with it errors that their difference does not show.  If all
errors came from pairs, they would correlate by 1 / (n + 1), and the variance would be 1 + 1 / n times the observed one.

The error along a ray depends on the angle between ray and surface: it is converted to the error along the surface's normal, and
that to the error along another camera's ray: of the cameras that agree on the point, the nearest.
"""

from __future__ import annotations

import numpy as np

from ..core.jit import kernel
from ..types import Camera, DepthMap, Float32s, Float64s, Int64s, Uint8s
from .visibility import ITSELF, CrossCheck

_MODEL_WEIGHT = 0.2
"""Weight of the noise model in a depth's sigma; that of the views is the square root of the number that agree."""

_ROUGHNESS_WEIGHT = 1.5
"""Weight of the surrounding pixels."""

_SHARED_ERROR = 0.5
"""Share of all errors that comes from shared pairs (see above; fitted on the demo's yards, apron and stadium)."""

_MEAN_LOG_NORMAL = -0.635
"""Mean logarithm of the absolute value of a standard normal variable."""

_LEAST_ROUGHNESS = 0.05
"""Surroundings nearer to the plane than this multiple of the expected distance were put on it, and show no errors."""

_NEIGHBOUR_PX = 2
"""Distance of the surrounding pixels, in images of `_NOMINAL_SIDE`: nearer ones were matched on nearly the same patch."""

_NOMINAL_SIDE = 768
"""Long side, in pixels, of the images to which `_NEIGHBOUR_PX` applies; it is scaled for larger ones."""

_MOST_ROUGHNESS = 0.02
"""Upper limit of distances from the plane, as a share of the depth: larger ones are of other surfaces, and are clipped."""

_LEAST_COSINE = 0.05
"""Lower limit of the cosine between ray and normal: grazing rays would make errors infinite."""


def depth_variance(depth: DepthMap, check: CrossCheck, y: Int64s, x: Int64s) -> Float64s:
    """(n,) squared standard deviation of depths along the optical axis, world lengths.

    Parameters
    ----------
    depth, check : depth map of a view, and its cross-check against the others.
    y, x : (n,) rows and columns of pixels that have a depth.
    """
    sigma = depth.sigma[y, x].astype(np.float64)
    views = check.agreeing[y, x].astype(np.float64)

    # 1. What the surrounding pixels show: their mean distance from the plane, in sigmas.
    distance = _NEIGHBOUR_PX * max(1, round(max(depth.depth.shape) / _NOMINAL_SIDE))
    roughness = _roughness(depth.depth, depth.slope_x, depth.slope_y, y, x, distance) * depth.depth[y, x] / sigma
    roughness_weight = np.where(roughness > _LEAST_ROUGHNESS, _ROUGHNESS_WEIGHT, 0.0)

    # 2. What the other views show: the mean log of their distances in sigmas, less that of a normal variable.
    log_ratio = check.log_gap_sum[y, x] / np.maximum(views, 1.0) - np.where(views > 0, _MEAN_LOG_NORMAL, 0.0)

    # 3. Weighted geometric mean of these and of the model, whose logarithm is 0.
    weighted_logs = np.sqrt(views) * log_ratio + roughness_weight * np.log(np.maximum(roughness, _LEAST_ROUGHNESS))
    weight_sum = _MODEL_WEIGHT + np.sqrt(views) + roughness_weight
    observed_sigma = sigma * np.exp(weighted_logs / weight_sum)
    return np.asarray(observed_sigma**2 * (1.0 + _SHARED_ERROR / np.maximum(views, 1.0)), dtype=np.float64)


def along_nearest_rays(
    variance: Float64s, camera: Camera, others: Float64s, nearest: Uint8s, points: Float64s, normals: Float64s
) -> Float64s:
    """(n,) squared standard deviations along the ray of each point's nearest camera, from those along this view's optical axis.

    Parameters
    ----------
    variance, points, normals : (n,), (n, 3) and (n, 3), for points of a view's pixels.
    camera : the view's camera.
    others : (k, 3) centres of the views that it was compared with.
    nearest : (n,) index of the nearest camera in `others`, or `ITSELF` for the view.
    """
    centres = np.concatenate([others, camera.C[None]])
    to_nearest = centres[np.where(nearest == ITSELF, len(others), nearest)] - points
    to_own = camera.C - points
    depth = (points - camera.C) @ camera.R[2]
    # A change of depth moves the point along its own ray, and its surface along the normal by `normal_share` of the change; the
    # nearest camera's ray meets the moved surface 1 / cosine of that further on.
    normal_share = np.abs(np.sum(to_own * normals, axis=1)) / depth
    cosine = np.abs(np.sum(to_nearest * normals, axis=1)) / np.linalg.norm(to_nearest, axis=1)
    return np.asarray(variance * (normal_share / np.maximum(cosine, _LEAST_COSINE)) ** 2, dtype=np.float64)


@kernel
def _roughness(depth: Float32s, slope_x: Float32s, slope_y: Float32s, y: Int64s, x: Int64s, distance: int) -> Float32s:
    """(n,) mean distance of the eight pixels around one from its plane, as a share of its depth; 0 where none has a depth."""
    h, w = depth.shape
    roughness = np.zeros(len(y), np.float32)
    for n in range(len(y)):
        centre = depth[y[n], x[n]]
        total = 0.0
        count = 0
        for j in range(-distance, distance + 1, distance):
            for i in range(-distance, distance + 1, distance):
                row = y[n] + j
                column = x[n] + i
                if (i == 0 and j == 0) or not (0 <= row < h and 0 <= column < w) or np.isnan(depth[row, column]):
                    continue
                # the plane is linear in inverse depth
                expected = 1.0 / centre + slope_x[y[n], x[n]] * i + slope_y[y[n], x[n]] * j
                total += min(abs(centre / depth[row, column] - centre * expected), _MOST_ROUGHNESS)
                count += 1
        roughness[n] = total / count if count else 0.0
    return roughness

"""What two known cameras both see, predicted without matches: where the scene lies in both images, and how far to search.

A pair whose cameras are known needs no matches to be rectified.  The net that makes both images congruent, the crop and the range
of disparities follow from points of the scene's likely surface and of its nearest and farthest ends, projected into both images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.cameras import backproject, project, rays
from ..types import Bools, Camera, Float64s, Int64s, Scene

_GRID_POINTS = 24
"""Points across the wider side of an image."""
_STEPS = 32
"""Depths tried along each ray, evenly spaced in inverse depth."""
_NEAREST, _FARTHEST = 0.5, 2.5
"""Without a box of the scene, its assumed range of depths, in units of the depth at which the optical axes meet."""
_PARALLEL_BASELINES = 8.0
"""Assumed depth of the scene, in baselines, if the optical axes do not meet."""
_LEAST_DEPTH_SHARE = 0.02
"""Smallest depth of the scene, as a share of the diagonal of its box."""
_NEAREST_SHARE, _FARTHEST_SHARE = 0.3, 1.05
"""Nearest and farthest depth of the scene on a ray that meets the ground, as shares of the ground's depth."""
_FEWEST_POINTS = 12
"""Fewest points that both cameras see for a prediction: fewer define no net."""


@dataclass(frozen=True)
class Prediction:
    """What both cameras would see."""

    x1: Float64s
    x2: Float64s
    """(n, 2) pixels of images 1 and 2: points of the likely surface."""
    ends1: Float64s
    ends2: Float64s
    """(m, 2) pixels of images 1 and 2: the nearest and the farthest point on each ray that both show."""


def predict(camera1: Camera, camera2: Camera, scene: Scene | None = None) -> Prediction | None:
    """Points that two cameras of one world see if the scene is where it is expected; None if they have too few in common.

    Without a box of the scene, its distance is estimated from the optical axes.
    """
    from1 = _shared_points(camera1, camera2, scene)
    from2 = _shared_points(camera2, camera1, scene)
    if len(from1[0]) + len(from2[0]) < _FEWEST_POINTS:
        return None
    return Prediction(*(np.concatenate([from1[i], from2[j]]) for i, j in ((0, 1), (1, 0), (2, 3), (3, 2))))


def ground_in_both(camera1: Camera, camera2: Camera, ground: Float64s) -> tuple[Float64s, Float64s]:
    """(n, 2), (n, 2) pixels of both cameras that show the same places of the ground plane (4,)."""
    x1, x2 = _shared_ground(camera1, camera2, ground)
    y2, y1 = _shared_ground(camera2, camera1, ground)
    return np.concatenate([x1, y1]), np.concatenate([x2, y2])


def _shared_ground(camera: Camera, other: Camera, ground: Float64s) -> tuple[Float64s, Float64s]:
    pixels = _grid(camera)
    depth = _ground_depth(camera, pixels, ground)
    pixels, depth = pixels[np.isfinite(depth)], depth[np.isfinite(depth)]
    projected, other_depth = project(other, backproject(camera, pixels, depth))
    inside = (other_depth > 0) & _inside(projected, other)
    return pixels[inside], projected[inside]


def _inside(pixels: Float64s, camera: Camera) -> Bools:
    return np.asarray((pixels > -0.5).all(axis=1) & (pixels < [camera.width - 0.5, camera.height - 0.5]).all(axis=1))


def _shared_points(camera: Camera, other: Camera, scene: Scene | None) -> tuple[Float64s, Float64s, Float64s, Float64s]:
    """Pixels in both cameras of the likely surface, and of the nearest and farthest points that both see."""
    pixels = _grid(camera)
    near, far = _depth_range(camera, other, pixels, scene)
    usable = far > near
    pixels, near, far = pixels[usable], near[usable], far[usable]
    n = len(pixels)
    inverse = 1 / far + np.linspace(0, 1, _STEPS)[:, None] * (1 / near - 1 / far)  # from far to near
    depth = 1 / inverse
    projected, other_depth = project(other, backproject(camera, np.tile(pixels, (_STEPS, 1)), depth.ravel()))
    inside = (other_depth > 0) & _inside(projected, other)
    inside, projected = inside.reshape(_STEPS, n), projected.reshape(_STEPS, n, 2)
    shared = inside.any(axis=0)
    farthest, nearest = inside.argmax(axis=0), _STEPS - 1 - inside[::-1].argmax(axis=0)
    columns = np.arange(n)
    likely = _likely_step(camera, pixels, inverse, scene)
    likely = np.clip(likely, farthest, nearest)
    likely_shown = shared & inside[likely, columns]
    ends = np.concatenate([pixels[shared], pixels[shared]])
    partners = np.concatenate([projected[farthest, columns][shared], projected[nearest, columns][shared]])
    return pixels[likely_shown], projected[likely, columns][likely_shown], ends, partners


def _grid(camera: Camera) -> Float64s:
    step = max(camera.width, camera.height) / _GRID_POINTS
    x, y = np.arange(step / 2, camera.width, step) - 0.5, np.arange(step / 2, camera.height, step) - 0.5
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _depth_range(camera: Camera, other: Camera, pixels: Float64s, scene: Scene | None) -> tuple[Float64s, Float64s]:
    """Nearest and farthest depth (n,) of the scene on the ray of each pixel; far <= near where the ray misses it."""
    direction = rays(camera, pixels).T
    if scene is None or scene.box is None:
        distance = axes_meet_at(camera, other)
        near, far = np.full(len(pixels), _NEAREST * distance), np.full(len(pixels), _FARTHEST * distance)
    else:
        with np.errstate(divide="ignore", invalid="ignore"):
            to_low, to_high = (scene.box[0] - camera.C) / direction, (scene.box[1] - camera.C) / direction
        least_depth = _LEAST_DEPTH_SHARE * float(np.linalg.norm(scene.box[1] - scene.box[0]))
        near = np.maximum(np.nanmax(np.minimum(to_low, to_high), axis=1), least_depth)
        far = np.nanmin(np.maximum(to_low, to_high), axis=1)
    if scene is not None and scene.ground is not None:
        ground_depth = _ground_depth(camera, pixels, scene.ground)
        meets_ground = np.isfinite(ground_depth)
        near[meets_ground] = np.minimum(near[meets_ground], _NEAREST_SHARE * ground_depth[meets_ground])
        far[meets_ground] = np.minimum(far[meets_ground], _FARTHEST_SHARE * ground_depth[meets_ground])
    return near, far


def _ground_depth(camera: Camera, pixels: Float64s, ground: Float64s) -> Float64s:
    """(n,) depth at which the ray of each pixel meets the ground; nan where it looks above the horizon."""
    with np.errstate(divide="ignore"):
        depth = -(ground[:3] @ camera.C + ground[3]) / (ground[:3] @ rays(camera, pixels))
    return np.where(depth > 0, depth, np.nan)


def _likely_step(camera: Camera, pixels: Float64s, inverse: Float64s, scene: Scene | None) -> Int64s:
    """Index of the inverse depth (steps, n) of each pixel that is nearest to the likely surface: the ground, else the middle."""
    middle = np.full(len(pixels), _STEPS // 2)
    if scene is None or scene.ground is None:
        return middle
    depth = _ground_depth(camera, pixels, scene.ground)
    step = np.abs(inverse - 1 / depth).argmin(axis=0)
    return np.where(1 / depth > inverse[0], step, middle)


def axes_meet_at(camera: Camera, other: Camera) -> float:
    """Depth in `camera` at which the optical axes are nearest to each other; `_PARALLEL_BASELINES` if that is not in front."""
    baseline = other.C - camera.C
    a, b = camera.R[2], other.R[2]
    cosine = float(a @ b)
    if abs(cosine) < np.cos(np.radians(2.0)):
        depth = (baseline @ a - cosine * (baseline @ b)) / (1 - cosine**2)
        other_depth = (cosine * (baseline @ a) - baseline @ b) / (1 - cosine**2)
        if depth > 0 and other_depth > 0:
            return float(depth)
    return _PARALLEL_BASELINES * float(np.linalg.norm(baseline))

"""What two known cameras both see, predicted without matches: where the scene lies in both images, and how far to search.

A pair whose cameras are known needs no matches to be rectified.  The net that makes both images congruent, the crop and the range
of disparities follow from points of the scene's likely surface and of its nearest and farthest ends, projected into both images.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..core.cameras import backproject, project, rays
from ..types import Bools, Camera, Float64s, Int64s, Scene

_GRID_POINTS = 24
"""Points across the wider side of an image."""
_STEPS = 32
"""Depths tried along each ray, evenly spaced in inverse depth."""
_NEAREST = 0.5
"""Without a box of the scene, its assumed nearest depth, in units of the depth at which the optical axes meet."""
_FARTHEST = 2.5
"""Its assumed farthest depth, in the same unit; a wider range costs time and finds more look-alikes."""
_PARALLEL_DEG = 2.0
"""Optical axes at a smaller angle count as parallel: where they meet is uncertain."""
_PARALLEL_BASELINES = 8.0
"""Assumed depth of the scene, in baselines, if the optical axes do not meet."""
_LEAST_DEPTH_SHARE = 0.02
"""Smallest depth of the scene, as a share of the diagonal of its box."""
_NEAREST_SHARE = 0.3
"""Nearest depth of the scene on a ray that meets the ground, as a share of the ground's depth."""
_FARTHEST_SHARE = 1.05
"""Farthest depth on such a ray, as a share of the ground's: a little below it, as the ground is not quite a plane."""
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
    if len(from1.own) + len(from2.own) < _FEWEST_POINTS:
        return None
    # what is "own" in one image is the "other" in the second
    return Prediction(
        x1=np.concatenate([from1.own, from2.other]),
        x2=np.concatenate([from1.other, from2.own]),
        ends1=np.concatenate([from1.own_ends, from2.other_ends]),
        ends2=np.concatenate([from1.other_ends, from2.own_ends]),
    )


def ground_in_both(camera1: Camera, camera2: Camera, ground: Float64s) -> tuple[Float64s, Float64s]:
    """(n, 2), (n, 2) pixels of both cameras that show the same places of the ground plane (4,)."""
    x1, x2 = _shared_ground(camera1, camera2, ground)
    y2, y1 = _shared_ground(camera2, camera1, ground)
    return np.concatenate([x1, y1]), np.concatenate([x2, y2])


def _shared_ground(camera: Camera, other: Camera, ground: Float64s) -> tuple[Float64s, Float64s]:
    """Pixels (n, 2) of a grid over `camera` that show the ground, and where the other camera shows the same places."""
    pixels = _grid(camera)
    depth = _ground_depth(camera, pixels, ground)
    shows_ground = np.isfinite(depth)
    pixels = pixels[shows_ground]
    depth = depth[shows_ground]
    projected, other_depth = project(other, backproject(camera, pixels, depth))
    inside = (other_depth > 0) & _inside(projected, other)
    return pixels[inside], projected[inside]


def _inside(pixels: Float64s, camera: Camera) -> Bools:
    """(n,) bool: which pixels (n, 2) lie in the camera's image."""
    low = -0.5
    high = [camera.width - 0.5, camera.height - 0.5]
    return np.asarray((pixels > low).all(axis=1) & (pixels < high).all(axis=1))


class _SharedPoints(NamedTuple):
    """Points on the rays of one camera that another one sees, too: pixels of both."""

    own: Float64s
    other: Float64s
    """(n, 2) points of the likely surface."""
    own_ends: Float64s
    other_ends: Float64s
    """(m, 2) the farthest point of each ray that both see, then the nearest of each."""


def _shared_points(camera: Camera, other: Camera, scene: Scene | None) -> _SharedPoints:
    """Points of the likely surface that both cameras see, and the nearest and farthest, on a grid of the rays of `camera`."""
    pixels = _grid(camera)
    near, far = _depth_range(camera, other, pixels, scene)
    usable = far > near
    pixels = pixels[usable]
    near = near[usable]
    far = far[usable]
    n = len(pixels)

    # 1. points (steps, n) along each ray, from far to near, and whether the other camera sees them
    inverse = 1 / far + np.linspace(0, 1, _STEPS)[:, None] * (1 / near - 1 / far)
    depth = 1 / inverse
    projected, other_depth = project(other, backproject(camera, np.tile(pixels, (_STEPS, 1)), depth.ravel()))
    inside = (other_depth > 0) & _inside(projected, other)
    inside = inside.reshape(_STEPS, n)
    projected = projected.reshape(_STEPS, n, 2)

    # 2. the first and the last step that it sees, and the one nearest to the likely surface between them
    shared = inside.any(axis=0)
    farthest = inside.argmax(axis=0)
    nearest = _STEPS - 1 - inside[::-1].argmax(axis=0)
    likely = np.clip(_likely_step(camera, pixels, inverse, scene), farthest, nearest)
    columns = np.arange(n)
    likely_shown = shared & inside[likely, columns]

    return _SharedPoints(
        own=pixels[likely_shown],
        other=projected[likely, columns][likely_shown],
        own_ends=np.concatenate([pixels[shared], pixels[shared]]),
        other_ends=np.concatenate([projected[farthest, columns][shared], projected[nearest, columns][shared]]),
    )


def _grid(camera: Camera) -> Float64s:
    """(n, 2) pixels of a square grid over the camera's image."""
    step = max(camera.width, camera.height) / _GRID_POINTS
    x = np.arange(step / 2, camera.width, step) - 0.5
    y = np.arange(step / 2, camera.height, step) - 0.5
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _depth_range(camera: Camera, other: Camera, pixels: Float64s, scene: Scene | None) -> tuple[Float64s, Float64s]:
    """Nearest and farthest depth (n,) of the scene on the ray of each pixel; far <= near where the ray misses it."""
    direction = rays(camera, pixels).T
    if scene is None or scene.box is None:
        distance = axes_meet_at(camera, other)
        near = np.full(len(pixels), _NEAREST * distance)
        far = np.full(len(pixels), _FARTHEST * distance)
    else:
        # where the ray enters and leaves the slab between each pair of opposite sides; inf or nan if it is parallel to them
        with np.errstate(divide="ignore", invalid="ignore"):
            to_low = (scene.box[0] - camera.C) / direction
            to_high = (scene.box[1] - camera.C) / direction
        least_depth = _LEAST_DEPTH_SHARE * float(np.linalg.norm(scene.box[1] - scene.box[0]))
        near = np.maximum(np.nanmax(np.minimum(to_low, to_high), axis=1), least_depth)
        far = np.nanmin(np.maximum(to_low, to_high), axis=1)
    if scene is not None and scene.ground is not None:
        ground_depth = _ground_depth(camera, pixels, scene.ground)
        meets_ground = np.isfinite(ground_depth)
        ground_depth = ground_depth[meets_ground]
        near[meets_ground] = np.minimum(near[meets_ground], _NEAREST_SHARE * ground_depth)
        far[meets_ground] = np.minimum(far[meets_ground], _FARTHEST_SHARE * ground_depth)
    return near, far


def _ground_depth(camera: Camera, pixels: Float64s, ground: Float64s) -> Float64s:
    """(n,) depth at which the ray of each pixel meets the ground; nan where it looks above the horizon."""
    with np.errstate(divide="ignore"):
        height = ground[:3] @ camera.C + ground[3]
        depth = -height / (ground[:3] @ rays(camera, pixels))
    return np.where(depth > 0, depth, np.nan)


def _likely_step(camera: Camera, pixels: Float64s, inverse: Float64s, scene: Scene | None) -> Int64s:
    """Index of the inverse depth (steps, n) of each pixel that is nearest to the likely surface: the ground, else the middle."""
    middle = np.full(len(pixels), _STEPS // 2)
    if scene is None or scene.ground is None:
        return middle
    depth = _ground_depth(camera, pixels, scene.ground)
    step = np.abs(inverse - 1 / depth).argmin(axis=0)
    meets_ground_in_range = 1 / depth > inverse[0]  # False for nan, above the horizon
    return np.where(meets_ground_in_range, step, middle)


def axes_meet_at(camera: Camera, other: Camera) -> float:
    """Depth in `camera` at which the optical axes are nearest to each other; `_PARALLEL_BASELINES` if that is not in front."""
    baseline = other.C - camera.C
    a = camera.R[2]
    b = other.R[2]
    cosine = float(a @ b)
    if abs(cosine) < np.cos(np.radians(_PARALLEL_DEG)):
        # depths at which the line between both axes is perpendicular to both
        depth = (baseline @ a - cosine * (baseline @ b)) / (1 - cosine**2)
        other_depth = (cosine * (baseline @ a) - baseline @ b) / (1 - cosine**2)
        if depth > 0 and other_depth > 0:
            return float(depth)
    return _PARALLEL_BASELINES * float(np.linalg.norm(baseline))

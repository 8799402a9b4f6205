"""Cameras and cloud as a COLMAP model in text form.

COLMAP's pixels have their origin in the corner of the image, ours in the centre of the first pixel: principal points move by half
a pixel.  Its poses are X_camera = R X + t, as quaternion (w first) and t.

References
----------
https://colmap.github.io/format.html
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from ..types import Camera, Cloud

NO_ERROR = -1
"""COLMAP's mark for a point whose reprojection error has not been computed."""


def colmap_files(cameras: Mapping[str, Camera], cloud: Cloud, most_points: int = 200_000) -> dict[str, bytes]:
    """cameras.txt, images.txt and points3D.txt of cameras that share a world; images are called <camera>.png.

    The cloud is thinned evenly to `most_points`; its points name no image.
    """
    numbered = list(enumerate(cameras.items(), start=1))
    files = {
        "cameras.txt": ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]", *(_intrinsics(n, camera) for n, (_, camera) in numbered)],
        "images.txt": ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of X Y POINT3D_ID"],
        "points3D.txt": ["# POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID POINT2D_IDX)", *_points(cloud, most_points)],
    }
    for n, (name, camera) in numbered:
        files["images.txt"] += [_pose(n, name, camera), ""]
    return {name: ("\n".join(lines) + "\n").encode() for name, lines in files.items()}


def _intrinsics(number: int, camera: Camera) -> str:
    """A pinhole; where distortion was found to be left in the frame, with that."""
    K = camera.K
    values = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5]
    model = "PINHOLE"
    if any(camera.radial):
        model, values = "OPENCV", [*values, *camera.radial, 0.0, 0.0]
    return f"{number} {model} {camera.width} {camera.height} {_numbers(values)}"


def _pose(number: int, name: str, camera: Camera) -> str:
    x, y, z, w = Rotation.from_matrix(camera.R).as_quat(canonical=True)
    return f"{number} {_numbers([w, x, y, z, *(-camera.R @ camera.C)])} {number} {name}.png"


def _points(cloud: Cloud, most: int) -> list[str]:
    count = len(cloud.points)
    kept = np.arange(count) if count <= most else np.arange(most) * count // most
    rows = zip(cloud.points[kept].astype(np.float64).tolist(), cloud.colors[kept].tolist(), strict=True)
    return [f"{n} {x:.8g} {y:.8g} {z:.8g} {r} {g} {b} {NO_ERROR}" for n, ((x, y, z), (r, g, b)) in enumerate(rows, start=1)]


def _numbers(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)

"""Control points: places of the scene with known coordinates, pointed at in the captures of two or more cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from ..core.cameras import camera_id
from ..core.lenses import lens_rays
from ..core.residual_distortion import without_distortion
from ..types import Camera, Float64s, Survey, View
from .alignment import Landmark
from .tracks import Tracks
from .triangulation import triangulate


def control_landmarks(
    cameras: Mapping[int, Camera], names: Sequence[str], views: Sequence[View], survey: Survey
) -> list[Landmark]:
    """The control points that at least two of the cameras see.

    Parameters
    ----------
    cameras : solved cameras by number.
    names, views : of all cameras, by number.
    survey : positions of the points, and the pixels at which cameras see them.
    """
    numbers: dict[str, list[int]] = {}
    for view, name in enumerate(names):
        if view in cameras:
            numbers.setdefault(camera_id(name, views[view]), []).append(view)
    rows = []
    for point, camera, x, y in survey.observations:
        mine = numbers.get(survey.cameras[int(camera)], [])
        for view in mine:
            u, v = _in_frame(np.array([[x, y]]), views[view], cameras[view])[0]
            if (len(mine) == 1 and np.isfinite(u)) or (0 <= u < views[view].width and 0 <= v < views[view].height):
                rows.append((int(point), view, u, v))
                break
    rows.sort(key=lambda row: row[:2])
    if not rows:
        return []
    tracks = Tracks(
        track=np.array([row[0] for row in rows], np.int32),
        view=np.array([row[1] for row in rows], np.int32),
        xy=np.array([row[2:] for row in rows], np.float64),
        count=len(survey.points),
    )
    X = triangulate(cameras, tracks, np.ones(len(rows), bool), 1.0)
    seen = np.flatnonzero(np.isfinite(X[:, 0]))
    return [Landmark(f"control point {k + 1}", X[k], survey.points[k]) for k in seen.tolist()]


def _in_frame(x: Float64s, view: View, camera: Camera) -> Float64s:
    """(n, 2) pixels of the capture, moved to where a pinhole would have them in the frame."""
    if view.lens is not None:
        seen = lens_rays(view.lens, x)
        rays = (seen if view.lens.turn is None else seen @ view.lens.turn.T) @ camera.K.T
        return np.asarray(rays[:, :2] / np.where(rays[:, 2:] > 0, rays[:, 2:], np.nan), dtype=np.float64)
    scale = np.array([view.width / (view.captured_width or view.width), view.height / (view.captured_height or view.height)])
    x = (x + 0.5) * scale - 0.5
    if np.any(view.distortion):
        x = np.asarray(cv2.undistortPoints(x[:, None], camera.K, view.distortion, P=camera.K)[:, 0], dtype=np.float64)
    return without_distortion(camera, x)

"""Methods that are in no table of the stages, as a user would write them beside a site file."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from tests.helpers.synthetic_site import small_yard
from wbflow_stages.core.cameras import backproject, project
from wbflow_stages.rectification.method import Homographies, MatchedPair
from wbflow_stages.rectification.planar import hartley
from wbflow_stages.stereo.matcher import DenseMatches, RectifiedPair
from wbflow_stages.types import Features, Frame, Matches, View


def at_its_word(pair: RectifiedPair, *, distance_px: float = 20.0) -> DenseMatches:
    """Dense matcher: one disparity everywhere."""
    flat = np.full(pair.left.shape, distance_px, dtype=np.float32)
    return DenseMatches(flat, flat, np.ones_like(flat), np.ones_like(flat))


def half_believed(pair: RectifiedPair) -> DenseMatches:
    """Dense matcher: no confidence in rows 0 to 89 of the left view, full confidence elsewhere."""
    flat, sure = np.full(pair.left.shape, 20, dtype=np.float32), np.ones(pair.left.shape, dtype=np.float32)
    doubtful = sure.copy()
    doubtful[:90] = 0
    return DenseMatches(flat, flat, doubtful, sure)


def shifted(pair: MatchedPair, *, shift_px: float = 5.0) -> Homographies:
    """Rectification: Hartley's, with the left image moved along x."""
    H1, H2 = hartley(pair)
    return Homographies(np.array([[1.0, 0, shift_px], [0, 1, 0], [0, 0, 1]]) @ H1, H2)


@cache
def undistorted_frames() -> tuple[Frame, ...]:
    """The undistorted frames of the cameras of `small_yard`."""
    found = []
    for camera in small_yard().cameras:
        image = np.median(np.stack(camera.captures), axis=0).astype(np.uint8)
        assert camera.lens.K is not None
        image = np.asarray(cv2.undistort(image, camera.lens.K, camera.lens.distortion), dtype=np.uint8)
        height, width = camera.depth.shape
        found.append(Frame(image, np.ones((height, width), dtype=bool), View(width, height, camera.camera.K)))
    return tuple(found)


def grid_points(left: Features, right: Features, left_frame: Frame, right_frame: Frame, *, step_px: int = 6) -> Matches:
    """Sparse matcher: true matches of a grid of points in the left frame (of `undistorted_frames`); it uses no keypoints."""
    one, two = (
        next(c for c, known in zip(small_yard().cameras, undistorted_frames(), strict=True) if known is frame)
        for frame in (left_frame, right_frame)
    )
    height, width = one.depth.shape
    y, x = np.mgrid[step_px // 2 : height : step_px, step_px // 2 : width : step_px].reshape(2, -1)
    x, y = x[one.depth[y, x] > 0], y[one.depth[y, x] > 0]
    x1 = np.column_stack([x, y]).astype(np.float64)
    x2, z2 = project(two.camera, backproject(one.camera, x1, one.depth[y, x].astype(np.float64)))
    inside = (z2 > 0) & (x2 > 0).all(axis=1) & (x2 < [width - 1, height - 1]).all(axis=1)
    x1, x2, z2 = x1[inside], x2[inside], z2[inside]
    column, row = np.rint(x2).astype(int).T
    seen = np.abs(two.depth[row, column] - z2) < 0.01 * z2
    p = np.full(int(seen.sum()), 0.9, np.float32)
    return Matches(x1[seen], x2[seen], None, None, p, None, left.view, right.view)

"""Methods that stand in no table of the stages: what a person would write beside a site file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from wbflow_stages.core.cameras import backproject, project
from wbflow_stages.rectification.hartley import hartley
from wbflow_stages.rectification.method import Homographies, MatchedPair
from wbflow_stages.stereo.matcher import DenseMatches, RectifiedPair
from wbflow_stages.types import Camera, Features, Frame, Matches


def at_its_word(pair: RectifiedPair, *, distance_px: float = 20.0) -> DenseMatches:
    """Dense: everything is at one disparity."""
    flat = np.full(pair.left.shape, distance_px, dtype=np.float32)
    return DenseMatches(flat, flat, np.ones_like(flat), np.ones_like(flat))


def half_believed(pair: RectifiedPair) -> DenseMatches:
    """Dense: believes its left view below row 90 only."""
    flat, sure = np.full(pair.left.shape, 20, dtype=np.float32), np.ones(pair.left.shape, dtype=np.float32)
    doubtful = sure.copy()
    doubtful[:90] = 0
    return DenseMatches(flat, flat, doubtful, sure)


def shifted(pair: MatchedPair, *, shift_px: float = 5.0) -> Homographies:
    """Rectification: Hartley's, moved."""
    H1, H2 = hartley(pair)
    return Homographies(np.array([[1.0, 0, shift_px], [0, 1, 0], [0, 0, 1]]) @ H1, H2)


def grid_points(
    left: Features, right: Features, left_frame: Frame, right_frame: Frame, *, truth: str, step_px: int = 8
) -> Matches:
    """Sparse: points of a grid of the left frame and where exact cameras and depths (files in the folder `truth`) say they lie in
    the right one; no keypoints.  Which cameras took the two frames is told by their grey levels.
    """
    folder = Path(truth)
    names = {json.dumps(np.load(file).mean().item()): file.stem for file in folder.glob("*.image.npy")}
    one, two = (names[json.dumps(frame.image.mean().item())] for frame in (left_frame, right_frame))
    cameras = {name: _camera(folder / f"{name}.json") for name in (one, two)}
    depth = np.load(folder / f"{one}.depth.npy")
    height, width = depth.shape
    y, x = np.mgrid[step_px // 2 : height : step_px, step_px // 2 : width : step_px].reshape(2, -1)
    x1 = np.column_stack([x, y]).astype(np.float64)
    X = backproject(cameras[one], x1, depth[y, x].astype(np.float64))
    x2, z2 = project(cameras[two], X)
    seen = np.isfinite(x2).all(axis=1) & (z2 > 0) & (x2 > 0).all(axis=1) & (x2 < [width - 1, height - 1]).all(axis=1)
    other = np.load(folder / f"{two}.depth.npy")
    column, row = np.rint(x2[seen]).astype(int).T
    visible = np.flatnonzero(seen)[np.abs(other[row, column] - z2[seen]) < 0.02 * z2[seen]]
    p = np.full(len(visible), 0.9, np.float32)
    return Matches(x1[visible], x2[visible], None, None, p, None, left.view, right.view)


def _camera(file: Path) -> Camera:
    told = json.loads(file.read_text())
    return Camera(np.array(told["K"]), np.array(told["R"]), np.array(told["C"]), told["width"], told["height"])

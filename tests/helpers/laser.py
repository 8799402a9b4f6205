"""Photographs with true cameras and laser depth; the data is in shared/data beside the project, or at WBFLOW_DATA."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from tests.helpers.images import read_image
from wbflow_stages.core.cameras import backproject, project, scaled_intrinsics
from wbflow_stages.types import Camera, Frame, View

FOUNTAIN = Path(os.environ.get("WBFLOW_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data") / "fountain"
_SHRINK = 4


@dataclass(frozen=True)
class Photograph:
    """A frame at a quarter of the photograph's width, its camera, and its depth map (h, w), 0 where unknown."""

    frame: Frame
    camera: Camera
    depth: np.ndarray


@cache
def photograph(number: int) -> Photograph:
    name = f"{number:04d}"
    c = json.loads((FOUNTAIN / "cameras.json").read_text())[f"{name}.jpg"]
    pixels = read_image(FOUNTAIN / "images" / f"{name}.jpg")[..., ::-1]
    small = cv2.resize(np.ascontiguousarray(pixels), None, fx=1 / _SHRINK, fy=1 / _SHRINK, interpolation=cv2.INTER_AREA)
    height, width = small.shape[:2]
    K = scaled_intrinsics(np.array(c["K"]), 1 / _SHRINK, 1 / _SHRINK)
    z = np.load(FOUNTAIN / "depth" / f"{name}.npz")["depth"].astype(np.float32)
    four = np.stack([z[1 + a :: _SHRINK, 1 + b :: _SHRINK][:height, :width] for a in (0, 1) for b in (0, 1)])
    whole = (four.min(axis=0) > 0) & (np.ptp(four, axis=0) < 0.03 * four.max(axis=0))
    depth = np.where(whole, four.mean(axis=0), 0)
    frame = Frame(small.astype(np.uint8), np.ones((height, width), dtype=bool), View(width, height, K))
    return Photograph(frame, Camera(K, np.array(c["R"]), np.array(c["C"]), width, height), depth)


def laser_matches(left: Photograph, right: Photograph, step: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Exact correspondences (n, 2), (n, 2) of the points that both photographs see."""
    height, width = left.depth.shape
    y, x = np.mgrid[0:height:step, 0:width:step]
    z = left.depth[y, x]
    x1 = np.column_stack([x[z > 0], y[z > 0]]).astype(np.float64)
    x2, ahead = project(right.camera, backproject(left.camera, x1, z[z > 0].astype(np.float64)))
    column, row = np.rint(x2).astype(int).T
    inside = (ahead > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    x1, x2, ahead, column, row = x1[inside], x2[inside], ahead[inside], column[inside], row[inside]
    seen = np.abs(right.depth[row, column] - ahead) < 0.01 * ahead
    return x1[seen], x2[seen]

"""Exposure balance: one factor per camera and channel, so that a surface has one colour whoever looks at it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from ..types import Camera, DepthMap, Float32s, Float64s, Uint8s
from .depth import transfer

_STEP = 4


def thumbnail(image: Uint8s) -> Float32s:
    """(h / 4, w / 4, 3) float32: means over blocks, which pixel noise and small errors of depth don't reach."""
    h, w = image.shape[:2]
    return np.asarray(cv2.resize(image, (max(1, w // _STEP), max(1, h // _STEP)), interpolation=cv2.INTER_AREA), dtype=np.float32)


def exposure_gains(
    cameras: Mapping[str, Camera],
    depths: Mapping[str, DepthMap],
    thumbnails: Mapping[str, Float32s],
    neighbours: Mapping[str, Sequence[str]],
) -> dict[str, Float64s]:
    """(3,) factor for each camera; their geometric mean over the cameras is one.

    The ratio of two cameras is the median over pixels whose depths agree; the cameras' gains fit all ratios by least squares, a
    camera without ratios keeps one.
    """
    names = list(depths)
    rows, ratios, weights = [], [], []
    for i, name in enumerate(names):
        for other in neighbours[name]:
            ratio, count = _ratio(cameras[name], cameras[other], depths[name], depths[other], thumbnails[name], thumbnails[other])
            if count >= 50:
                row = np.zeros(len(names))
                row[i], row[names.index(other)] = 1.0, -1.0
                rows.append(row)
                ratios.append(ratio)
                weights.append(np.sqrt(min(count, 1000)))
    if not rows:
        return {name: np.ones(3) for name in names}
    w = np.array(weights)[:, None]
    hold = 0.1 * np.eye(len(names))  # ties each set of connected cameras to a mean gain of one
    right = np.vstack([-np.array(ratios) * w, np.zeros((len(names), 3))])
    log_gains = np.linalg.lstsq(np.vstack([np.array(rows) * w, hold]), right, rcond=None)[0]
    return dict(zip(names, np.exp(log_gains), strict=True))


def _ratio(
    camera: Camera, other: Camera, depth: DepthMap, other_depth: DepthMap, image: Float32s, other_image: Float32s
) -> tuple[Float64s, int]:
    """Median log ratio (3,) of the two cameras' colours over surfaces that both see, and over how many pixels."""
    z = depth.depth[2 :: 2 * _STEP, 2 :: 2 * _STEP]
    y, x = np.nonzero(np.isfinite(z))
    x_full, y_full = 2 * _STEP * x + 2.0, 2 * _STEP * y + 2.0
    M, b = transfer(camera, other)
    p = z[y, x].astype(np.float64)[:, None] * (np.column_stack([x_full, y_full, np.ones(len(x))]) @ M.T) + b
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    h, w = other_depth.depth.shape
    inside = (p[:, 2] > 0) & (u >= 0) & (v >= 0) & (u < w - 1) & (v < h - 1)
    u, v, there, x_full, y_full = u[inside], v[inside], p[inside, 2], x_full[inside], y_full[inside]
    seen = other_depth.depth[(v + 0.5).astype(int), (u + 0.5).astype(int)]
    agrees = np.abs(seen - there) < 0.01 * there
    ours, theirs = _at(image, x_full[agrees], y_full[agrees]), _at(other_image, u[agrees], v[agrees])
    usable = ((ours > 10) & (ours < 245) & (theirs > 10) & (theirs < 245)).all(axis=1)
    if usable.sum() < 50:
        return np.zeros(3), 0
    return np.median(np.log(ours[usable] / theirs[usable]), axis=0).astype(np.float64), int(usable.sum())


def _at(image: Float32s, x: Float64s, y: Float64s) -> Float32s:
    """(n, 3) pixels of a thumbnail at full-size positions."""
    h, w = image.shape[:2]
    rows = np.minimum((y + 0.5).astype(int) // _STEP, h - 1)
    columns = np.minimum((x + 0.5).astype(int) // _STEP, w - 1)
    return np.asarray(image[rows, columns])

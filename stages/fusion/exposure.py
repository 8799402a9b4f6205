"""Exposure balance: one factor per camera and channel, so that a surface has one colour whoever looks at it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..core.cameras import transfer
from ..types import Camera, Float32s, Float64s, Uint8s
from .subsampled import STEP, Subsampled


def exposure_gains(
    cameras: Mapping[str, Camera], small: Mapping[str, Subsampled], neighbours: Mapping[str, Sequence[str]]
) -> dict[str, Float64s]:
    """(3,) factor for each camera; their geometric mean over the cameras is one.

    The ratio of two cameras is the median over pixels whose depths agree; the cameras' gains fit all ratios by least squares, a
    camera without ratios keeps one.
    """
    names = list(small)
    rows, ratios, weights = [], [], []
    for i, name in enumerate(names):
        for other in neighbours[name]:
            ratio, count = _ratio(cameras[name], cameras[other], small[name], small[other])
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


def _ratio(camera: Camera, other: Camera, ours: Subsampled, theirs: Subsampled) -> tuple[Float64s, int]:
    """Median log ratio (3,) of the two cameras' colours over surfaces that both see, and over how many pixels."""
    pixels, z = ours.points(2)
    M, b = transfer(camera, other)
    p = z * (pixels @ M.T) + b
    with np.errstate(divide="ignore", invalid="ignore"):
        at = p[:, :2] / p[:, 2:]
    inside = (p[:, 2] > 0) & (at >= 0).all(axis=1) & (at < [other.width - 1, other.height - 1]).all(axis=1)
    pixels, at, there = pixels[inside], at[inside], p[inside, 2]
    agrees = np.abs(_at(theirs.depth, at) - there) < 0.01 * there
    one, two = (_at(colors, places[agrees]).astype(np.float64) for colors, places in ((ours.colors, pixels), (theirs.colors, at)))
    usable = ((one > 10) & (one < 245) & (two > 10) & (two < 245)).all(axis=1)
    if usable.sum() < 50:
        return np.zeros(3), 0
    return np.median(np.log(one[usable] / two[usable]), axis=0), int(usable.sum())


def _at(values: Uint8s | Float32s, places: Float64s) -> np.ndarray:
    """(n, ...) what a subsampled view holds at positions of the full size."""
    h, w = values.shape[:2]
    x, y = (places[:, :2].T + 0.5).astype(int) // STEP
    return np.asarray(values[np.minimum(y, h - 1), np.minimum(x, w - 1)])

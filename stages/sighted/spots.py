"""Bright spots in frames of a fixed camera that its background does not have: candidates for a lamp that is carried about.

The background of each pixel is the median of frames that are spread over the recording, and its noise their median absolute
deviation: what shines all the time is background, what flickers is noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..types import Float32s, Float64s, Uint8s

_LEAST_EXCESS = 25.0
"""Grey levels above the background, after smoothing, from which on a spot is a candidate."""
_SIGMAS = 6.0
"""Standard deviations of the pixel's noise, likewise."""
_LEAST_NOISE = 1.5
"""Least standard deviation of a pixel, grey levels: encoders hide noise."""
_MOST_SPOTS = 8
"""Most candidates of a frame: the brightest."""
_BLUR_SHARE = 0.001
_LEAST_BLUR_PX = 0.8
"""Standard deviation of the smoothing, as a share of the picture's larger side, but no less than the second in pixels."""
_APART_SHARE = 0.012
"""Distance between candidates, as a share of the larger side, at least."""
_WINDOW_SHARE = 0.04
"""Half the side of the window in which a spot's core is measured, likewise."""
_LEAST_SIGMA_PX = 0.15
"""Standard deviation in pixels of the centre of the sharpest spot."""
_SIGMA_SHARE = 0.2
"""Standard deviation of a spot's centre as a share of its radius: glare is uneven, and a housing hides a part."""
_GAIN_LEVELS = (16, 235)
"""Grey levels of the background between which pixels tell how a frame's exposure differs."""
_LEAST_GAIN_PIXELS = 500
"""Number of such pixels, at least."""
_MOST_GAIN = 2.0
"""Largest ratio of two exposures that is believed."""


@dataclass(frozen=True)
class Background:
    """What a fixed camera always sees."""

    level: Float32s
    """(h, w) float32 median of the brightest channel."""
    noise: Float32s
    """(h, w) float32 standard deviation."""

    @classmethod
    def of_levels(cls, levels: Sequence[Uint8s]) -> Background:
        """The background of frames (h, w) uint8, spread over a recording."""
        stack = np.stack(levels)
        middle = len(stack) // 2
        median = np.partition(stack, middle, axis=0)[middle]
        # of unsigned numbers: the smaller from the larger
        differences = np.maximum(stack, median) - np.minimum(stack, median)
        deviation = np.partition(differences, middle, axis=0)[middle]
        noise = np.maximum(1.4826 * deviation.astype(np.float32), np.float32(_LEAST_NOISE))
        # a flickering light also changes its surroundings; spots are smoothed, and so is what is known of their noise
        return cls(median.astype(np.float32), np.asarray(cv2.dilate(noise, np.ones((3, 3), np.uint8)), np.float32))


@dataclass(frozen=True)
class Spots:
    """Candidates of one frame, brightest first."""

    xy: Float64s
    """(n, 2) float64 centres, pixels."""
    excess: Float64s
    """(n,) float64 grey levels above the background at the brightest pixel."""
    flux: Float64s
    """(n,) float64 sum of these levels over the core."""
    radius: Float64s
    """(n,) float64 of the core, pixels: of its longer axis, if it is long."""

    @property
    def sigma_px(self) -> Float64s:
        """(n,) float64 standard deviation of a coordinate."""
        return np.asarray(np.hypot(_LEAST_SIGMA_PX, _SIGMA_SHARE * self.radius), np.float64)


def brightest_channel(image: Uint8s) -> Uint8s:
    """(h, w) uint8 of (h, w, 3): a coloured lamp is as bright as a white one."""
    first, second, third = cv2.split(image)
    return np.asarray(cv2.max(cv2.max(first, second), third), np.uint8)


def find_spots(level: Uint8s, background: Background) -> Spots:
    """The spots of a frame, (h, w) uint8 of its brightest channel."""
    side = max(level.shape)
    excess = level.astype(np.float32) / np.float32(_gain(level, background)) - background.level
    smooth = cv2.GaussianBlur(excess, (0, 0), max(_LEAST_BLUR_PX, _BLUR_SHARE * side))

    # 1. Maxima that are high enough, and higher than all around them.
    reach = 2 * round(_APART_SHARE * side / 2) + 1
    is_peak = smooth == cv2.dilate(smooth, np.ones((reach, reach), np.uint8))
    is_peak &= smooth > np.maximum(np.float32(_LEAST_EXCESS), np.float32(_SIGMAS) * background.noise)
    rows, columns = np.nonzero(is_peak)
    order = np.argsort(-smooth[rows, columns], kind="stable")[: 4 * _MOST_SPOTS]

    # 2. The core of each: where it has more than half of its peak.
    found: list[tuple[float, float, float, float, float]] = []
    for k in order.tolist():
        spot = _core(excess, int(rows[k]), int(columns[k]), round(_WINDOW_SHARE * side))
        # a bright core may be flat, and have several maxima
        if all(np.hypot(spot[0] - other[0], spot[1] - other[1]) > max(spot[4], other[4], 2.0) for other in found):
            found.append(spot)
        if len(found) == _MOST_SPOTS:
            break
    table = np.array(found, np.float64).reshape(-1, 5)
    return Spots(table[:, :2], table[:, 2], table[:, 3], table[:, 4])


def _gain(level: Uint8s, background: Background) -> float:
    """By how much a frame is exposed more than the background; a lamp before a camera makes it expose less."""
    there = background.level[::8, ::8]
    here = level[::8, ::8]
    usable = (there > _GAIN_LEVELS[0]) & (there < _GAIN_LEVELS[1]) & (here > 0) & (here < 255)
    if usable.sum() < _LEAST_GAIN_PIXELS:
        return 1.0
    return float(np.clip(np.median(here[usable] / there[usable]), 1 / _MOST_GAIN, _MOST_GAIN))


def _core(excess: Float32s, row: int, column: int, reach: int) -> tuple[float, float, float, float, float]:
    """x, y, peak, flux and radius of the spot around a pixel."""
    top = max(row - reach, 0)
    left = max(column - reach, 0)
    window = excess[top : row + reach + 1, left : column + reach + 1]
    near = window[max(row - top - 1, 0) : row - top + 2, max(column - left - 1, 0) : column - left + 2]
    peak = float(near.max())
    _, labels = cv2.connectedComponents((window > 0.5 * peak).astype(np.uint8))
    label = labels[row - top, column - left]
    if label == 0:  # the smoothed maximum lies beside the pixels that are bright
        label = labels.ravel()[int(window.argmax())]
    rows, columns = np.nonzero(labels == label)
    weights = window[rows, columns].astype(np.float64) - 0.5 * peak + 1e-3
    x = float(weights @ columns / weights.sum())
    y = float(weights @ rows / weights.sum())
    # of a disc, the variance along each axis is a quarter of its squared radius; a pixel has a variance of its own
    spread = np.cov(np.stack([columns, rows]).astype(np.float64), bias=True).reshape(2, 2) + np.eye(2) / 12
    radius = 2.0 * float(np.sqrt(np.linalg.eigvalsh(spread)[-1]))
    return left + x, top + y, peak, float(window[rows, columns].sum()), radius

"""Bright spots in frames of a fixed camera that its background does not have: candidates for a lamp that is carried about.

A lamp also lights what is around it, as bright as the sensor can show: a spot is what stands out from its surroundings.

The background of each pixel is the median of frames that are spread over the recording, and its noise their median absolute
deviation: what shines all the time is background, what flickers is noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from ..types import Float32s, Float64s, Uint8s

_LEAST_CONTRAST = 12.0
"""Light above that of its surroundings, after smoothing, from which on a spot is a candidate; 255 is the brightest."""
_GAMMA = 2.2
_LINEAR = (255.0 * (np.arange(256) / 255.0) ** _GAMMA).astype(np.float32)
"""Light by grey level: cameras show dark things brighter than they are, so that lit ground is almost as bright as a lamp."""
_LEAST_EXCESS = 15.0
_SIGMAS = 6.0
"""Grey levels, and standard deviations of the pixel's noise, by which it is above the background, at least."""
_LEAST_NOISE = 1.5
"""Least standard deviation of a pixel, grey levels: encoders hide noise."""
_MOST_SPOTS = 10
"""Most candidates of a frame: the brightest."""
_BLUR_SHARE = 0.001
_LEAST_BLUR_PX = 0.8
"""Standard deviation of the smoothing, as a share of the picture's larger side, but no less than the second in pixels."""
_WIDE_SHARE = 0.015
"""Standard deviation of the mean over the surroundings, likewise."""
_APART_SHARE = 0.012
"""Distance between candidates, as a share of the larger side, at least."""
_WINDOW_SHARE = 0.035
"""Half the side of the window in which a spot's core is measured, likewise."""
_RING_SHARE = (0.022, 0.034)
"""Smallest and largest distance of the surroundings from a spot's middle, likewise."""
_RING_PERCENTILE = 60.0
"""Percentile of the surroundings from which a spot must stand out."""
_CORE = 0.7
"""Share of its contrast from which on a pixel belongs to a spot's core: glare is uneven over a background that is uneven."""
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
    level: Float64s
    """(n,) float64 light of the brightest pixel; 255 is the brightest that the sensor shows, and likewise for the others."""
    contrast: Float64s
    """(n,) float64 light above that of the surroundings."""
    flux: Float64s
    """(n,) float64 sum of these differences over the core."""
    radius: Float64s
    """(n,) float64 of the core, pixels: of its longer axis, if it is long."""
    roundness: Float64s
    """(n,) float64 shorter over longer axis of the core."""

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
    blur = max(_LEAST_BLUR_PX, _BLUR_SHARE * side)
    smooth = cv2.GaussianBlur(excess, (0, 0), blur)
    # of the picture itself: where a lamp is too bright for the sensor, the difference would show the background's texture
    light = _LINEAR[level]
    standing_out = cv2.GaussianBlur(light, (0, 0), blur) - cv2.GaussianBlur(light, (0, 0), _WIDE_SHARE * side)

    # 1. Maxima that stand out enough, and more than all around them, and that the background does not have.
    reach = 2 * round(_APART_SHARE * side / 2) + 1
    is_peak = standing_out == cv2.dilate(standing_out, np.ones((reach, reach), np.uint8))
    is_peak &= standing_out > _LEAST_CONTRAST
    is_peak &= smooth > np.maximum(np.float32(_LEAST_EXCESS), np.float32(_SIGMAS) * background.noise)
    rows, columns = np.nonzero(is_peak)
    order = np.argsort(-standing_out[rows, columns], kind="stable")[: 4 * _MOST_SPOTS]

    # 2. The core of each: where it has most of its contrast.
    found: list[_Core] = []
    for k in order.tolist():
        spot = _core(light, int(rows[k]), int(columns[k]))
        if spot.contrast < _LEAST_CONTRAST:
            continue
        # a bright core may be flat, and have several maxima
        if all(np.hypot(spot.x - other.x, spot.y - other.y) > max(spot.radius, other.radius, 2.0) for other in found):
            found.append(spot)
        if len(found) == _MOST_SPOTS:
            break
    table = np.array(found, np.float64).reshape(-1, 7)
    return Spots(table[:, :2], table[:, 2], table[:, 3], table[:, 4], table[:, 5], table[:, 6])


def _gain(level: Uint8s, background: Background) -> float:
    """By how much a frame is exposed more than the background; a lamp before a camera makes it expose less."""
    there = background.level[::8, ::8]
    here = level[::8, ::8]
    usable = (there > _GAIN_LEVELS[0]) & (there < _GAIN_LEVELS[1]) & (here > 0) & (here < 255)
    if usable.sum() < _LEAST_GAIN_PIXELS:
        return 1.0
    return float(np.clip(np.median(here[usable] / there[usable]), 1 / _MOST_GAIN, _MOST_GAIN))


class _Core(NamedTuple):
    """A spot: see `Spots`."""

    x: float
    y: float
    level: float
    contrast: float
    flux: float
    radius: float
    roundness: float


def _core(light: Float32s, row: int, column: int) -> _Core:
    """The spot around a pixel."""
    side = max(light.shape)
    reach = max(round(_WINDOW_SHARE * side), 6)
    top = max(row - reach, 0)
    left = max(column - reach, 0)
    window = light[top : row + reach + 1, left : column + reach + 1]
    y, x = np.indices(window.shape)
    distance = np.hypot(y - (row - top), x - (column - left))

    # 1. How much it stands out from what is around it.
    ring = (distance >= _RING_SHARE[0] * side) & (distance <= _RING_SHARE[1] * side)
    around = float(np.percentile(window[ring], _RING_PERCENTILE))
    near = np.where(distance <= 1.5, window, -np.inf)
    brightest = int(near.argmax())
    contrast = max(float(near.max()) - around, 1.0)

    # 2. Its pixels, their centre and their extent.
    _, labels = cv2.connectedComponents((window > around + _CORE * contrast).astype(np.uint8))
    rows, columns = np.nonzero(labels == labels.ravel()[brightest])
    weights = window[rows, columns].astype(np.float64) - around - _CORE * contrast + 1e-3
    # of a disc, the variance along each axis is a quarter of its squared radius; a pixel has a variance of its own
    spread = np.cov(np.stack([columns, rows]).astype(np.float64), bias=True).reshape(2, 2) + np.eye(2) / 12
    shorter, longer = np.sqrt(np.linalg.eigvalsh(spread)).tolist()
    at_brightest = (top + brightest // window.shape[1], left + brightest % window.shape[1])
    return _Core(
        left + float(weights @ columns / weights.sum()),
        top + float(weights @ rows / weights.sum()),
        float(light[at_brightest]),
        contrast,
        float((window[rows, columns] - around).sum()),
        2.0 * longer,
        shorter / longer,
    )

"""Image statistics, by which nights are compared and the frames of a night are weighted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from ..core.luminance import grey_levels
from ..types import Bools, Float32s, Float64s, Uint8s

POOR = 0.25
"""Weight of a frame that is clearly worse than the others of its night."""
_BLURRED, _DARK, _BRIGHT, _BLINDED = 0.6, 0.5, 1.8, 0.12
"""Limits of poor frames: shares of the night's median sharpness and brightness, and excess share of saturated pixels."""
_LONG_SIDE = 640
_PRESMOOTHING_PX = 0.5
"""Sigma of the Gaussian that suppresses noise before edges are detected, pixels."""
_SCALES, _SMOOTH = (1.0, 0.5, 0.25, 0.125), 1.5
"""Scales at which pixel differences are measured, and ratio of successive ones below which there is detail.  Fitted on a yard,
fountain and entry at 768 pixels (0.9 to 1.44; enlarged or smeared: 1.6 to 1.9).  Validated on stadium, apron, hall, houses,
yard by night, belvedere, square, pavilion: 1 pixel as they are, 1.6 and more if enlarged three times or smeared by 9 px."""
_SAMPLE_STEP = 7
"""Step of the samples from which the threshold for strong slopes is taken."""
_FAINT_SLOPE, _FEWEST_EDGES = 24.0, 15
"""Sobel slopes below the first are noise; with fewer edge pixels than the second there is no estimate.  A quarter of 160 x 90
pixels has 50 to 120, and 15 to 30 if it is out of focus."""


@dataclass(frozen=True)
class ImageStatistics:
    """Statistics of one image; for the fields see `Frame`."""

    brightness: float
    contrast: float
    saturated: float
    sharpness: float


def image_statistics(image: Uint8s, usable: Bools) -> ImageStatistics:
    """Statistics of an image (h, w, 3) uint8 over its usable pixels (h, w)."""
    grey = grey_levels(image)
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)  # sensor noise must not count as sharpness
    edges = cv2.Laplacian(smooth, cv2.CV_32F)[usable]
    levels = grey[usable]
    contrast = float(levels.std())
    return ImageStatistics(
        brightness=float(levels.mean()),
        contrast=contrast,
        saturated=float(np.mean(levels >= 253)),
        sharpness=float(edges.std() / max(contrast, 1.0)),
    )


def blur_px(image: Uint8s, usable: Bools) -> float:
    """Blur of the sharper edges in the softest part of an image (h, w, 3): sigma in pixels, nan without edges.

    Parts are the quarters, the outer thirds and the whole; parts with few edges are skipped.  Blurring an edge again, by one
    pixel, reduces its slope the more the sharper it was; the ratio depends neither on contrast nor on the scene.  A part's blur
    is the lower quartile over the strongest 5 % of its slopes, since depth of field and motion blur some of nearly every image;
    parts are measured because a tilted or wet lens blurs one side.

    References: Zhuo, Sim, Defocus map estimation from a single image, Pattern Recognition 44, 2011.
    """
    grey = cv2.GaussianBlur(grey_levels(image).astype(np.float32), (0, 0), _PRESMOOTHING_PX)
    slope, reblurred = (_slope(grey), _slope(cv2.GaussianBlur(grey, (0, 0), 1.0)))
    inside = cv2.erode(usable.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
    (h, w), full = usable.shape, slice(None)
    quarters = [(y, x) for y in (slice(h // 2), slice(h // 2, None)) for x in (slice(w // 2), slice(w // 2, None))]
    thirds = [(slice(h // 3), full), (slice(-(h // 3), None), full), (full, slice(w // 3)), (full, slice(-(w // 3), None))]
    blurs = [_blur_px(slope[part], reblurred[part], inside[part]) for part in (*quarters, *thirds, (full, full))]
    return max((blur for blur in blurs if np.isfinite(blur)), default=float("nan"))


def _blur_px(slope: Float32s, reblurred: Float32s, inside: Bools) -> float:
    """Blur of a part of an image, from the slopes (h, w) of its grey levels before and after blurring it again."""
    if not inside.any():
        return float("nan")
    strong = inside & (slope > max(float(np.percentile(slope[inside][::_SAMPLE_STEP], 95)), _FAINT_SLOPE))
    edge = strong & (cv2.dilate(slope, np.ones((5, 5), np.uint8)) == slope)
    if int(edge.sum()) < _FEWEST_EDGES:
        return float("nan")
    ratio = slope[edge] / np.maximum(reblurred[edge], 1e-3)
    total = float(np.percentile(1 / np.sqrt(np.maximum(ratio**2 - 1, 1e-2)), 25))
    return float(np.sqrt(max(total**2 - _PRESMOOTHING_PX**2, 0.0)))


def _slope(grey: cv2.typing.MatLike) -> Float32s:
    # not cv2.magnitude: its last bits depend on where in memory the arrays are
    return np.asarray(np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)), np.float32)


def detail_px(image: Uint8s, usable: Bools, noise: float) -> float:
    """Distance in pixels between details that an image (h, w, 3) resolves, in the coarser direction; 1 at full resolution.

    In a sharp image, grey levels two pixels apart differ little more than those one pixel apart; in one that was blurred,
    smeared or enlarged, they differ twice as much.  The distance is the one at which this ratio falls below `_SMOOTH`.  usable:
    (h, w); noise: standard deviation in grey levels, which is subtracted.
    """
    grey = grey_levels(image).astype(np.float32)
    distances = []
    for axis in (0, 1):
        differences = [
            _rms_step(cv2.resize(grey, None, fx=f, fy=f, interpolation=cv2.INTER_AREA), usable, axis, noise * f) for f in _SCALES
        ]
        ratios = [min(coarse / max(fine, 1e-3), 2.0) for fine, coarse in pairwise(differences)]
        scale = next((k for k, ratio in enumerate(ratios) if ratio < _SMOOTH), len(ratios))
        if scale == 0:
            distances.append(1.0)
        elif scale == len(ratios):
            distances.append(2.0**scale)
        else:
            distances.append(float(2 ** (scale - 1 + (ratios[scale - 1] - _SMOOTH) / (ratios[scale - 1] - ratios[scale]))))
    return max(distances)


def _rms_step(grey: cv2.typing.MatLike, usable: Bools, axis: int, noise: float) -> float:
    """Root mean square difference of neighbouring pixels of an image (h, w) along an axis, without the noise's part."""
    h, w = grey.shape
    inside = cv2.resize(usable.astype(np.uint8), (w, h), interpolation=cv2.INTER_NEAREST).astype(np.bool_)
    pairs_inside = (inside[1:] & inside[:-1]) if axis == 0 else (inside[:, 1:] & inside[:, :-1])
    squares = np.diff(grey, axis=axis)[pairs_inside] ** 2
    return float(np.sqrt(max(float(squares.mean()) - 2 * noise**2, 0.0))) if len(squares) else 0.0


def weigh(images: Sequence[Uint8s], names: Sequence[str], usable: Bools) -> tuple[Float64s, list[str]]:
    """Weights (n,) of a night's frames (h, w, 3), and a message for each frame with a low weight.

    The weight is 1, or `POOR` if a frame is blurred, dark, bright or blinded compared with the others, over `usable` (h, w).
    """
    scale = min(_LONG_SIDE / max(usable.shape), 1.0)
    size = max(round(usable.shape[1] * scale), 1), max(round(usable.shape[0] * scale), 1)
    small = cv2.resize(usable.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(np.bool_)
    weights = np.ones(len(images))
    if len(images) < 3 or not small.any():
        return weights, []
    measured = [image_statistics(np.asarray(cv2.resize(i, size, interpolation=cv2.INTER_AREA), np.uint8), small) for i in images]
    usual = ImageStatistics(*(float(np.median([getattr(f, n) for f in measured])) for n in ImageStatistics.__dataclass_fields__))
    messages = []
    for k, (name, frame) in enumerate(zip(names, measured, strict=True)):
        if frame.saturated > usual.saturated + _BLINDED:
            problem = f"blinded ({100 * frame.saturated:.0f} % saturated, usually {100 * usual.saturated:.0f} %)"
        elif frame.sharpness < _BLURRED * usual.sharpness:
            problem = f"blurred (sharpness {frame.sharpness:.3f}, usually {usual.sharpness:.3f})"
        elif frame.brightness < _DARK * usual.brightness:
            problem = f"too dark (brightness {frame.brightness:.0f}, usually {usual.brightness:.0f})"
        elif frame.brightness > _BRIGHT * usual.brightness:
            problem = f"too bright (brightness {frame.brightness:.0f}, usually {usual.brightness:.0f})"
        else:
            continue
        weights[k] = POOR
        messages.append(f"{name} is {problem}: counts a quarter")
    return weights, messages

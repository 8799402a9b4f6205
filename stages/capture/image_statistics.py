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
_BLURRED = 0.6
"""A frame with a smaller share of the night's median sharpness is blurred."""
_DARK = 0.5
"""A frame with a smaller share of the night's median brightness is too dark."""
_BRIGHT = 1.8
"""A frame with a larger share of the night's median brightness is too bright."""
_BLINDED = 0.12
"""A frame whose share of saturated pixels exceeds the night's median by more than this is blinded."""
_LONG_SIDE = 640
"""Long side, in pixels, to which frames are reduced before they are compared."""
_PRESMOOTHING_PX = 0.5
"""Sigma of the Gaussian that suppresses noise before edges are detected, pixels."""
_SCALES = (1.0, 0.5, 0.25, 0.125)
"""Scales of an image at which pixel differences are measured."""
_SMOOTH = 1.5
"""Ratio of the differences at successive scales below which there is detail.  Larger: images with little detail pass (measured:
0.9 to 1.44 in sharp images, 1.6 to 1.9 in enlarged or smeared ones)."""
_SAMPLE_STEP = 7
"""Step of the samples from which the threshold for strong slopes is taken."""
_FAINT_SLOPE = 24.0
"""Slopes below this (Sobel, grey levels) are noise."""
_FEWEST_EDGES = 15
"""With fewer edge pixels there is no estimate.  A quarter of 160 x 90 pixels has 50 to 120, and 15 to 30 if out of focus."""


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
    slope = _slope(grey)
    reblurred = _slope(cv2.GaussianBlur(grey, (0, 0), 1.0))
    # the border of the usable pixels is an edge of its own
    inside = cv2.erode(usable.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
    blurs = []
    for part in _parts(*usable.shape):
        blur = _blur_px(slope[part], reblurred[part], inside[part])
        if np.isfinite(blur):
            blurs.append(blur)
    return max(blurs, default=float("nan"))


def _parts(h: int, w: int) -> list[tuple[slice, slice]]:
    """Rows and columns of the quarters of an image of this size, its outer thirds, and the whole."""
    full = slice(None)
    quarters = []
    for rows in (slice(h // 2), slice(h // 2, None)):
        for columns in (slice(w // 2), slice(w // 2, None)):
            quarters.append((rows, columns))
    thirds = [(slice(h // 3), full), (slice(-(h // 3), None), full), (full, slice(w // 3)), (full, slice(-(w // 3), None))]
    return [*quarters, *thirds, (full, full)]


def _blur_px(slope: Float32s, reblurred: Float32s, inside: Bools) -> float:
    """Blur of a part of an image, from the slopes (h, w) of its grey levels before and after blurring it again."""
    if not inside.any():
        return float("nan")
    threshold = max(float(np.percentile(slope[inside][::_SAMPLE_STEP], 95)), _FAINT_SLOPE)
    is_crest = cv2.dilate(slope, np.ones((5, 5), np.uint8)) == slope  # the steepest pixel within two
    edge = inside & (slope > threshold) & is_crest
    if int(edge.sum()) < _FEWEST_EDGES:
        return float("nan")
    # an edge of blur s has a slope ~ 1 / s; blurred again by 1 px, ~ 1 / sqrt(s^2 + 1): s = 1 / sqrt(ratio^2 - 1)
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
        differences = []
        for scale in _SCALES:
            reduced = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            differences.append(_rms_step(reduced, usable, axis, noise * scale))
        ratios = [min(coarse / max(fine, 1e-3), 2.0) for fine, coarse in pairwise(differences)]
        distances.append(_detail_distance(ratios))
    return max(distances)


def _detail_distance(ratios: Sequence[float]) -> float:
    """Distance in pixels at which the ratio of differences, given for 1, 2, 4, ... pixels, falls below `_SMOOTH`."""
    for k, ratio in enumerate(ratios):
        if ratio < _SMOOTH:
            if k == 0:
                return 1.0
            # between two scales, linearly in the logarithm of the distance
            previous = ratios[k - 1]
            return float(2 ** (k - 1 + (previous - _SMOOTH) / (previous - ratio)))
    return 2.0 ** len(ratios)


def _rms_step(grey: cv2.typing.MatLike, usable: Bools, axis: int, noise: float) -> float:
    """Root mean square difference of neighbouring pixels of an image (h, w) along an axis, without the noise's part."""
    h, w = grey.shape
    inside = cv2.resize(usable.astype(np.uint8), (w, h), interpolation=cv2.INTER_NEAREST).astype(np.bool_)
    if axis == 0:
        both_inside = inside[1:] & inside[:-1]
    else:
        both_inside = inside[:, 1:] & inside[:, :-1]
    squares = np.diff(grey, axis=axis)[both_inside] ** 2
    if not len(squares):
        return 0.0
    # a difference of two pixels has the variance of the noise twice
    return float(np.sqrt(max(float(squares.mean()) - 2 * noise**2, 0.0)))


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
    measured = []
    for image in images:
        reduced = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        measured.append(image_statistics(reduced, small))
    typical = _median_statistics(measured)
    messages = []
    for k, (name, frame) in enumerate(zip(names, measured, strict=True)):
        problem = _problem_of(frame, typical)
        if problem:
            weights[k] = POOR
            messages.append(f"{name} is {problem}: counts a quarter")
    return weights, messages


def _median_statistics(measured: Sequence[ImageStatistics]) -> ImageStatistics:
    """The median of each figure over several images."""
    medians = {}
    for name in ImageStatistics.__dataclass_fields__:
        medians[name] = float(np.median([getattr(frame, name) for frame in measured]))
    return ImageStatistics(**medians)


def _problem_of(frame: ImageStatistics, typical: ImageStatistics) -> str:
    """What is wrong with a frame compared with those of its night, in words; "" if nothing is."""
    if frame.saturated > typical.saturated + _BLINDED:
        return f"blinded ({100 * frame.saturated:.0f} % saturated, usually {100 * typical.saturated:.0f} %)"
    if frame.sharpness < _BLURRED * typical.sharpness:
        return f"blurred (sharpness {frame.sharpness:.3f}, usually {typical.sharpness:.3f})"
    if frame.brightness < _DARK * typical.brightness:
        return f"too dark (brightness {frame.brightness:.0f}, usually {typical.brightness:.0f})"
    if frame.brightness > _BRIGHT * typical.brightness:
        return f"too bright (brightness {frame.brightness:.0f}, usually {typical.brightness:.0f})"
    return ""

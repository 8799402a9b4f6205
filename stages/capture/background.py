"""One static image from several of a night: moving things are removed, and doubtful pixels are marked.

The background is the median of each pixel after exposures are equalised (the oldest and still the most robust method: Lo and
Velastin, 2001); a pixel is trusted if images with a majority of the weight agree with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..core.luminance import grey_levels, with_gain
from ..types import Bools, Float64s, Uint8s

_LEAST_TOLERANCE = 18.0
"""An image agrees with the background within this many grey levels; or more, in an image with much noise."""
_SIGMAS = 5.0
"""An image agrees with the background within this many standard deviations of its noise."""
_SPECK_PX = 5
"""Disagreeing areas thinner than this, in pixels, are swaying edges, and are ignored."""
_MARGIN_PX = 2
"""Width of the margin around disagreeing areas that is doubtful, too, in pixels."""
_MOST_DOUBTFUL = 0.25
"""If a larger share of the pixels is doubtful, the images differ by more than moving things, and no pixel is marked."""
_STRIP_ROWS = 64
"""Rows of which medians are computed at once, to bound memory."""

_LEAST_EXPOSURE_RATIO = 1.06
"""Smallest ratio of the brightest to the darkest exposure of a night at which overlays show: below it they change no less than
the scene does."""
_LEAST_CHANGE = 8.0
"""Grey levels by which a pixel of the scene must change between these exposures to be told from one that is constant."""
_CONSTANT_SHARE = 0.25
"""A pixel is constant if it changes by at most this share of what one of the scene would."""
_CLIPPED = 251
"""Largest grey level that is compared: brighter pixels are clipped, and constant for that reason."""
_STROKE_EDGE = 60
"""Smallest response of the Laplacian, in grey levels, next to the strokes of an overlay: they have sharp edges."""
_LEAST_STROKE_SHARE = 0.12
"""Smallest share of stroke pixels in the 9 x 9 pixels around one; isolated ones are left by noise."""


@dataclass(frozen=True)
class Background:
    """The static picture of a night."""

    image: Uint8s
    """(h, w, 3) RGB."""
    doubtful: Bools
    """(h, w), True where no majority of the images agrees: something stood or moved there."""
    overlaid: Bools
    """(h, w), True where pixels are constant while the light of the scene changes: a clock, a logo, a caption."""
    unchanged: float
    """Share of pixels that are identical in all images; 0 for a single image."""


def merge(images: Sequence[Uint8s], weights: Float64s | None = None) -> Background:
    """The background of several images (h, w, 3) of one view, in the order of time.

    Two images have no majority: the later one is used, and pixels where they differ are doubtful.  weights: (n,); None: equal.
    """
    no_pixels = np.zeros(images[0].shape[:2], np.bool_)
    if len(images) == 1:
        return Background(images[0], no_pixels, no_pixels, 0.0)
    if weights is None:
        weights = np.ones(len(images))

    # 1. equal exposures: those of the best images, or of the later one of two
    thumbnails = np.stack([cv2.resize(image, (96, 64), interpolation=cv2.INTER_AREA) for image in images]).astype(np.float32)
    reference = thumbnails[-1]
    if len(images) > 2:
        reference = np.median(thumbnails[weights == weights.max()], axis=0)
    gains = [_channel_gains(thumbnail, reference) for thumbnail in thumbnails]
    stack = [with_gain(image, gain) for image, gain in zip(images, gains, strict=True)]

    # 2. the background
    merged = images[-1]
    if len(images) > 2:
        merged = _medians(stack, weights)

    # 3. where no majority agrees with it (1e-9: a weight of exactly one half, after rounding, is none)
    agreement = _agreement(stack, merged, weights)
    disagreeing = cv2.morphologyEx((agreement <= 0.5 + 1e-9).astype(np.uint8), cv2.MORPH_OPEN, _disc(_SPECK_PX))
    doubtful = np.asarray(cv2.dilate(disagreeing, _disc(2 * _MARGIN_PX + 1)), np.bool_)
    if doubtful.mean() > _MOST_DOUBTFUL:
        doubtful = no_pixels

    # 4. a live sensor has noise: pixels that are the same in all images show that they repeat each other
    identical = np.logical_and.reduce([(image == images[0]).all(axis=2) for image in images[1:]])
    return Background(merged, doubtful, _overlaid(images, np.array(gains), merged), float(identical.mean()))


def _medians(stack: Sequence[Uint8s], weights: Float64s) -> Uint8s:
    """(h, w, 3) weighted median of each channel of each pixel over the images (h, w, 3); always a value of one of them."""
    merged = np.empty_like(stack[0])
    middle = len(stack) // 2
    equal_weights = bool((weights == weights[0]).all())
    for top in range(0, len(merged), _STRIP_ROWS):  # in strips: only one uint8 copy of the stack is in memory
        strip = np.stack([image[top : top + _STRIP_ROWS] for image in stack])
        if equal_weights:
            merged[top : top + _STRIP_ROWS] = np.partition(strip, middle, axis=0)[middle]
            continue
        # in ascending order, the first value with which half of the weight is reached
        order = np.argsort(strip, axis=0, kind="stable")
        past_middle = np.cumsum(weights[order], axis=0) > 0.5 * weights.sum() - 1e-9
        chosen = np.take_along_axis(order, past_middle.argmax(axis=0)[None], axis=0)
        merged[top : top + _STRIP_ROWS] = np.take_along_axis(strip, chosen, axis=0)[0]
    return merged


def _agreement(stack: Sequence[Uint8s], merged: Uint8s, weights: Float64s) -> Float64s:
    """(h, w) share of the images' weight that agrees with the background."""
    share = np.zeros(merged.shape[:2])
    for image, weight in zip(stack, weights, strict=True):
        difference = cv2.absdiff(image, merged).max(axis=2)
        # the median absolute deviation, as a standard deviation; a sixteenth of the pixels is enough
        sigma = 1.4826 * float(np.median(difference[::4, ::4]))
        share += weight * (difference <= max(_LEAST_TOLERANCE, _SIGMAS * sigma))
    return np.asarray(share / weights.sum(), np.float64)


def _disc(size: int) -> Uint8s:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)


def _overlaid(images: Sequence[Uint8s], gains: Float64s, merged: Uint8s) -> Bools:
    """(h, w), True where an overlay is constant while the scene's exposure changes.

    It is detected only where the exposure has changed enough to move a pixel by some grey levels.  Strokes are joined to lines
    of text, which then include the changing digits.
    """
    # 1. the two images with the most different exposures; the brightest needs the smallest gain
    mean_gains = gains.mean(axis=1)
    brightest = int(mean_gains.argmin())
    darkest = int(mean_gains.argmax())
    ratio = float(mean_gains[darkest] / mean_gains[brightest])
    if ratio < _LEAST_EXPOSURE_RATIO:
        return np.zeros(merged.shape[:2], np.bool_)
    bright = images[brightest].max(axis=2).astype(np.float32)
    dark = images[darkest].max(axis=2).astype(np.float32)

    # 2. strokes: pixels with sharp edges that are as bright in both
    difference = np.abs(bright - dark)
    expected = np.minimum(bright, dark) * (ratio - 1)
    is_constant = (expected >= _LEAST_CHANGE) & (difference <= _CONSTANT_SHARE * expected)
    is_constant &= np.maximum(bright, dark) <= _CLIPPED
    edges = np.abs(cv2.Laplacian(grey_levels(merged), cv2.CV_32F))
    strokes = (is_constant & (cv2.dilate(edges, _disc(3)) > _STROKE_EDGE)).astype(np.uint8)
    strokes[cv2.blur(strokes.astype(np.float32), (9, 9)) < _LEAST_STROKE_SHARE] = 0

    # 3. lines of text: strokes close to each other in a row, of some size and number
    width = merged.shape[1]
    text_lines = cv2.morphologyEx(strokes, cv2.MORPH_CLOSE, np.ones((5, max(width // 20, 5) | 1), np.uint8))
    overlay = np.zeros_like(text_lines)
    _, _, boxes, _ = cv2.connectedComponentsWithStats(text_lines, connectivity=8)
    for x, y, w, h, _ in boxes[1:].tolist():
        stroke_pixels = int(strokes[y : y + h, x : x + w].sum())
        if w >= 8 and h >= 4 and stroke_pixels >= max(12, 0.08 * w * h):
            overlay[max(y - 2, 0) : y + h + 2, max(x - 2, 0) : x + w + 2] = 1
    return np.asarray(overlay, np.bool_)


def _channel_gains(thumbnail: np.ndarray, reference: np.ndarray) -> Float64s:
    """(3,) gains that bring a thumbnail's channels to the reference's exposure: robust to motion, clipped pixels left out."""
    usable = (thumbnail > 8) & (thumbnail < 247) & (reference > 8) & (reference < 247)
    gains = np.ones(3)
    for channel in range(3):
        ratios = reference[..., channel][usable[..., channel]] / thumbnail[..., channel][usable[..., channel]]
        if ratios.size >= 50:
            gains[channel] = np.median(ratios)
    return gains

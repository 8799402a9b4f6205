"""Prepare the two rectified images of a pair for dense matching: grey, denoised, equal exposure, with a disparity range.

Keypoint matches are sparse: on real pairs, up to a fifth of the common view, mostly foreground, lies outside the disparity
range of the matches.  A coarse dense match at a quarter of the size, over a wider range, costs little and finds it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from ..core.luminance import noise_level
from ..rectification.warping import Side, from_rectified, to_rectified, warp_with_mask
from ..types import Bools, Float32s, Float64s, Frame, GroundOfPair, Rectification, Uint8s
from .consistency import cross_checked
from .matcher import RectifiedPair
from .sgbm import match_in_one_piece

_SIDES: tuple[Side, ...] = (1, 2)
_WIDTH_MULTIPLE = 32


def rectified_pair(left: Frame, right: Frame, rectification: Rectification) -> RectifiedPair:
    """Both rectified images in grey, padded to the same width, and masks of the pixels that may be matched.

    The width is even at every size that matchers go down to, so that halving and mirroring can be done in either order.
    """
    width = -(-max(rectification.size1[0], rectification.size2[0]) // _WIDTH_MULTIPLE) * _WIDTH_MULTIPLE
    images, masks = [], []
    for frame, side in zip((left, right), _SIDES, strict=True):
        grey, mask = denoised_if_noisy(_grey(frame.image), frame.mask), frame.mask & ~_saturated(frame.image)
        grey, mask = warp_with_mask(rectification, side, grey, mask)
        padding = (0, 0), (0, width - grey.shape[1])
        images.append(np.pad(grey, padding, mode="edge"))
        masks.append(np.pad(mask, padding))
    low, high = round(rectification.disparity_min_px), round(rectification.disparity_max_px)
    pair = RectifiedPair(images[0], images[1], masks[0], masks[1], low, high)
    if (ground := rectification.ground) is None:
        return pair
    shape = images[0].shape
    prior, floor = (
        [_plane_disparity(rectification, ground, plane, side, shape) for side in _SIDES]
        for plane in (ground.homography, ground.beneath)
    )
    return replace(pair, prior_left=prior[0], prior_right=prior[1], floor_left=floor[0], floor_right=floor[1])


def _plane_disparity(
    rectification: Rectification, ground: GroundOfPair, plane: Float64s, side: Side, shape: tuple[int, ...]
) -> Float32s:
    """(h, w) disparity of the ground, or of a plane beneath it, in one rectified image; nan above the horizon.

    plane: (3, 3) homography of the plane, frame 1 to frame 2.
    """
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].reshape(2, -1)
    points = np.column_stack([x, y]).astype(np.float64)
    H = plane if side == 1 else np.linalg.inv(plane)
    pixels = from_rectified(rectification, side, points)
    X, Y, z = H[:, :2] @ pixels.T + H[:, 2:]
    inverse_depth = ground.inverse_depth1 if side == 1 else ground.inverse_depth2
    with np.errstate(divide="ignore", invalid="ignore"):
        partners = to_rectified(rectification, 2 if side == 1 else 1, np.column_stack([X / z, Y / z]))
        disparity = points[:, 0] - partners[:, 0] if side == 1 else partners[:, 0] - points[:, 0]
    known = (pixels @ inverse_depth[:2] + inverse_depth[2] > 0) & (z > 0) & (np.abs(partners[:, 1] - points[:, 1]) < 1.0)
    return np.where(known, disparity, np.nan).astype(np.float32).reshape(shape)


def _grey(image: Uint8s) -> Float32s:
    """Luminance, float32 and not rounded: rounding to 8 bits loses the faint texture of white walls."""
    return np.asarray(image.astype(np.float32) @ np.array([0.299, 0.587, 0.114], dtype=np.float32), dtype=np.float32)


def _saturated(image: Uint8s) -> Bools:
    red, green, blue = (image[..., k] for k in range(3))
    darkest, brightest = np.minimum(np.minimum(red, green), blue), np.maximum(np.maximum(red, green), blue)
    return np.asarray((darkest >= 254) | (brightest <= 1))


NOISY = 3.0
"""Images with at least this noise (standard deviation, grey levels) are smoothed before matching: lamp light, high gain.  An
image with fine texture everywhere measures 2."""


def denoised_if_noisy(image: Float32s, valid: Bools) -> Float32s:
    """The image, smoothed by a Gaussian of 1 px where it is noisy."""
    if noise_level(image, valid) < NOISY:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.float32)


_SHRINK = 4
_EXTENSION = 1.0
"""The coarse match extends the range of the keypoint matches by this share on both sides."""
_LEAST_SHARE = 0.002
"""Less than this share of the agreeing pixels is cut off as outliers at each end of the range."""
_EXTENSION_SHARE = 0.02
"""Extending the range by its own width requires this share of the agreeing pixels: small pieces of look-alikes agree, too."""
_LEAST_AGREED_SHARE = 0.1
"""Smallest share of the common area that must agree for the coarse match to be used."""
_COARSE_PX, _FINE_CONTRAST = 10.0, 8.0


def with_coarse_range(pair: RectifiedPair) -> RectifiedPair:
    """The pair with the disparity range found by a coarse match, and with both images at equal brightness and contrast."""
    small = _shrunk(pair)
    matches = match_in_one_piece(_flattened(small))
    agreed = ~np.isnan(cross_checked(matches.left, matches.right, small.valid_left, -1, max(small.left.size // 2000, 4)))
    if agreed.sum() < max(_LEAST_AGREED_SHARE * small.matchable_pixels().sum(), 50):
        return _flattened(pair)
    near = _range_end(matches.left[agreed], small.disparity_min, small.disparity_max)
    far = -_range_end(-matches.left[agreed], -small.disparity_max, -small.disparity_min)
    margin = 2 * _SHRINK + 0.05 * (pair.disparity_max - pair.disparity_min)
    low, high = int(np.floor(_SHRINK * near - margin)), int(np.ceil(_SHRINK * far + margin))
    return replace(_with_equal_exposure(pair, small, matches.left, agreed), disparity_min=low, disparity_max=high)


def _range_end(disparity: Float32s, lowest: int, highest: int) -> float:
    """Smallest of the disparities (n,) with enough others at or below it; the search went from `lowest` to `highest`."""
    ordered = np.sort(disparity)
    matches_width = (highest - lowest) / (1 + 2 * _EXTENSION)
    excess = (lowest + _EXTENSION * matches_width - ordered) / matches_width  # in widths of the matches' range
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    return float(ordered[np.argmax(share >= np.maximum(_LEAST_SHARE, _EXTENSION_SHARE * excess))])


def _shrunk(pair: RectifiedPair) -> RectifiedPair:
    extension = _EXTENSION * (pair.disparity_max - pair.disparity_min)
    return RectifiedPair(
        left=_quarter(pair.left),
        right=_quarter(pair.right),
        valid_left=_quarter(pair.valid_left.astype(np.float32)) > 0.99,
        valid_right=_quarter(pair.valid_right.astype(np.float32)) > 0.99,
        disparity_min=int(np.floor((pair.disparity_min - extension) / _SHRINK)),
        disparity_max=int(np.ceil((pair.disparity_max + extension) / _SHRINK)),
    )


def _quarter(image: Float32s) -> Float32s:
    """(h / 4, w / 4) means of 4x4 pixels; the image is padded with zeros to whole blocks."""
    height, width = image.shape
    padded = np.pad(image, ((0, -height % _SHRINK), (0, -width % _SHRINK)))
    small = cv2.resize(padded, (padded.shape[1] // _SHRINK, padded.shape[0] // _SHRINK), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


def _flattened(pair: RectifiedPair) -> RectifiedPair:
    """Both images without coarse brightness and with equal fine contrast: what is possible before anything is matched."""
    images = [_fine_part(image, valid) for image, valid in ((pair.left, pair.valid_left), (pair.right, pair.valid_right))]
    return replace(pair, left=images[0], right=images[1])


def _fine_part(image: Float32s, valid: Bools) -> Float32s:
    if not valid.any():
        return image
    weight = cv2.GaussianBlur(valid.astype(np.float32), (0, 0), _COARSE_PX)
    coarse = cv2.GaussianBlur(np.where(valid, image, 0).astype(np.float32), (0, 0), _COARSE_PX) / np.maximum(weight, 1e-3)
    fine = image - coarse
    gain = _FINE_CONTRAST / max(float(np.median(np.abs(fine[valid]))), 0.5)
    return np.where(valid, 128 + gain * fine, 128).astype(np.float32)


def _with_equal_exposure(pair: RectifiedPair, small: RectifiedPair, disparity: Float32s, agreed: Bools) -> RectifiedPair:
    """The pair with the lower-contrast image stretched to match the other, by the pixels on which both views agree."""
    rows, columns = np.nonzero(agreed)
    partner = np.clip(np.rint(columns - disparity[agreed]).astype(np.int64), 0, small.right.shape[1] - 1)
    left, right = small.left[agreed], small.right[rows, partner]
    spread_left, spread_right = (float(np.subtract(*np.percentile(v, [90, 10]))) for v in (left, right))
    gain = max(spread_left, 1.0) / max(spread_right, 1.0)
    offset = float(np.median(left - gain * right))
    if gain >= 1:
        return replace(pair, right=(gain * pair.right + offset).astype(np.float32))
    return replace(pair, left=((pair.left - offset) / gain).astype(np.float32))

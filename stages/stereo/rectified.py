"""The two rectified images of a pair, made ready for dense matching."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from ..core.luminance import noise_level
from ..rectification.warping import Side, from_rectified, to_rectified, warp_with_mask
from ..types import Bools, Float32s, Float64s, Frame, GroundOfPair, Rectification, Uint8s
from .matcher import RectifiedPair

_SIDES: tuple[Side, ...] = (1, 2)
_WHOLE_PX = 32


def rectified_pair(left: Frame, right: Frame, rectification: Rectification) -> RectifiedPair:
    """Both rectified images in grey, padded to one width, and what of them may be matched.

    The width is even at every size that matchers go down to: a mirror image of half the size is then half the mirror image.
    """
    width = -(-max(rectification.size1[0], rectification.size2[0]) // _WHOLE_PX) * _WHOLE_PX
    images, masks = [], []
    for frame, side in zip((left, right), _SIDES, strict=True):
        grey, mask = quietened(_grey(frame.image), frame.mask), frame.mask & ~_saturated(frame.image)
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
    """(h, w) disparity of the ground, or of a plane beneath it, in one rectified image; nan where that looks above the horizon.

    Parameters
    ----------
    rectification : of the pair.
    ground : where the ground is.
    plane : (3, 3) homography of the plane, frame 1 to frame 2.
    side : 1 or 2: which image.
    shape : of the rectified images.
    """
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].reshape(2, -1)
    at = np.column_stack([x, y]).astype(np.float64)
    H = plane if side == 1 else np.linalg.inv(plane)
    pixels = from_rectified(rectification, side, at)
    X, Y, z = H[:, :2] @ pixels.T + H[:, 2:]
    line = ground.inverse_depth1 if side == 1 else ground.inverse_depth2
    with np.errstate(divide="ignore", invalid="ignore"):
        there = to_rectified(rectification, 2 if side == 1 else 1, np.column_stack([X / z, Y / z]))
        disparity = at[:, 0] - there[:, 0] if side == 1 else there[:, 0] - at[:, 0]
    known = (pixels @ line[:2] + line[2] > 0) & (z > 0) & (np.abs(there[:, 1] - at[:, 1]) < 1.0)
    return np.where(known, disparity, np.nan).astype(np.float32).reshape(shape)


def _grey(image: Uint8s) -> Float32s:
    """Luminance, float32 and not rounded: rounding to 8 bits loses the faint texture of white walls."""
    return np.asarray(image.astype(np.float32) @ np.array([0.299, 0.587, 0.114], dtype=np.float32), dtype=np.float32)


def _saturated(image: Uint8s) -> Bools:
    red, green, blue = (image[..., k] for k in range(3))
    darkest, brightest = np.minimum(np.minimum(red, green), blue), np.maximum(np.maximum(red, green), blue)
    return np.asarray((darkest >= 254) | (brightest <= 1))


NOISY = 3.0
"""Grey levels of noise (standard deviation) from which a picture is smoothed before it is matched: lamp light, high gain.  Fine
texture everywhere reads as 2."""


def quietened(image: Float32s, valid: Bools) -> Float32s:
    """The image, smoothed by a Gaussian of 1 px where it is noisy."""
    if noise_level(image, valid) < NOISY:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.float32)

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

_WIDTH_MULTIPLE = 32
"""Widths are padded to multiples of this, pixels, so that they can be halved five times."""
_SATURATED_DARK = 1
"""Pixels whose brightest channel has at most this level show no texture."""
_SATURATED_BRIGHT = 254
"""Pixels whose darkest channel has at least this level show no texture."""
_ROW_TOLERANCE_PX = 1.0
"""The disparity of a plane is known where its points lie on the same row in both images, within this many pixels."""


def rectified_pair(left: Frame, right: Frame, rectification: Rectification) -> RectifiedPair:
    """Both rectified images in grey, padded to the same width, and masks of the pixels that may be matched.

    The width is even at every size that matchers go down to, so that halving and mirroring can be done in either order.
    """
    widest = max(rectification.size1[0], rectification.size2[0])
    width = -(-widest // _WIDTH_MULTIPLE) * _WIDTH_MULTIPLE  # rounded up
    image1, mask1 = _rectified_grey(left, rectification, 1, width)
    image2, mask2 = _rectified_grey(right, rectification, 2, width)
    low = round(rectification.disparity_min_px)
    high = round(rectification.disparity_max_px)
    pair = RectifiedPair(image1, image2, mask1, mask2, low, high)
    ground = rectification.ground
    if ground is None:
        return pair
    return replace(
        pair,
        prior_left=_plane_disparity(rectification, ground, ground.homography, 1, image1.shape),
        prior_right=_plane_disparity(rectification, ground, ground.homography, 2, image1.shape),
        floor_left=_plane_disparity(rectification, ground, ground.beneath, 1, image1.shape),
        floor_right=_plane_disparity(rectification, ground, ground.beneath, 2, image1.shape),
    )


def _rectified_grey(frame: Frame, rectification: Rectification, side: Side, width: int) -> tuple[Float32s, Bools]:
    """(h, width) grey levels of one rectified image, denoised, and which of its pixels may be matched."""
    grey = denoised_if_noisy(_grey(frame.image), frame.mask)
    usable = frame.mask & ~_saturated(frame.image)
    warped, mask = warp_with_mask(rectification, side, grey, usable)
    padding = ((0, 0), (0, width - warped.shape[1]))
    return np.pad(warped, padding, mode="edge"), np.pad(mask, padding)


def _plane_disparity(
    rectification: Rectification, ground: GroundOfPair, plane: Float64s, side: Side, shape: tuple[int, ...]
) -> Float32s:
    """(h, w) disparity of the ground, or of a plane beneath it, in one rectified image; nan above the horizon.

    Each pixel goes to its frame, by the plane's homography to the other frame, and from there to the other rectified image.

    Parameters
    ----------
    rectification, side : how the frames are resampled, and the side of the image.
    ground : where the ground lies in front of each camera.
    plane : (3, 3) homography of the plane, frame 1 to frame 2.
    shape : height and width of the rectified image, pixels.
    """
    if side == 1:
        other_side: Side = 2
        H = plane
        inverse_depth = ground.inverse_depth1
    else:
        other_side = 1
        H = np.asarray(np.linalg.inv(plane), dtype=np.float64)
        inverse_depth = ground.inverse_depth2
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].reshape(2, -1)
    points = np.column_stack([x, y]).astype(np.float64)
    pixels = from_rectified(rectification, side, points)
    X, Y, z = H[:, :2] @ pixels.T + H[:, 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        partners = to_rectified(rectification, other_side, np.column_stack([X / z, Y / z]))
        if side == 1:
            disparity = points[:, 0] - partners[:, 0]
        else:
            disparity = partners[:, 0] - points[:, 0]
    in_front = pixels @ inverse_depth[:2] + inverse_depth[2] > 0  # below the horizon
    other_in_front = z > 0
    on_row = np.abs(partners[:, 1] - points[:, 1]) < _ROW_TOLERANCE_PX
    known = in_front & other_in_front & on_row
    return np.where(known, disparity, np.nan).astype(np.float32).reshape(shape)


def _grey(image: Uint8s) -> Float32s:
    """Luminance, float32 and not rounded: rounding to 8 bits loses the faint texture of white walls."""
    return np.asarray(image.astype(np.float32) @ np.array([0.299, 0.587, 0.114], dtype=np.float32), dtype=np.float32)


def _saturated(image: Uint8s) -> Bools:
    """(h, w) bool: pixels of which all channels are white, or all black."""
    red = image[..., 0]
    green = image[..., 1]
    blue = image[..., 2]
    # two by two: far faster than a minimum along the last axis
    darkest = np.minimum(np.minimum(red, green), blue)
    brightest = np.maximum(np.maximum(red, green), blue)
    return np.asarray((darkest >= _SATURATED_BRIGHT) | (brightest <= _SATURATED_DARK))


NOISY = 3.0
"""Images with at least this noise (standard deviation, grey levels) are smoothed before matching: lamp light, high gain.  An
image with fine texture everywhere measures 2."""


def denoised_if_noisy(image: Float32s, valid: Bools) -> Float32s:
    """The image, smoothed by a Gaussian of 1 px where it is noisy."""
    if noise_level(image, valid) < NOISY:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.float32)


_SHRINK = 4
"""The coarse match works at this fraction of the size."""
_EXTENSION = 1.0
"""The coarse match extends the range of the keypoint matches by this share on both sides."""
_LEAST_SHARE = 0.002
"""Less than this share of the agreeing pixels is cut off as outliers at each end of the range."""
_EXTENSION_SHARE = 0.02
"""Extending the range by its own width requires this share of the agreeing pixels: small pieces of look-alikes agree, too."""
_LEAST_AGREED_SHARE = 0.1
"""Smallest share of the common area that must agree for the coarse match to be used."""
_FEWEST_AGREED = 50
"""Fewest pixels that must agree for the coarse match to be used."""
_MARGIN_SHARE = 0.05
"""Margin beyond the coarse match, as a share of the given range, besides two pixels of the coarse match."""
_COARSE_PX = 10.0
"""Standard deviation of the Gaussian, in pixels, that separates coarse brightness from fine contrast."""
_FINE_CONTRAST = 8.0
"""Fine contrast, the median of its absolute grey levels, to which images are stretched."""


def with_coarse_range(pair: RectifiedPair) -> RectifiedPair:
    """The pair with the disparity range found by a coarse match, and with both images at equal brightness and contrast."""
    small = _shrunk(pair)
    matches = match_in_one_piece(_flattened(small))
    smallest_px = max(small.left.size // 2000, 4)
    agreed = ~np.isnan(cross_checked(matches.left, matches.right, small.valid_left, -1, smallest_px))
    if agreed.sum() < max(_LEAST_AGREED_SHARE * small.matchable_pixels().sum(), _FEWEST_AGREED):
        return _flattened(pair)
    low = _range_end(matches.left[agreed], small.disparity_min, small.disparity_max)
    high = -_range_end(-matches.left[agreed], -small.disparity_max, -small.disparity_min)
    margin = 2 * _SHRINK + _MARGIN_SHARE * (pair.disparity_max - pair.disparity_min)
    return replace(
        _with_equal_exposure(pair, small, matches.left, agreed),
        disparity_min=int(np.floor(_SHRINK * low - margin)),
        disparity_max=int(np.ceil(_SHRINK * high + margin)),
    )


def _range_end(disparity: Float32s, lowest: int, highest: int) -> float:
    """Smallest of the disparities (n,) with enough others at or below it; the search went from `lowest` to `highest`."""
    ordered = np.sort(disparity)
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    # how far each lies below the range of the keypoint matches, in widths of that range: the farther, the more must agree
    matches_width = (highest - lowest) / (1 + 2 * _EXTENSION)
    excess = (lowest + _EXTENSION * matches_width - ordered) / matches_width
    enough = share >= np.maximum(_LEAST_SHARE, _EXTENSION_SHARE * excess)
    return float(ordered[np.argmax(enough)])


def _shrunk(pair: RectifiedPair) -> RectifiedPair:
    """The pair at a quarter of its size, with a range that is wider by `_EXTENSION` on both sides."""
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
    return replace(pair, left=_fine_part(pair.left, pair.valid_left), right=_fine_part(pair.right, pair.valid_right))


def _fine_part(image: Float32s, valid: Bools) -> Float32s:
    """The image (h, w) minus its blurred self, at a standard contrast around 128; 128 where it is not valid."""
    if not valid.any():
        return image
    # a mean over valid pixels alone: blurred values over blurred weights
    weight = cv2.GaussianBlur(valid.astype(np.float32), (0, 0), _COARSE_PX)
    blurred = cv2.GaussianBlur(np.where(valid, image, 0).astype(np.float32), (0, 0), _COARSE_PX)
    coarse = blurred / np.maximum(weight, 1e-3)
    fine = image - coarse
    gain = _FINE_CONTRAST / max(float(np.median(np.abs(fine[valid]))), 0.5)
    return np.where(valid, 128 + gain * fine, 128).astype(np.float32)


def _with_equal_exposure(pair: RectifiedPair, small: RectifiedPair, disparity: Float32s, agreed: Bools) -> RectifiedPair:
    """The pair with the lower-contrast image stretched to match the other, by the pixels on which both views agree."""
    rows, columns = np.nonzero(agreed)
    partner = np.clip(np.rint(columns - disparity[agreed]).astype(np.int64), 0, small.right.shape[1] - 1)
    left = small.left[agreed]
    right = small.right[rows, partner]
    gain = max(_spread(left), 1.0) / max(_spread(right), 1.0)
    offset = float(np.median(left - gain * right))
    # the image of lower contrast is stretched: compressing the other would bring faint texture below the matchers' limits
    if gain >= 1:
        return replace(pair, right=(gain * pair.right + offset).astype(np.float32))
    return replace(pair, left=((pair.left - offset) / gain).astype(np.float32))


def _spread(values: Float32s) -> float:
    """Distance between the 10th and the 90th percentile of grey levels (n,)."""
    high, low = np.percentile(values, [90, 10])
    return float(high - low)

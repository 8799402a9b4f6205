"""Input and output of every dense matcher: the interface for further matchers."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from ..types import Bools, Float32s

Pixel = TypeVar("Pixel", np.float32, np.bool_)


@dataclass(frozen=True)
class RectifiedPair:
    """Two rectified images; a point at x in the left one lies at x - d in the right one, on the same row.

    All arrays have the shape (h, w) of the images.
    """

    left: Float32s
    right: Float32s
    """(h, w) float32 grey, 0 to 255, never rounded, of one size."""
    valid_left: Bools
    valid_right: Bools
    """(h, w) bool, True where a pixel may be matched."""
    disparity_min: int
    disparity_max: int
    """Whole pixels, the range to search, both ends included."""
    prior_left: Float32s | None = None
    prior_right: Float32s | None = None
    """(h, w) disparity of a surface that is likely to be there (the ground), nan where there is none; None if unknown."""
    _: KW_ONLY
    reference_left: Float32s | None = None
    reference_right: Float32s | None = None
    """(h, w) disparity of another night from the same places, nan where it had none; None without such a night."""
    floor_left: Float32s | None = None
    floor_right: Float32s | None = None
    """(h, w) disparity of a surface behind the prior one, beyond which there is nothing; None without such a limit."""

    def matchable_pixels(self) -> Bools:
        """(h, w) bool: valid pixels of the left image that have at least one valid partner within the range."""
        height, width = self.valid_left.shape
        # number of valid pixels of the right image to the left of each column
        count = np.zeros((height, width + 1), dtype=np.int32)
        np.cumsum(self.valid_right, axis=1, out=count[:, 1:])
        # columns of the partners from the largest disparity to the smallest, the end excluded
        first = np.clip(np.arange(width) - self.disparity_max, 0, width)
        end = np.clip(np.arange(width) - self.disparity_min + 1, 0, width)
        return self.valid_left & (count[:, end] > count[:, first])


@dataclass(frozen=True)
class DenseMatches:
    """Disparity of both views before they are compared: (h, w) float32 pixels, nan where the matcher found none."""

    left: Float32s
    """x2 = x1 - d."""
    right: Float32s
    """x1 = x2 + d."""
    confidence_left: Float32s
    confidence_right: Float32s
    """(h, w) float32, 0 to 1; a value with confidence 0 may confirm the other view's, but is not kept itself."""


def mirrored(pair: RectifiedPair) -> RectifiedPair:
    """The pair mirrored, with views exchanged: its left disparity is the right disparity of `pair`, mirrored."""
    return RectifiedPair(
        left=_mirror(pair.right),
        right=_mirror(pair.left),
        valid_left=_mirror(pair.valid_right),
        valid_right=_mirror(pair.valid_left),
        disparity_min=pair.disparity_min,
        disparity_max=pair.disparity_max,
        prior_left=_mirror_known(pair.prior_right),
        prior_right=_mirror_known(pair.prior_left),
        reference_left=_mirror_known(pair.reference_right),
        reference_right=_mirror_known(pair.reference_left),
        floor_left=_mirror_known(pair.floor_right),
        floor_right=_mirror_known(pair.floor_left),
    )


def _mirror(image: npt.NDArray[Pixel]) -> npt.NDArray[Pixel]:
    return np.ascontiguousarray(image[:, ::-1])


def _mirror_known(disparity: Float32s | None) -> Float32s | None:
    if disparity is None:
        return None
    return _mirror(disparity)


def halved(pair: RectifiedPair) -> RectifiedPair:
    """The pair at half its size, padded at the right and the bottom by its border; valid where all four pixels are.

    Disparity of another night is left out: it is a start for the full size only.
    """
    return RectifiedPair(
        left=_half(pair.left),
        right=_half(pair.right),
        # a mean of four ones, whatever its rounding
        valid_left=_half(pair.valid_left.astype(np.float32)) > 0.99,
        valid_right=_half(pair.valid_right.astype(np.float32)) > 0.99,
        # one more at either end, as a disparity may fall between two of the halved images
        disparity_min=pair.disparity_min // 2 - 1,
        disparity_max=-(-pair.disparity_max // 2) + 1,
        prior_left=_half_disparity(pair.prior_left),
        prior_right=_half_disparity(pair.prior_right),
        floor_left=_half_disparity(pair.floor_left),
        floor_right=_half_disparity(pair.floor_right),
    )


def _half_disparity(disparity: Float32s | None) -> Float32s | None:
    """(h / 2, w / 2) disparity in pixels of the halved images."""
    if disparity is None:
        return None
    return _half(disparity) / np.float32(2)


def _half(image: Float32s) -> Float32s:
    """(h / 2, w / 2) means of 2x2 pixels, sides rounded up."""
    padded = np.pad(image, ((0, image.shape[0] % 2), (0, image.shape[1] % 2)), mode="edge")
    small = cv2.resize(padded, (padded.shape[1] // 2, padded.shape[0] // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)

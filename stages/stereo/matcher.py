"""Input and output of every dense matcher: the interface for further matchers."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import cv2
import numpy as np

from ..types import Bools, Float32s


@dataclass(frozen=True)
class RectifiedPair:
    """Two rectified images; a point at x in the left one lies at x - d in the right one, on the same row."""

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
        count = np.zeros((height, width + 1), dtype=np.int32)
        np.cumsum(self.valid_right, axis=1, out=count[:, 1:])
        first = np.clip(np.arange(width) - self.disparity_max, 0, width)
        last = np.clip(np.arange(width) - self.disparity_min + 1, 0, width)
        return self.valid_left & (count[:, last] > count[:, first])


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

    def flipped(name: str) -> Any:
        image = getattr(pair, name)
        return None if image is None else np.ascontiguousarray(image[:, ::-1])

    sides = [(f"{prefix}left", f"{prefix}right") for prefix in ("", "valid_", "prior_", "floor_", "reference_")]
    return replace(pair, **{name: flipped(other) for left, right in sides for name, other in ((left, right), (right, left))})


def halved(pair: RectifiedPair) -> RectifiedPair:
    """The pair at half its size, padded at the right and the bottom by its border; valid where all four pixels are.

    Disparity of another night is left out: it is a start for the full size only.
    """
    return RectifiedPair(
        left=_half(pair.left),
        right=_half(pair.right),
        valid_left=_half(pair.valid_left.astype(np.float32)) > 0.99,
        valid_right=_half(pair.valid_right.astype(np.float32)) > 0.99,
        disparity_min=pair.disparity_min // 2 - 1,
        disparity_max=-(-pair.disparity_max // 2) + 1,
        prior_left=_half_disparity(pair.prior_left),
        prior_right=_half_disparity(pair.prior_right),
        floor_left=_half_disparity(pair.floor_left),
        floor_right=_half_disparity(pair.floor_right),
    )


def _half_disparity(disparity: Float32s | None) -> Float32s | None:
    return None if disparity is None else _half(disparity) / np.float32(2)


def _half(image: Float32s) -> Float32s:
    padded = np.pad(image, ((0, image.shape[0] % 2), (0, image.shape[1] % 2)), mode="edge")
    small = cv2.resize(padded, (padded.shape[1] // 2, padded.shape[0] // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)

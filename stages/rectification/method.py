"""Input and output of a rectification method: the interface at which methods plug in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..types import Camera, Float32s, Float64s, PolarRows
from .placement import Size

Points = tuple[Float64s, Float64s] | None
"""Pixels (m, 2) of frame 1, and of frame 2; None if there are none."""


@dataclass(frozen=True)
class MatchedPair:
    """F, and the matches that obey it: all that a rectification method knows of a pair."""

    F: Float64s
    """(3, 3), x2^T F x1 = 0; from the cameras where both are known."""
    x1: Float64s
    x2: Float64s
    """(n, 2) pixels of the frames."""
    probability: Float32s
    size1: Size
    size2: Size
    """(width, height) of the frames."""
    camera1: Camera | None
    camera2: Camera | None
    angle_deg: float
    """Median angle between the two rays of a match; nan if neither cameras nor geometry give it."""
    extra_points: Points = None
    """Further points (m, 2), (m, 2) that the rectified images must show, although they are not matched."""

    def shown(self) -> tuple[Float64s, Float64s]:
        """Points in both images around which the rectified images are cropped."""
        if self.extra_points is None:
            return self.x1, self.x2
        extra1, extra2 = self.extra_points
        return np.concatenate([self.x1, extra1]), np.concatenate([self.x2, extra2])


class Homographies(NamedTuple):
    """H1, H2 (3, 3): frame pixels to rectified ones; common scales, the common y offset and both x offsets are set by `place`."""

    H1: Float64s
    H2: Float64s


class PolarImages(NamedTuple):
    """The rows of both images, their rectified sizes, and the share of matches on one common side of the epipole (1 for a right
    F)."""

    rows1: PolarRows
    rows2: PolarRows
    size1: Size
    size2: Size
    agreement: float

"""Every pixel: rectification, disparity, depth, cloud."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..core.short_repr import Record
from .arrays import Bools, Float32s, Float64s, Int16s, Uint8s, Uint16s, Uint32s


@dataclass(frozen=True)
class PolarRows(Record):
    """Half epipolar lines of one image as the rows of a rectified image: row k is the ray at `angles[k]` from the epipole."""

    epipole: Float64s
    """(2,) pixels of the frame, finite."""
    angles: Float64s
    """(rows,) radians, strictly monotone."""
    direction: int
    """1 or -1."""
    start_px: float
    """A point at distance r from the epipole has rectified x = direction * r - start_px."""


@dataclass(frozen=True)
class GroundOfPair(Record):
    """The ground as both frames of a pair see it.  Homographies lead from frame 1 to frame 2; their third coordinate, and that of
    their inverse, is positive before both cameras."""

    homography: Float64s
    """(3, 3) of points on the ground."""
    beneath: Float64s
    """(3, 3) of points on a plane under it: nothing is searched deeper."""
    inverse_depth1: Float64s
    inverse_depth2: Float64s
    """(3,) times (x, y, 1): inverse depth of the ground in either frame, negative above the horizon."""


@dataclass(frozen=True)
class Rectification(Record):
    """How the two images of a pair are resampled so that a point lies on the same row in both.

    Use `rectification.warping` to move points and images; nothing else asks which method it was.
    """

    method: str
    """Which `rectification` made it."""
    reason: str
    """Why this method."""
    H1: Float64s | None
    H2: Float64s | None
    """(3, 3) frame pixels to rectified pixels; None for polar."""
    size1: tuple[int, int]
    """(width, height) of the rectified images; heights are equal."""
    size2: tuple[int, int]
    disparity_min_px: float
    """Range to search, with margins..."""
    disparity_max_px: float
    """...and its end."""
    vertical_px: float
    """Mean row difference of the inliers..."""
    vertical_p95_px: float
    """...and that which 95 % of them keep."""
    angle_deg: float
    """Convergence angle, nan if unknown."""
    polar1: PolarRows | None = None
    polar2: PolarRows | None = None
    """The rows of a polar rectification, else None."""
    scale: float = 1.0
    """Rectified pixels for each pixel of the frames (median)."""
    anisotropy: float = 1.0
    """Longest over shortest side of a resampled pixel, 95 % over both images."""
    kept1: float = 1.0
    """Share of each frame inside its rectified image."""
    kept2: float = 1.0
    depth_resolution: float = float("nan")
    """Median depth error of one pixel of disparity over depth, nan without cameras."""
    warnings: tuple[str, ...] = ()
    """What weakens the result without making it useless."""
    verified: str = "sparse"
    """Who says that the rows are right: "sparse" (matches of keypoints) or "dense" (the cameras, and dense matches; see
    `stereo.row_verification`)."""
    row_share: float = float("nan")
    """Of rows that dense matches verified: share of the common area whose pixels find their partners on them..."""
    row_chance: float = float("nan")
    """...and on rows shifted by eight."""
    row_error_px: float = float("nan")
    """By how many rows the images seem to be off."""
    ground: GroundOfPair | None = None
    """Where the ground lies in both frames, if that is known."""
    bend1: Float64s | None = None
    bend2: Float64s | None = None
    """(6,) fx fy cx cy k1 k2 of what a lens still bends in its frame (`core.residual_distortion`), whose pixels count as
    straightened; None where nothing is bent."""


@dataclass(frozen=True)
class RowMatches(Record):
    """Matches of a pair that were measured across its rows, one for each part of the common view (`stereo.y_parallax`)."""

    x1: Float64s
    x2: Float64s
    """(n, 2) pixels of frame 1 and of frame 2."""
    sigma_px: Float64s
    """(n,) standard deviation of their distance to the epipolar line, pixels."""


@dataclass(frozen=True)
class Disparity(Record):
    """Dense matches of a rectified pair, left-right checked; x2 = x1 - d on the same row."""

    left: Int16s
    """(h, w1) sixteenths of a pixel relative to `offset_px`, on the rectified left image; INVALID where unknown."""
    right: Int16s
    """(h, w2) the same on the rectified right image (x1 = x2 + d)."""
    confidence_left: Uint8s
    confidence_right: Uint8s
    """(h, w1), (h, w2), 0 to 255."""
    offset_px: int
    """Added to both."""
    density: float
    """Share of the common valid area with a value."""
    rows: RowMatches | None = None


INVALID = -32768
"""The value of `Disparity.left` and `.right` where nothing is known."""


MOST_PARTNERS = 32
"""Of a depth map: `support` has a bit for each."""


@dataclass(frozen=True)
class DepthMap(Record):
    """Depth of one view, from all its pairs or refined over all views around it."""

    depth: Float32s
    """(h, w) along the optical axis, in world lengths; nan where unknown."""
    sigma: Float32s
    """(h, w) its standard deviation."""
    slope_x: Float32s
    slope_y: Float32s
    """(h, w) change of 1 / depth per pixel in x and in y: the local plane."""
    support: Uint32s
    """(h, w) bit k set where the pair with `partners[k]` supports the depth."""
    partners: tuple[str, ...]
    """The other cameras of its pairs."""
    sure: Bools
    """(h, w) False where the depth must not be believed unless another view's depth agrees."""
    left_out: tuple[str, ...] = ()
    """The other cameras of pairs that would have been too many."""
    apart_px: Mapping[str, float] = field(default_factory=dict)
    """For each two partners, as `left--right`: by how many pixels the depths that they give differ as a whole."""

    def support_of(self, partners: tuple[str, ...]) -> Uint32s:
        """(h, w) `support` with the bits of other partners; one that is not among them is left out."""
        support, place = np.zeros_like(self.support), {name: k for k, name in enumerate(partners)}
        for k, name in enumerate(self.partners):
            if name in place:
                support |= (self.support >> np.uint32(k) & np.uint32(1)) << np.uint32(place[name])
        return support


@dataclass(frozen=True)
class Cloud(Record):
    """Points of a scene with what is known of each."""

    points: Float64s
    """(n, 3)"""
    normals: Float32s
    """(n, 3) of unit length, toward the cameras."""
    colors: Uint8s
    """(n, 3) RGB."""
    confidence: Float32s
    """(n,) 0 to 1."""
    views: Uint16s
    """(n,) cameras that support the point."""
    sigma_mm: Float32s
    """(n,) standard deviation along the ray of the nearest camera that has the point, millimetres."""
    given: Mapping[str, int] = field(default_factory=dict)
    """Samples that each camera's view has given, before they were merged; empty of a cloud that was read from its file."""
    misfits: Mapping[str, float] = field(default_factory=dict)
    """Of the samples of each camera's view, the median of their standard deviation as views and surroundings show it over the
    one that `noise_px` lets expect."""
    right: float | None = None
    """Share of the points that is expected to be right: mean confidence; None of a cloud that was read from its file."""

"""Data for every pixel: rectification, disparity, depth, cloud."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..contracts.camera_figures import DepthFigures
from ..contracts.ground_figures import CloudFigures
from ..contracts.pair_figures import DisparityFigures, RectifyFigures
from ..contracts.short_repr import Record
from .arrays import Bools, Float32s, Float64s, Int16s, Uint8s, Uint16s, Uint32s


@dataclass(frozen=True)
class PolarRows(Record):
    """Half epipolar lines of one image as the rows of a rectified image: row k is the ray at `angles[k]` from the epipole."""

    epipole: Float64s
    """(2,) pixels of the frame, finite."""
    angles: Float64s
    """(rows,) radians, strictly monotone."""
    direction: int
    """1 or -1, the sign of x along the rays (see `start_px`)."""
    start_px: float
    """Offset of x: a point at distance r from the epipole has rectified x = direction * r - start_px."""


@dataclass(frozen=True)
class GroundOfPair(Record):
    """The ground as both frames of a pair see it.  Homographies map frame 1 to frame 2; their third coordinate, and that of
    their inverse, is positive for points in front of both cameras."""

    homography: Float64s
    """(3, 3) for points on the ground."""
    beneath: Float64s
    """(3, 3) for points on a plane under the ground, below which nothing is searched."""
    inverse_depth1: Float64s
    inverse_depth2: Float64s
    """(3,) each; the product with (x, y, 1) is the inverse depth of the ground in that frame, negative above the horizon."""


@dataclass(frozen=True)
class Rectification(Record):
    """How the two images of a pair are resampled so that a point lies on the same row in both.

    Use `rectification.warping` to move points and images; no other code depends on the method.
    """

    method: str
    """Name of the method that made it."""
    reason: str
    """Why this method was used."""
    H1: Float64s | None
    H2: Float64s | None
    """(3, 3) frame pixels to rectified pixels; None for polar."""
    size1: tuple[int, int]
    """(width, height) of the rectified images; heights are equal."""
    size2: tuple[int, int]
    disparity_min_px: float
    """Lower end of the disparity range to search, with its margin."""
    disparity_max_px: float
    """Upper end of the disparity range to search, with its margin."""
    vertical_px: float
    """Mean absolute row difference of the inliers."""
    vertical_p95_px: float
    """95th percentile of the absolute row differences of the inliers."""
    angle_deg: float
    """Convergence angle, nan if unknown."""
    polar1: PolarRows | None = None
    polar2: PolarRows | None = None
    """The rows of a polar rectification, else None."""
    scale: float = 1.0
    """Rectified pixels per frame pixel (median)."""
    anisotropy: float = 1.0
    """Longest over shortest side of a resampled pixel, 95th percentile over both images."""
    kept1: float = 1.0
    """Share of each frame (kept1, kept2) inside its rectified image."""
    kept2: float = 1.0
    depth_resolution: float = float("nan")
    """Median relative depth error for a disparity error of one rectified pixel, nan without cameras."""
    warnings: tuple[str, ...] = ()
    """Weaknesses of the result that do not make it useless."""
    verified: str = "sparse"
    """What confirms the rows: "sparse" (keypoint matches) or "dense" (dense matches along the rows that the cameras give, see
    `stereo.row_verification`)."""
    row_share: float = float("nan")
    """If dense matches verified the rows: share of the common area whose pixels find their partners on them."""
    row_chance: float = float("nan")
    """If dense matches verified the rows: the same share on rows shifted by eight, which only chance explains."""
    row_error_px: float = float("nan")
    """If dense matches verified the rows: estimated row offset between the two images, in rows, with sign."""
    ground: GroundOfPair | None = None
    """The ground in both frames, if it is known."""
    bend1: Float64s | None = None
    bend2: Float64s | None = None
    """(6,) fx fy cx cy k1 k2 of the distortion that remains in each frame (`core.residual_distortion`); the rectification
    applies to straightened pixels.  None if there is none."""

    @property
    def figures(self) -> RectifyFigures:
        """What the engine reports of it."""
        return RectifyFigures(
            angle_deg=self.angle_deg,
            vertical_px=self.vertical_px,
            method=self.method,
            verified=self.verified,
            row_share=self.row_share,
            row_chance=self.row_chance,
            row_error_px=self.row_error_px,
        )


@dataclass(frozen=True)
class RowMatches(Record):
    """Matches of a pair with measured row offsets, one for each part of the common view (`stereo.y_parallax`)."""

    x1: Float64s
    x2: Float64s
    """(n, 2) pixels of frame 1 and of frame 2."""
    sigma_px: Float64s
    """(n,) standard deviation of the distance between match and epipolar line, pixels."""


@dataclass(frozen=True)
class Disparity(Record):
    """Dense matches of a rectified pair, left-right checked; x2 = x1 - d on the same row."""

    left: Int16s
    """(h, w1) disparity on the rectified left image, sixteenths of a pixel relative to `offset_px`; INVALID where unknown."""
    right: Int16s
    """(h, w2) the same on the rectified right image (x1 = x2 + d)."""
    confidence_left: Uint8s
    confidence_right: Uint8s
    """(h, w1) and (h, w2), 0 to 255."""
    offset_px: int
    """Pixels to add to both disparities."""
    density: float
    """Share of the common valid area that has a disparity."""
    rows: RowMatches | None = None

    @property
    def figures(self) -> DisparityFigures:
        """What the engine reports of it."""
        return DisparityFigures(density=self.density)


INVALID = -32768
"""The value of `Disparity.left` and `.right` where nothing is known."""


MOST_PARTNERS = 32
"""Most partners of a depth map: `support` has a bit for each."""


@dataclass(frozen=True)
class DepthMap(Record):
    """Depth of one view, from all its pairs or refined over all views around it."""

    depth: Float32s
    """(h, w) depth along the optical axis, in world lengths; nan where unknown."""
    sigma: Float32s
    """(h, w) standard deviation of the depth."""
    slope_x: Float32s
    slope_y: Float32s
    """(h, w) change of 1 / depth per pixel in x and in y: the local plane."""
    support: Uint32s
    """(h, w) bit k set where the pair with `partners[k]` supports the depth."""
    partners: tuple[str, ...]
    """Ids of the other cameras of its pairs; for refined depth, of the views that it was compared with."""
    sure: Bools
    """(h, w) False where the depth may be used only if another view's depth agrees."""
    left_out: tuple[str, ...] = ()
    """Ids of the other cameras of pairs that were not used because there were too many."""
    offset_px: Mapping[str, float] = field(default_factory=dict)
    """Overall difference in pixels between the depths that two partners give, by "left--right" of the partners."""

    @property
    def figures(self) -> DepthFigures:
        """What the engine reports of it."""
        return DepthFigures(offset_px=self.offset_px)

    def support_of(self, partners: tuple[str, ...]) -> Uint32s:
        """(h, w) `support` with the bits of other partners; a partner that is not among them is left out."""
        positions = {name: k for k, name in enumerate(partners)}
        support = np.zeros_like(self.support)
        for k, name in enumerate(self.partners):
            if name in positions:
                # bit k, moved to the partner's new place
                bit = self.support >> np.uint32(k) & np.uint32(1)
                support |= bit << np.uint32(positions[name])
        return support


@dataclass(frozen=True)
class Cloud(Record):
    """Points of a scene with the properties of each."""

    points: Float64s
    """(n, 3)"""
    normals: Float32s
    """(n, 3) of unit length, toward the cameras."""
    colors: Uint8s
    """(n, 3) RGB."""
    confidence: Float32s
    """(n,) probability that the point is right, 0 to 1."""
    views: Uint16s
    """(n,) number of cameras that support the point."""
    sigma_mm: Float32s
    """(n,) standard deviation along the ray of the nearest camera that sees the point, millimetres."""
    sample_counts: Mapping[str, int] = field(default_factory=dict)
    """Number of samples from each camera's view before merging; empty for a cloud that was read from its file."""
    misfits: Mapping[str, float] = field(default_factory=dict)
    """By view, the median over its samples of their standard deviation, as other views and neighbouring pixels show it,
    divided by the one expected from `noise_px`."""
    correct_share: float | None = None
    """Share of the points that is expected to be right: mean confidence; None for a cloud that was read from its file."""

    @property
    def figures(self) -> CloudFigures:
        """What the engine reports of it."""
        lowest, highest = self.points.min(axis=0), self.points.max(axis=0)
        return CloudFigures(
            points=len(self.points),
            bounds=(tuple(lowest.tolist()), tuple(highest.tolist())),
            sample_counts=self.sample_counts,
            misfits=self.misfits,
            correct_share=self.correct_share,
        )

"""Two cameras: matches, geometry, and what the site says of a pair."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeVar

from ..core.short_repr import Record
from .arrays import Bools, Float32s, Float64s, Int32s, Int64s
from .views import View


@dataclass(frozen=True)
class Matches(Record):
    """Point correspondences of a pair, before any geometry."""

    x1: Float64s
    x2: Float64s
    """(n, 2) pixels of the left and of the right frame."""
    i1: Int32s | None
    i2: Int32s | None
    """(n,) rows in the left and in the right `Features`, None where the points are no keypoints of these."""
    probability: Float32s
    """(n,)"""
    affine: Float64s | None
    """(n, 2, 2) the local map of image 1 onto image 2 by the two keypoints' frames, None without keypoints."""
    view1: View
    view2: View
    matcher: str = ""
    """Who found them."""
    tilted: bool = False
    """The views compressed in x were used too."""
    nights: int = 1
    """So many nights' matches are put together here; of several they have no keypoints."""
    searched: tuple[object, ...] = field(default=(), compare=False, repr=False, metadata={"transient": True})
    """What the matcher searched and geometry may use again; no part of the artifact, and found again where it is missing."""


@dataclass(frozen=True)
class Geometry(Record):
    """Two-view geometry of a pair and what supports it."""

    F: Float64s
    """(3, 3) of unit norm."""
    x1: Float64s
    """(n, 2) the inliers (guided matches); these, i1, i2 and probability as in `Matches`."""
    x2: Float64s
    i1: Int32s | None
    i2: Int32s | None
    probability: Float32s
    view1: View
    view2: View
    cam2_R_cam1: Float64s | None
    """(3, 3) relative rotation where both K are known (x_2 ~ R x_1 + t), else None."""
    cam2_t_cam1: Float64s | None
    """(3,) of unit length, or None."""
    matches: int
    """How many there were before geometry."""
    inliers: int
    """How many support F."""
    model: str
    """"F" or "E": what was kept."""
    epipolar_px: float
    """Median symmetric epipolar distance of the inliers."""
    angle_deg: float
    """Median angle between the rays of the inliers, nan without relative pose."""
    homography_share: float
    """Share of the inliers that one homography explains too."""
    score: float
    """Log odds that the pair is right, from what follows (see `twoview.pair_score`)."""
    good_probability: float
    """The score as a probability."""
    distinct_cells: int = 0
    """Cells of a 12 x 8 grid with distinctive matches."""
    distinct_share: float = 0.0
    """Share of the inliers without a look-alike in their own image."""
    agreement: float = 0.0
    """Share of the clear matches found without geometry that F explains."""
    half_rotation_deg: float = float("nan")
    """Angle between the rotations of the two halves of the inliers; nan without K."""
    stretch: float = 0.0
    """Median log ratio of the axes of the local affine maps."""
    rival_inliers: int = 0
    """How many matches agree with the best other hypothesis (see `twoview.ambiguity`)..."""
    rival_elsewhere: int = 0
    """...and how many of those off the epipolar lines, or with another step along a row..."""
    rival_turned_deg: float = float("nan")
    """...whose rotation is so far from the accepted one; nan where no rival was looked for."""
    noise_px: Float32s | None = None
    """(n,) standard deviation of the distance of each inlier to its epipolar line, None where nobody knows."""
    lens1: Float64s | None = None
    lens2: Float64s | None = None
    """(3, 3) intrinsics that go with F where they had to be guessed, else None."""
    implausibility: float = float("nan")
    """How far these are from what cameras have, in squared standard deviations; nan where they are known."""
    warnings: tuple[str, ...] = ()
    """Named degenerate cases that did not reject the pair."""


Found = TypeVar("Found", Matches, Geometry)


def at_rows(found: Found, rows: Bools | Int64s) -> Found:
    """The same with some of its matches alone.  rows: (n,) bool, or their numbers."""
    names = ("x1", "x2", "i1", "i2", "probability", "affine", "noise_px")
    return replace(found, **{name: of[rows] for name in names if (of := getattr(found, name, None)) is not None})


@dataclass(frozen=True)
class Overlap(Record):
    """Evidence that two views share ground: one row for each pair of cameras, left before right."""

    cameras: tuple[str, ...]
    pairs: Int32s
    """(m, 2) positions in `cameras`."""
    angle_deg: Float64s
    """(m,) convergence angle, nan when poses are unknown."""
    shared: Float64s
    """(m,) 0 to 1: share of one view that the other sees (poses), or similarity of appearance."""
    source: str
    """"poses" or "appearance"."""

"""Data of two cameras: matches, geometry, and overlap."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeVar

from ..contracts.pair_figures import GeometryFigures, MatchesFigures
from ..contracts.short_repr import Record
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
    """(n,) rows in the left and in the right `Features`, None if the points are not keypoints of these."""
    probability: Float32s
    """(n,) probability that the match is right."""
    affine: Float64s | None
    """(n, 2, 2) local affine map from image 1 to image 2 by the two keypoints' frames, None without keypoints."""
    view1: View
    view2: View
    matcher: str = ""
    """Name of the matcher."""
    tilted: bool = False
    """Whether the views compressed in x were used, too."""
    nights: int = 1
    """Number of nights whose matches are pooled here; matches of several nights have no keypoints."""
    searched: tuple[object, ...] = field(default=(), compare=False, repr=False, metadata={"transient": True})
    """Search results of the matcher that geometry may reuse; not part of the artifact, and computed again if missing."""

    @property
    def figures(self) -> MatchesFigures:
        """What the engine reports of them."""
        return MatchesFigures(matches=len(self.x1))


@dataclass(frozen=True)
class Geometry(Record):
    """Two-view geometry of a pair and the evidence for it."""

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
    """(3,) translation of unit length, or None."""
    matches: int
    """Number of matches before geometry."""
    inliers: int
    """Number of matches that support F."""
    model: str
    """The model that was kept: "F" or "E"."""
    epipolar_px: float
    """Median symmetric epipolar distance of the inliers."""
    angle_deg: float
    """Median angle between the rays of the inliers, nan without relative pose."""
    homography_share: float
    """Share of the inliers that one homography explains too."""
    score: float
    """Log odds that the pair is right, from the fields below (see `twoview.pair_score`)."""
    good_probability: float
    """The score as a probability."""
    distinct_cells: int = 0
    """Number of cells of a 12 x 8 grid with distinctive matches."""
    distinct_share: float = 0.0
    """Share of the inliers without a look-alike in their own image."""
    agreement: float = 0.0
    """Share of the clear matches, found without geometry, that F explains."""
    half_rotation_deg: float = float("nan")
    """Angle between the rotations of the two halves of the inliers; nan without K."""
    stretch: float = 0.0
    """Median log ratio of the axes of the local affine maps."""
    rival_inliers: int = 0
    """Number of matches that agree with the best rival pose (see `twoview.rival_search`)."""
    rival_elsewhere: int = 0
    """Number of the rival's matches off the epipolar lines, or with another step along a row."""
    rival_turned_deg: float = float("nan")
    """Angle between the rotation of those matches and the accepted one; nan if no rival was looked for."""
    noise_px: Float32s | None = None
    """(n,) standard deviation of the distance of each inlier to its epipolar line, None if unknown."""
    lens1: Float64s | None = None
    lens2: Float64s | None = None
    """(3, 3) intrinsics that were estimated with F if a lens was not known, else None."""
    implausibility: float = float("nan")
    """Deviation of these intrinsics from those of usual cameras, in squared standard deviations; nan if they are known."""
    warnings: tuple[str, ...] = ()
    """Degenerate cases that did not reject the pair, in words."""

    @property
    def figures(self) -> GeometryFigures:
        """What the engine reports of it."""
        return GeometryFigures(
            inliers=len(self.x1),
            angle_deg=self.angle_deg,
            epipolar_px=self.epipolar_px,
            probability=self.good_probability,
        )


Found = TypeVar("Found", Matches, Geometry)


def at_rows(found: Found, rows: Bools | Int64s) -> Found:
    """The matches or geometry, with some of its matches only.  rows: (n,) bool, or row numbers."""
    kept = {}
    for name in ("x1", "x2", "i1", "i2", "probability", "affine", "noise_px"):
        # only geometry has `noise_px`; matches without keypoints have no rows and no affine maps
        values = getattr(found, name, None)
        if values is not None:
            kept[name] = values[rows]
    return replace(found, **kept)


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
    """"poses", "appearance" or "mixed"."""

"""What the vision reports of a pair of cameras.

For a rejected pair, these are the figures behind the rejection that have the same names; all others are None.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .short_repr import Record


@dataclass(frozen=True)
class PairsFigures(Record):
    """The pair graph, or the dense pairs."""

    pairs: tuple[tuple[str, str], ...] = ()
    crowded: Mapping[str, str] = field(default_factory=dict)
    """Notes by camera."""
    angles: Mapping[str, float] = field(default_factory=dict)
    """By kept pair, as `left--right`: degrees between the two views, where poses tell it."""


@dataclass(frozen=True)
class MatchesFigures(Record):
    """Matches of a pair."""

    matches: int | None = None


@dataclass(frozen=True)
class GeometryFigures(Record):
    """The epipolar geometry of a pair."""

    inliers: int | None = None
    """Number of matches after the guided search."""
    angle_deg: float | None = None
    """Median angle between the rays of the inliers; None without relative pose."""
    epipolar_px: float | None = None
    """Median symmetric epipolar distance of the inliers."""
    probability: float | None = None
    """Probability that the pair is right."""


@dataclass(frozen=True)
class RectifyFigures(Record):
    """The rectification of a pair."""

    angle_deg: float | None = None
    """Convergence angle; None if unknown."""
    vertical_px: float | None = None
    """Mean absolute row difference of the inliers."""
    method: str | None = None
    """Name of the method that made it."""
    verified: str | None = None
    """What confirms the rows: "sparse" (keypoint matches) or "dense" (dense matches along the rows that the cameras give)."""
    row_share: float | None = None
    """If dense matches were to verify the rows: share of the common area whose pixels find their partners on them."""
    row_chance: float | None = None
    """The same share on rows shifted by eight, which only chance explains."""
    row_error_px: float | None = None
    """Estimated row offset between the two images, in rows, with sign."""


@dataclass(frozen=True)
class DisparityFigures(Record):
    """Dense matches of a pair."""

    density: float | None = None
    """Share of the common valid area that has a disparity."""


@dataclass(frozen=True)
class PairStagesFigures(DisparityFigures, RectifyFigures, GeometryFigures, MatchesFigures):
    """The figures of all pair stages, as run.json has them of each pair; `angle_deg` is that of the last stage that has it."""

"""Observations: where cameras saw things that move, or that have an identity of their own; and the poses that these determine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..contracts.observation_figures import ObservedFigures
from ..contracts.short_repr import Record
from .arrays import Float64s, Int32s
from .captured import Placement


@dataclass(frozen=True)
class Observations(Record):
    """Rows of camera, time, thing, x, y, sigma: a lamp, the corners of a board, a drone, a point that somebody clicked."""

    cameras: tuple[str, ...]
    """Ids of the cameras that `camera` counts."""
    things: tuple[str, ...]
    """Ids of the things that `thing` counts; a file without ids has one thing."""
    camera: Int32s
    """(n,) int32."""
    thing: Int32s
    """(n,) int32."""
    time: Float64s
    """(n,) float64 by the camera's own clock; nan: the thing does not move."""
    xy: Float64s
    """(n, 2) float64 pixels of the picture as captured, with its distortion."""
    sigma_px: Float64s
    """(n,) float64 standard deviation of a coordinate, nan where none is stated."""
    time_unit: str = "s"
    """"s", or "frames" where the file counts frames."""


@dataclass(frozen=True)
class ThingSurvey(Record):
    """What is known of the things themselves: their places, or lengths between them."""

    things: tuple[str, ...] = ()
    """Ids of the things that the rows count."""
    thing: Int32s = field(default_factory=lambda: np.zeros(0, np.int32))
    """(n,) int32, of each known place."""
    time: Float64s = field(default_factory=lambda: np.zeros(0))
    """(n,) float64 in the unit of the observations, by the clock of the first camera up to an offset; nan: it does not move."""
    position: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    """(n, 3) float64 metres, world."""
    sigma_m: Float64s = field(default_factory=lambda: np.zeros(0))
    """(n,) float64, nan where none is stated."""
    lengths: tuple[tuple[int, int, float], ...] = ()
    """Rows of thing, thing, distance between them at any one time in metres."""
    crs: str = ""
    """The coordinate system of the positions, "" if it is local."""


@dataclass(frozen=True)
class Sightings(Record):
    """What was found in recordings."""

    observations: Observations
    survey: ThingSurvey
    """Lengths on the board; nothing for a lamp."""
    pictures: Mapping[str, bytes]
    """JPEG by camera: what was found, drawn over a picture of the recording."""
    messages: tuple[str, ...]
    """For the operator."""


@dataclass(frozen=True)
class ObservedPoses(ObservedFigures):
    """Poses from observations, with standard deviations, as evidence for `poses.solve_poses`."""

    placements: Mapping[str, Placement]
    """Of the cameras that were placed, by id."""
    focal_scales: Mapping[str, float] = field(default_factory=dict)
    """Factor of the stated focal length of each camera whose lens was solved, too."""
    track: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3) float64 places of the things that the cameras determine, world, in the order of thing and time."""

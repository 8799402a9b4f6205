"""Observations: where cameras saw things that move, or that have an identity of their own; and the poses that these determine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..contracts import stated
from ..contracts.observation_figures import ObservedFigures
from ..contracts.short_repr import Record
from .arrays import Float64s, Int32s
from .captured import Placement

Observations = stated.Observations[Int32s, Float64s]
"""Where cameras saw things, as arrays."""


@dataclass(frozen=True)
class ThingSurvey(stated.ThingSurvey[Int32s, Float64s]):
    """What is known of the things themselves, as arrays; without any, only lengths between them."""

    thing: Int32s = field(default_factory=lambda: np.zeros(0, np.int32))
    time: Float64s = field(default_factory=lambda: np.zeros(0))
    position: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    sigma_m: Float64s = field(default_factory=lambda: np.zeros(0))


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
    """Of the cameras that were placed, by id; standard deviations are those against each other, without what the survey leaves
    uncertain about all of them together (`cameras` has both)."""
    focal_scales: Mapping[str, float] = field(default_factory=dict)
    """Factor of the stated focal length of each camera whose lens was solved, too."""
    track: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3) float64 places of the things that the cameras determine, world, in the order of thing and time."""

"""State of a camera, compared with the reference when it was pinned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..contracts.short_repr import Record
from .arrays import Float64s


@dataclass(frozen=True)
class CameraHealth(Record):
    """State of a camera."""

    state: str
    """"ok"; "shifted": turned slightly, by a known amount; "moved"; "obscured": too dark, covered or out of focus;
    "wrong-scene": another place."""
    text: str
    """The finding, in one line."""
    remedy: str = ""
    """What to do about it, "" if nothing."""
    figures: Mapping[str, float | str] = field(default_factory=dict)
    """Measured values by name; finite."""
    expected: Mapping[str, float | str] = field(default_factory=dict)
    """Limits of figures of the same names, if there are any."""
    corrected: bool = False
    """The pose is that of the reference, turned by `turn`."""
    turn: Float64s | None = None
    """(3, 3) rotation from the camera's axes in the reference to tonight's; None if it was not measured."""
    homography: Float64s | None = None
    """(3, 3) pixels of the reference's frame to those of tonight's; None if it was not measured."""


@dataclass(frozen=True)
class Usual(Record):
    """Measurements of a camera on earlier nights against the same reference, oldest first."""

    shift_x_px: Float64s = field(default_factory=lambda: np.zeros(0))
    shift_y_px: Float64s = field(default_factory=lambda: np.zeros(0))
    """(n,) shift of the picture in x and in y, pixels."""
    roll_deg: Float64s = field(default_factory=lambda: np.zeros(0))
    """(n,) turn about the optical axis, degrees."""

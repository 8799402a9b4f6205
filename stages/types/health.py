"""How a camera is, compared with what it was when the reference was pinned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..core.short_repr import Record
from .arrays import Float64s


@dataclass(frozen=True)
class CameraHealth(Record):
    """What became of a camera."""

    state: str
    """"ok"; "shifted": turned by little, and by how much is known; "moved"; "obscured": too dark, covered or out of focus;
    "wrong-scene": another place."""
    text: str
    """In one line."""
    remedy: str = ""
    """What to do about it, "" where nothing is to be done."""
    figures: Mapping[str, float | str] = field(default_factory=dict)
    """What was measured, by name; finite."""
    expected: Mapping[str, float | str] = field(default_factory=dict)
    """Limits of figures of the same names, where there are such."""
    corrected: bool = False
    """The pose is that of the reference, turned by `turn`."""
    turn: Float64s | None = None
    """(3, 3) rotation from the camera's axes in the reference to those of tonight; None where it was not measured."""
    homography: Float64s | None = None
    """(3, 3) pixels of the reference's frame to those of tonight's; None where it was not measured."""


@dataclass(frozen=True)
class Usual(Record):
    """What earlier nights measured of a camera against the same reference, oldest first."""

    shift_x_px: Float64s = field(default_factory=lambda: np.zeros(0))
    shift_y_px: Float64s = field(default_factory=lambda: np.zeros(0))
    """(n,) shift of the picture in x and in y, pixels."""
    roll_deg: Float64s = field(default_factory=lambda: np.zeros(0))
    """(n,) turn about the optical axis, degrees."""

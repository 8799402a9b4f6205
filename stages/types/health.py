"""State of a camera, compared with the reference when it was pinned."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..contracts import camera_figures
from ..contracts.camera_figures import ExaminedHealth
from .arrays import Float64s


@dataclass(frozen=True)
class CameraHealth(ExaminedHealth):
    """State of a camera, and its motion."""

    turn: Float64s | None = None
    """(3, 3) rotation from the camera's axes in the reference to tonight's; None if it was not measured."""
    homography: Float64s | None = None
    """(3, 3) pixels of the reference's frame to those of tonight's; None if it was not measured."""


@dataclass(frozen=True)
class ShiftHistory(camera_figures.ShiftHistory[Float64s]):
    """Shifts of a camera on earlier nights, as arrays; empty without any."""

    shift_x_px: Float64s = field(default_factory=lambda: np.zeros(0))
    shift_y_px: Float64s = field(default_factory=lambda: np.zeros(0))
    roll_deg: Float64s = field(default_factory=lambda: np.zeros(0))

"""Check, to a tenth of a pixel, whether the stated cameras fit the row offsets that dense matching measures."""

from __future__ import annotations

from collections.abc import Mapping

from .orientation.calibration_check import check_rows
from .types import CalibrationCheck, Disparity, Pair, Poses


def check_calibration(poses: Poses, disparities: Mapping[Pair, Disparity]) -> CalibrationCheck:
    """Compare the stated cameras of the main component with the row offsets of all their dense pairs.

    The result has 0 pairs if none has enough measurements.
    """
    stated = {}
    for name, camera in poses.main_cameras().items():
        # Solved poses and focal lengths state nothing: they fit the matches by themselves.
        if poses.sources.get(name) != "solved" and name not in poses.focals:
            stated[name] = camera
    rows = {}
    for pair, disparity in disparities.items():
        if disparity.rows is not None and set(pair) <= set(stated):
            rows[pair] = disparity.rows
    return check_rows(stated, rows) or CalibrationCheck(matches=0, pairs=0, confirmed=False, misfit=1.0)

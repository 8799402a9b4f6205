"""Check, to a tenth of a pixel, whether the stated cameras fit the row offsets that dense matching measures."""

from __future__ import annotations

from collections.abc import Mapping

from .orientation.calibration_check import check_rows
from .types import CalibrationCheck, Disparity, Pair, Poses


def check_calibration(poses: Poses, disparities: Mapping[Pair, Disparity]) -> CalibrationCheck:
    """Compare the stated cameras of the main component with the row offsets of all their dense pairs.

    The result has 0 pairs if none has enough measurements.
    """
    stated = {n: c for n, c in poses.main_cameras().items() if poses.sources.get(n) != "solved" and n not in poses.focals}
    rows = {pair: d.rows for pair, d in disparities.items() if d.rows is not None and set(pair) <= set(stated)}
    return check_rows(stated, rows) or CalibrationCheck(matches=0, pairs=0, confirmed=False, misfit=1.0)

"""Stated poses that are off by what surveys usually leave are put right by the matches.

A pose without standard deviations counts as exact.  On real sites it is off by hundredths of a degree and by millimetres all the
same, which costs partners beside the rows, and surfaces where pairs meet.  So poses within such errors replace the stated ones
where they bring matches that third cameras confirm back to where the pairs' own geometry has them.  Such small changes explain
neither look-alikes nor a wrong lens nor a camera that was moved: these are left to the checks of stated poses.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..core.epipolar import triangulate_depth
from ..types import CalibrationCheck, Camera, Geometry, Pair
from .calibration_check import check_calibration, misfit_without_cause
from .pose_check import PoseConstraints, Sigma
from .pose_prior_adjustment import adjust_within_priors

USUAL_DEG, USUAL_SHARE = 0.03, 5e-4
"""Standard deviations of usual surveys: of rotations, degrees, and of positions, as a share of the distance to what is seen."""
LEAST_GAIN, LEAST_WEIGHT = 0.1, 100.0
"""Better poses lower the misfit by so much, and by so much in all matches together..."""
LEFT = 1.05
"""...to this at most.  Fountain and entry with errors of 0.005 to 0.04 degrees or 5 to 10 mm: from 1.17 to 6.5 to 1.03 at
most; one of 438 faults on twelve rendered scenes, which does little harm, is taken for them."""
MOST_SHARED = 0.8
"""Where a cause that all cameras share, such as longer focal lengths, lowers the misfit by this share of that or more, poses only
hide it (errors of poses 0.04 to 0.72; focal lengths 0.5 and 1.5 % too long 0.93 and 1.25)."""
_POSES = ("", "turned", "moved")
"""Causes of a contradiction that are poses."""


def put_right(
    cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]
) -> tuple[dict[str, Camera], CalibrationCheck | None]:
    """Better cameras within the usual errors, or the same, and what the check of the calibration says of them.

    Parameters
    ----------
    cameras : by id, as stated.
    geometries : of all pairs.
    """
    stated, found = dict(cameras), check_calibration(cameras, geometries)
    if found is None or not found.confirmed or found.misfit < 1 + LEAST_GAIN or found.cause not in _POSES:
        return stated, found
    seen = PoseConstraints.of(tuple(cameras), geometries).pairs
    better = adjust_within_priors(cameras, _usual(cameras, seen), seen).cameras
    left = check_calibration(better, geometries)
    if left is None or left.misfit > LEFT:
        return stated, found
    gain = found.misfit - left.misfit
    if gain < LEAST_GAIN or gain * found.matches < LEAST_WEIGHT:
        return stated, found
    shared = found.misfit - misfit_without_cause(cameras, geometries)
    return (better, left) if shared < MOST_SHARED * gain else (stated, found)


def _usual(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> dict[str, Sigma]:
    """The usual errors of cameras that see something, by the distance to that."""
    found: dict[str, list[float]] = {}
    for pair, geometry in geometries.items():
        one, other = (cameras[name] for name in pair)
        for name, depth in (
            (pair[0], triangulate_depth(one, other, geometry.x1, geometry.x2)[0]),
            (pair[1], triangulate_depth(other, one, geometry.x2, geometry.x1)[0]),
        ):
            found.setdefault(name, []).extend(depth[depth > 0])
    return {name: Sigma(USUAL_SHARE * float(np.median(depths)), USUAL_DEG) for name, depths in found.items() if depths}

"""Correct stated poses by the matches if they are off by no more than surveys usually are.

A pose without standard deviations counts as exact.  On real sites it is still off by hundredths of a degree and by millimetres,
which moves matches off the rows, and displaces surfaces where pairs meet.  So poses within such errors replace the stated ones
if matches that third cameras confirm then fit as well as under the pairs' own geometry.  Such small changes explain neither
look-alikes nor a wrong lens nor a camera that was moved: these are left to the checks of stated poses.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..core.epipolar import triangulate_depth
from ..types import CalibrationCheck, Camera, Geometry, Pair
from .calibration_check import check_calibration, misfit_without_cause
from .pose_check import PoseConstraints, Sigma
from .pose_prior_adjustment import adjust_within_priors

TYPICAL_DEG, TYPICAL_SHARE = 0.03, 5e-4
"""Standard deviations of typical surveys: of rotations, degrees, and of positions, as a share of the distance to the scene."""
LEAST_GAIN, LEAST_WEIGHT = 0.1, 100.0
"""Smallest reduction of the misfit by corrected poses, and smallest product of this reduction and the number of matches."""
MOST_MISFIT = 1.05
"""Largest misfit under corrected poses.  Fountain and entry with errors of 0.005 to 0.04 degrees or 5 to 10 mm: from 1.17 to 6.5
down to at most 1.03.  One of 438 faults on twelve rendered scenes, which does little harm, is mistaken for such errors."""
MOST_SHARED = 0.8
"""Poses are not corrected if a cause that all cameras share, such as longer focal lengths, reduces the misfit by this share of
their reduction: they would hide it (errors of poses 0.04 to 0.72; focal lengths 0.5 and 1.5 % too long 0.93 and 1.25)."""
_POSES = ("", "turned", "moved")
"""Causes of a contradiction that concern only poses; "" is no cause."""


def correct_typical_errors(
    cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]
) -> tuple[dict[str, Camera], CalibrationCheck | None]:
    """Cameras corrected within the typical errors, or the stated ones, and the check of the calibration for them.

    Parameters
    ----------
    cameras : by id, as stated.
    geometries : of all pairs.
    """
    stated, check = dict(cameras), check_calibration(cameras, geometries)
    if check is None or not check.confirmed or check.misfit < 1 + LEAST_GAIN or check.cause not in _POSES:
        return stated, check
    pairs = PoseConstraints.of(tuple(cameras), geometries).pairs
    corrected = adjust_within_priors(cameras, _typical_sigmas(cameras, pairs), pairs).cameras
    corrected_check = check_calibration(corrected, geometries)
    if corrected_check is None or corrected_check.misfit > MOST_MISFIT:
        return stated, check
    gain = check.misfit - corrected_check.misfit
    if gain < LEAST_GAIN or gain * check.matches < LEAST_WEIGHT:
        return stated, check
    shared_gain = check.misfit - misfit_without_cause(cameras, geometries)
    return (corrected, corrected_check) if shared_gain < MOST_SHARED * gain else (stated, check)


def _typical_sigmas(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> dict[str, Sigma]:
    """The typical errors of cameras that have matches, from the median distance to their points."""
    camera_depths: dict[str, list[float]] = {}
    for pair, geometry in geometries.items():
        left, right = (cameras[name] for name in pair)
        for name, depth in (
            (pair[0], triangulate_depth(left, right, geometry.x1, geometry.x2)[0]),
            (pair[1], triangulate_depth(right, left, geometry.x2, geometry.x1)[0]),
        ):
            camera_depths.setdefault(name, []).extend(depth[depth > 0])
    return {
        name: Sigma(TYPICAL_SHARE * float(np.median(depths)), TYPICAL_DEG) for name, depths in camera_depths.items() if depths
    }

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

TYPICAL_DEG = 0.03
"""Standard deviation of rotations in typical surveys, degrees."""
TYPICAL_SHARE = 5e-4
"""Standard deviation of positions in typical surveys, as a share of the distance to the scene.  With larger errors, corrections
would also explain look-alikes; with smaller ones, matches stay off their rows."""
LEAST_GAIN = 0.1
"""Smallest reduction of the misfit by corrected poses: a smaller one may be noise."""
LEAST_WEIGHT = 100.0
"""Smallest product of this reduction and the number of matches."""
MOST_MISFIT = 1.05
"""Largest misfit under corrected poses; 1 is that of the matches' own geometry.  With more, other faults are mistaken for such
errors (measured: photographs with errors of 0.005 to 0.04 degrees or 5 to 10 mm fall to at most 1.03)."""
MOST_SHARED = 0.8
"""Poses are not corrected if a cause that all cameras share, such as longer focal lengths, reduces the misfit by this share of
their reduction: they would hide it (measured: errors of poses 0.04 to 0.72, wrong focal lengths 0.93 to 1.25)."""
_POSE_CAUSES = ("", "turned", "moved")
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
    stated = dict(cameras)
    check = check_calibration(cameras, geometries)
    # Is there a misfit that errors of poses can explain?
    if check is None or not check.confirmed or check.misfit < 1 + LEAST_GAIN or check.cause not in _POSE_CAUSES:
        return stated, check

    # Do corrected poses explain it, completely and clearly?
    pairs = PoseConstraints.of(tuple(cameras), geometries).pairs
    corrected = adjust_within_priors(cameras, _typical_sigmas(cameras, pairs), pairs).cameras
    corrected_check = check_calibration(corrected, geometries)
    if corrected_check is None or corrected_check.misfit > MOST_MISFIT:
        return stated, check
    gain = check.misfit - corrected_check.misfit
    if gain < LEAST_GAIN or gain * check.matches < LEAST_WEIGHT:
        return stated, check

    # Does nothing that all cameras share explain it as well?
    shared_gain = check.misfit - misfit_without_cause(cameras, geometries)
    if shared_gain >= MOST_SHARED * gain:
        return stated, check
    return corrected, corrected_check


def _typical_sigmas(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> dict[str, Sigma]:
    """The typical errors of cameras that have matches, from the median distance to their points."""
    depths_of: dict[str, list[float]] = {}
    for pair, geometry in geometries.items():
        left = cameras[pair[0]]
        right = cameras[pair[1]]
        depth1, _ = triangulate_depth(left, right, geometry.x1, geometry.x2)
        depth2, _ = triangulate_depth(right, left, geometry.x2, geometry.x1)
        depths_of.setdefault(pair[0], []).extend(depth1[depth1 > 0])
        depths_of.setdefault(pair[1], []).extend(depth2[depth2 > 0])
    sigmas = {}
    for name, depths in depths_of.items():
        if depths:
            sigmas[name] = Sigma(metres=TYPICAL_SHARE * float(np.median(depths)), degrees=TYPICAL_DEG)
    return sigmas

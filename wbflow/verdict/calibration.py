"""Lenses and poses that the site file states, against the reference and the matches."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from wbflow_stages.contracts.pose_figures import CalibrationCheck

from ..records.findings import Finding, finding
from ..records.record import RunRecord
from .facts import Facts

_CAUSES: Mapping[str, str] = {
    "focal-lengths": "all focal lengths {longer}",
    "pixel-shape": "all horizontal focal lengths {longer}",
    "pixel-height": "all vertical focal lengths {longer}",
    "distortion": "a radial distortion that remains in all pictures (k1 off by {first:+.3f})",
    "distortion-factor": "{factor:.2g} times the stated distortion in all pictures",
    "distortion-of-one": "a radial distortion that remains in the pictures of {cameras} (k1 off by {first:+.3f})",
    "focal-lengths-and-distortion": "all focal lengths {longer} and k1 off by {last:+.3f}",
    "principal-points-corner": "principal points half a pixel less (counted from the first pixel's centre, not from its corner)",
    "principal-points": "all principal points shifted by {percent:.1f} % of the width",
    "headings": "all headings {degrees:.2f} degrees further {way}",
    "rolls": "all cameras rolled by {degrees:.2f} degrees",
    "focal-length": "the focal length of {cameras} {longer}",
    "turned": "{cameras} turned by {degrees:.2f} degrees",
    "moved": "{cameras} moved by {percent:.1f} % of the distance between cameras",
    "exchanged": "the poses of {cameras} exchanged",
    "captures-exchanged": "captures of {cameras} exchanged",
    "positions-exchanged": "the positions of {cameras} exchanged",
    "lenses-exchanged": "the lenses of {cameras} exchanged",
    "axes-exchanged": "positions with x and y exchanged",
    "t-for-positions": "positions that are in fact the t of x = R X + t",
    "rotations-transposed": "rotations that are in fact camera to world, not world to camera",
    "rotations-opengl": "rotations whose y and z axes point the other way (OpenGL)",
    "rotations-transposed-opengl": "rotations that are in fact camera to world, with y and z pointing the other way (OpenGL)",
    "stretched-x": "all positions {longer} along x",
    "stretched-y": "all positions {longer} along y",
    "stretched-z": "all positions {longer} along z",
    "mirrored-x": "positions mirrored in x",
    "mirrored-y": "positions mirrored in y",
    "mirrored-z": "positions mirrored in z",
    "mirrored-frames": "pictures of {cameras} mirrored",
    "upside-down": "pictures of {cameras} upside down",
}
"""Texts for the cause that best explains matches contradicting the stated calibration, by its name in the check."""
_ALL_CAMERAS = {
    "captures-exchanged": "all cameras, each with the next one,",
    "mirrored-frames": "all cameras",
    "upside-down": "all cameras",
}
"""Texts for `cameras` in causes that name no cameras if all are affected."""


def check_calibration(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Does the reference, or do the matches, contradict the lenses and poses that the site file states?"""
    if facts.calibration_change:
        yield finding("calibration-changed", reason=facts.calibration_change)
    check = record.poses.contradiction if record.poses else None
    if check:
        figures = {"misfit": check.misfit, "better": check.better, "off_px": check.off_px}
        remedy = None
        if check.cause == "principal-points-corner":
            remedy = "subtract 0.5 from cx and cy of all cameras"
        yield finding("calibration-contradicted", check.cameras, figures, None, remedy, explanation=_explanation(check))


def _explanation(check: CalibrationCheck) -> str:
    """Return how far the matches are off, and the cause that explains that best."""
    misfit = f"they lie {math.sqrt(check.misfit):.1f} times as far from their epipolar lines as noise explains"
    if not check.cause:
        return f"{misfit}; neither the lenses nor a single camera explain that"
    cause = _cause_text(check)
    if check.sigmas:  # by the row offsets of dense matching
        # half a pixel is a convention, and known exactly; any other amount is the least that explains the rows
        suffix = "" if check.cause == "principal-points-corner" else " or more"
        return f"dense matches are {check.sigmas:.0f} standard deviations off their predicted rows; {cause}{suffix} explain that"
    return f"{misfit}; {cause} would fit {check.better:.1f} times better"


def _cause_text(check: CalibrationCheck) -> str:
    """Fill in the text of a cause; which of the values it needs depends on the meaning of its amount."""
    amount = check.amount or (0.0,)
    size = math.hypot(*amount)
    scale = math.expm1(amount[0])  # scales are given as logarithms
    longer_or_shorter = "longer" if scale > 0 else "shorter"
    return _CAUSES[check.cause].format(
        cameras=" and ".join(check.cameras) or _ALL_CAMERAS.get(check.cause, ""),
        longer=f"{100 * abs(scale):.1f} % {longer_or_shorter}",
        first=amount[0],
        factor=1 + amount[0],
        last=amount[-1],
        percent=100 * size,
        degrees=math.degrees(size),
        way="clockwise" if amount[0] > 0 else "counterclockwise",
    )

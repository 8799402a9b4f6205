"""The best competing pose of a pair, and when it makes the pair ambiguous."""

from __future__ import annotations

from dataclasses import dataclass

RIVAL_SHARE = 0.25
"""Any other pose makes a pair ambiguous if at least this share of the accepted inliers agrees with it."""
TURNED_RIVAL_SHARE = 0.08
"""A pose that is turned far makes a pair ambiguous if at least this share of the accepted inliers agrees with it."""
TURNED_DEG = 20.0
"""A pose is turned far, as the view of another side is, if its rotation differs by more than this, degrees."""
SAME_ROTATION_DEG = 1.0
"""A pose whose rotation differs by less than this, degrees, is not turned: that of the view of another house of a row."""


@dataclass(frozen=True)
class RivalPose:
    """The best competing pose of a pair."""

    inliers: int = 0
    """Number of matches not explained by the accepted geometry that agree with one other pose."""
    elsewhere: int = 0
    """Number of matches off the accepted epipolar lines that agree with one other pose (a shift along them is another depth);
    equals `inliers` if that pose differs in its baseline only: another step along a row, perhaps to its other side."""
    turned_deg: float = 0.0
    """Angle between the accepted rotation and that of the pose of `elsewhere`."""

    def ambiguous(self, inliers: int) -> bool:
        """Whether this pose is as plausible as a geometry with this many inliers.

        A quarter of its inliers suffices for any second pose; a twelfth for one that is turned far: the view of another side.
        """
        if self.elsewhere >= RIVAL_SHARE * inliers:
            return True
        return self.turned_deg > TURNED_DEG and self.elsewhere >= TURNED_RIVAL_SHARE * inliers

"""Dense row verification: does a rectification bring corresponding points to one row?  No keypoints are needed.

Both images are matched at half their size, on the rows as they are and on shifted ones.  If rows correspond, many pixels find a
partner that finds them back; if one image is shifted by a few rows, hardly any do.  So the share of pixels that survive the check
between the two views, against the same share with one image shifted, tells whether the geometry is right, and where it is a
little wrong, by how many rows.  It says nothing of what repeats along the rows.  What matches on the right rows then replaces
keypoints: it gives the net, the crop and the disparity range of the final rectification.

Pavement that repeats matches on shifted rows, too.  But only on the right rows does it lie where other views know the ground."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..rectification.warping import from_rectified
from ..types import Float32s, Float64s, Frame, Rectification
from .consistency import disagreement, within_reach, without_speckles
from .matcher import RectifiedPair, halved
from .patchmatch import match_patchmatch
from .rectified import rectified_pair, with_coarse_range

_BESIDE, _AWAY = 1, 4
"""Rows of the halved images: an error that can be lived with, and one with which nothing should match."""

_SPECKLE_SHARE = 5e-4
"""Smaller pieces than this share of the image match anywhere."""


_SAME_PX = 0.75
"""Disparities of the halved images that differ by no more are those of one surface."""


@dataclass(frozen=True)
class RowAgreement:
    """How many pixels find their partners on the rows as they are, and on shifted ones."""

    share: float
    """Share of the common area that survives the check between the views, at the best of no shift and two rows up or down."""
    chance: float
    """The largest such share with one image shifted by eight rows."""
    row_error_px: float
    """By how many rows of the rectified images they seem to be shifted, with sign."""
    ground: float = 0.0
    """Share of the common area that matches where the ground is known to be, without being led there; 0 if nobody knows it."""
    ground_chance: float = 0.0
    """The largest such share with one image shifted by eight rows."""

    def passed(self, least_share: float, least_ratio: float) -> bool:
        """The rows are right: enough matches on them, and much less on shifted ones."""
        return self.share >= least_share and self.share >= least_ratio * self.chance

    def shows_ground(self, least_share: float, least_ratio: float) -> bool:
        """The same, of what lies on the ground."""
        return self.ground >= least_share and self.ground >= least_ratio * self.ground_chance


def match_rows(pair: RectifiedPair) -> tuple[RowAgreement, Float32s, Float32s]:
    """Match a pair at half its size on its rows and on shifted ones.

    Returns
    -------
    RowAgreement
    disparity : (h / 2, w / 2) float32
        Of the halved left image on the rows as they are, nan where nothing matches.
    confidence : (h / 2, w / 2) float32
    """
    small = halved(pair)
    here, disparity, confidence = _matched(small)
    matched = {shift: _matched(_shifted(small, shift)) for shift in (_BESIDE, -_BESIDE, _AWAY, -_AWAY)}
    above, below, *away = (matched[shift][0] for shift in (-_BESIDE, _BESIDE, _AWAY, -_AWAY))
    error = 2.0 * _BESIDE * (below - above) / max(above + here + below, 1e-9)
    ground, chance = 0.0, 0.0
    if small.prior_left is not None:
        ground = _on_ground(small, small.prior_left, _matched(_shifted(small, 0))[1])
        chance = max(_on_ground(small, small.prior_left, matched[shift][1]) for shift in (_AWAY, -_AWAY))
    return RowAgreement(max(above, here, below), max(away), error, ground, chance), disparity, confidence


def _on_ground(pair: RectifiedPair, ground: Float32s, disparity: Float32s) -> float:
    """Share of the pixels with a possible partner that lie on the ground; ground, disparity: (h, w), nan where unknown."""
    common = within_reach(pair.valid_left, pair.valid_right, pair.disparity_min, pair.disparity_max, -1)
    return float(np.sum(np.abs(disparity - ground) <= _SAME_PX) / max(common.sum(), 1))


def _shifted(pair: RectifiedPair, rows: int) -> RectifiedPair:
    """The pair with its right image moved down by so many rows, and nothing known of where the scene is; rows without a partner
    may not be matched."""
    valid = np.roll(pair.valid_right, rows, axis=0)
    if rows:
        valid[slice(rows) if rows > 0 else slice(rows, None)] = False
    right = np.roll(pair.right, rows, axis=0)
    blind = replace(pair, prior_left=None, prior_right=None, floor_left=None, floor_right=None)
    return replace(blind, right=right, valid_right=valid)


def _matched(pair: RectifiedPair) -> tuple[float, Float32s, Float32s]:
    """Share of the pixels with a possible partner that keep a disparity on which both views agree; that; and its confidence."""
    matches = match_patchmatch(pair)
    common = within_reach(pair.valid_left, pair.valid_right, pair.disparity_min, pair.disparity_max, -1)
    agreed = common & (matches.confidence_left > 0) & (disagreement(matches.left, matches.right, -1) <= 1)
    disparity = np.where(agreed, matches.left, np.float32(np.nan)).astype(np.float32)
    disparity = without_speckles(disparity, max(60, round(_SPECKLE_SHARE * disparity.size)))
    return float(np.isfinite(disparity).sum() / max(common.sum(), 1)), disparity, matches.confidence_left


_MOST_POINTS = 4000


@dataclass(frozen=True)
class RowVerification:
    """What dense matching says of a rectification."""

    rows: RowAgreement
    """Are its rows right?"""
    x1: Float64s
    """(n, 2) pixels of frame 1: some of what matched, evenly spread over it..."""
    x2: Float64s
    """(n, 2) ...and where in frame 2."""
    confidence: Float32s
    """(n,) 0 to 1."""


def verify_rows(left: Frame, right: Frame, rectification: Rectification) -> RowVerification:
    """Match both frames at half their size as `rectification` resamples them."""
    rows, disparity, confidence = match_rows(with_coarse_range(rectified_pair(left, right, rectification)))
    y, x = np.nonzero(np.isfinite(disparity))
    some = slice(None, None, max(1, len(x) // _MOST_POINTS))
    y, x = y[some], x[some]
    at1 = np.column_stack([2 * x + 0.5, 2 * y + 0.5])
    at2 = at1 - np.column_stack([2 * disparity[y, x].astype(np.float64), np.zeros(len(x))])
    x1, x2 = from_rectified(rectification, 1, at1), from_rectified(rectification, 2, at2)
    return RowVerification(rows, x1, x2, confidence[y, x])

"""Dense row verification: does a rectification bring corresponding points to one row?  No keypoints are needed.

Both images are matched at half their size, on the rows as they are and on rows shifted by eight.  If rows correspond, many pixels
find a partner that finds them back; on shifted rows only chance does that.  Chance differs between scenes and within an image:
noise, faint walls and repeated stones match anywhere.  So each cell of the image is compared with itself: on wrong rows the given
ones match most often in a third of the cells, one of three, and on right rows in nearly all.  A likelihood ratio sums that up.

Pavement that repeats matches on shifted rows, too.  But only on the right rows does it lie where other views know the ground:
what lies there is counted in the same way.  What matches on the right rows then replaces keypoints: it gives the net, the crop
and the disparity range of the final rectification.  Two rows up or down show a small error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..rectification.warping import from_rectified
from ..types import Bools, Float32s, Float64s, Frame, Int64s, Rectification
from .consistency import cross_checked
from .matcher import RectifiedPair, halved
from .patchmatch import match_patchmatch
from .rectified import rectified_pair, with_coarse_range

_BESIDE, _AWAY = 1, 4
"""Rows of the halved images: an error that can be lived with, and one with which nothing should match."""
_SPECKLE_SHARE = 5e-4
"""Smaller pieces than this share of the image match anywhere."""
_SAME_PX = 0.75
"""Disparities of the halved images that differ by no more are those of one surface."""
_ACROSS, _SMALLEST, _LARGEST = 12, 12, 32
"""Cells in a row of the halved images, and the least and largest side of one, pixels: several windows of the matcher, whose
results hang together, and in pictures of 320 pixels, too, enough cells to decide (an apron: 5 of 7 right pairs, 2 with 32)."""
_IN_COMMON, _DIFFERENT = 0.3, 0.1
"""Least share of a cell that both images show, and by how much of that the given rows and the shifted ones must differ if the
cell is to say anything."""
_BY_CHANCE, _IF_RIGHT = 1.0 / 3.0, 0.9
"""In how many of the cells that say something the given rows match most, if they are wrong (one of three), and if they are right
(a small yard, a hall and a pavilion by night)."""
_ENOUGH = 5.0
"""Logarithm of the likelihood ratio: six cells of six, eight of nine."""


@dataclass(frozen=True)
class Cells:
    """What the cells of an image say of the rows."""

    better: Bools
    """(n, m) those in which clearly more matches on the given rows than on either of the shifted ones..."""
    worse: Bools
    """(n, m) ...and those in which clearly less does."""

    @property
    def confirm(self) -> bool:
        """The rows are right."""
        right, wrong = np.log(_IF_RIGHT / _BY_CHANCE), np.log((1.0 - _IF_RIGHT) / (1.0 - _BY_CHANCE))
        return bool(right * self.better.sum() + wrong * self.worse.sum() >= _ENOUGH)


@dataclass(frozen=True)
class RowAgreement:
    """What finds its partner on the rows as they are, and on shifted ones."""

    share: float
    """Share of the common area that survives the check between the views, at the best of no shift and two rows up or down."""
    chance: float
    """The largest such share with one image shifted by eight rows."""
    row_error_px: float
    """By how many rows of the rectified images they seem to be shifted, with sign."""
    cells: Cells
    """Where more matches on the given rows than on shifted ones."""
    on_ground: Cells | None = None
    """The same of what matches where the ground is known to be, without being led there; None if nobody knows it."""

    @property
    def confirmed(self) -> bool:
        """The rows are right."""
        return self.cells.confirm or (self.on_ground is not None and self.on_ground.confirm)


def match_rows(pair: RectifiedPair) -> tuple[RowAgreement, Float32s, Float32s]:
    """Match a pair at half its size on its rows and on shifted ones.

    Also disparity and confidence, (h / 2, w / 2), of the halved left image on the rows as they are, nan where nothing matches.
    """
    small = halved(pair)
    common = small.within_reach()
    disparity, confidence = _matched(small)
    shifted = {rows: _matched(_shifted(small, rows))[0] for rows in (_BESIDE, -_BESIDE, _AWAY, -_AWAY)}
    shifted[0] = disparity if small.prior_left is None else _matched(_shifted(small, 0))[0]  # led nowhere, as the others
    shares = {rows: float(np.isfinite(found).sum() / max(common.sum(), 1)) for rows, found in shifted.items()}
    below, here, above = (shares[rows] for rows in (_BESIDE, 0, -_BESIDE))
    error = 2.0 * _BESIDE * (below - above) / max(above + here + below, 1e-9)
    best = max((0, _BESIDE, -_BESIDE), key=shares.__getitem__)
    cells = _compared(common, *(np.isfinite(shifted[rows]) for rows in (best, _AWAY, -_AWAY)))
    ground = None
    if small.prior_left is not None:
        lying = (np.abs(shifted[rows] - small.prior_left) <= _SAME_PX for rows in (0, _AWAY, -_AWAY))
        ground = _compared(common, *lying)
    return RowAgreement(shares[best], max(shares[_AWAY], shares[-_AWAY]), error, cells, ground), disparity, confidence


def _compared(common: Bools, given: Bools, *shifted: Bools) -> Cells:
    """Count what matches in each cell, each (h, w): on the given rows, and on shifted ones."""
    side = int(np.clip(common.shape[1] // _ACROSS, _SMALLEST, _LARGEST))
    shown, chance = _by_cell(common, side), np.max([_by_cell(found, side) for found in shifted], axis=0)
    gain, clear = _by_cell(given, side) - chance, _DIFFERENT * shown
    speaks = shown >= _IN_COMMON * side**2
    return Cells(speaks & (gain >= clear), speaks & (-gain >= clear))


def _by_cell(counted: Bools, side: int) -> Int64s:
    """(n, m) how many pixels of each cell are among those counted."""
    height, width = counted.shape
    whole = np.pad(counted, ((0, -height % side), (0, -width % side)))
    return np.asarray(whole.reshape(-(-height // side), side, -1, side).sum(axis=(1, 3)), dtype=np.int64)


def _shifted(pair: RectifiedPair, rows: int) -> RectifiedPair:
    """The pair with its right image moved down by so many rows, and nothing known of where the scene is; rows without a partner
    may not be matched."""
    valid = np.roll(pair.valid_right, rows, axis=0)
    if rows:
        valid[slice(rows) if rows > 0 else slice(rows, None)] = False
    right = np.roll(pair.right, rows, axis=0)
    blind = replace(pair, prior_left=None, prior_right=None, floor_left=None, floor_right=None)
    return replace(blind, right=right, valid_right=valid)


def _matched(pair: RectifiedPair) -> tuple[Float32s, Float32s]:
    """Disparity of the left image where both views agree on it, else nan; and its confidence."""
    matches = match_patchmatch(pair)
    usable = pair.within_reach() & (matches.confidence_left > 0)
    smallest = max(60, round(_SPECKLE_SHARE * usable.size))
    return cross_checked(matches.left, matches.right, usable, -1, smallest), matches.confidence_left


_MOST_POINTS = 4000


def verify_rows(left: Frame, right: Frame, rectification: Rectification) -> tuple[RowAgreement, Float64s, Float64s, Float32s]:
    """Match both frames at half their size as `rectification` resamples them: are its rows right?  Also some of what matched,
    evenly spread: pixels (n, 2) of either frame, and confidence (n,), 0 to 1."""
    rows, disparity, confidence = match_rows(with_coarse_range(rectified_pair(left, right, rectification)))
    y, x = np.nonzero(np.isfinite(disparity))
    some = slice(None, None, max(1, len(x) // _MOST_POINTS))
    y, x = y[some], x[some]
    at1 = np.column_stack([2 * x + 0.5, 2 * y + 0.5])
    at2 = at1 - np.column_stack([2 * disparity[y, x].astype(np.float64), np.zeros(len(x))])
    x1, x2 = from_rectified(rectification, 1, at1), from_rectified(rectification, 2, at2)
    return rows, x1, x2, confidence[y, x]

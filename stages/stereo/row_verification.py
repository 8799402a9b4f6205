"""Dense row verification: does a rectification bring corresponding points to the same row?  No keypoints are needed.

Both images are matched at half their size, on the given rows and on rows shifted by eight up and down.  If rows correspond,
many pixels agree in both views; on shifted rows they agree only by chance.  Chance differs between scenes and within an image:
noise, faint walls and repeated stones match anywhere.  So each cell of the image is compared with itself: wrong given rows
match best of the three in a third of the cells, right ones in nearly all.  A likelihood ratio combines the cells.

Repeated pavement matches on shifted rows, too, but only on the right rows at the depth where other views know the ground:
matches on the ground are compared in the same way.  Matches on the right rows then replace keypoints: they give the net of
matches, the crop and the disparity range of the final rectification.  Shifts by two rows up and down reveal a small error.
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

_SMALL_SHIFT = 1
"""Shift, in rows of the halved images, that is a tolerable error of the rows."""
_LARGE_SHIFT = 4
"""Shift, in rows of the halved images, at which nothing should match; smaller ones still match smooth surfaces."""
_SPECKLE_SHARE = 5e-4
"""Connected pieces smaller than this share of the image are removed: they match anywhere."""
_FEWEST_SPECKLE_PX = 60
"""Connected pieces of fewer pixels are removed in images of any size."""
_SAME_PX = 0.75
"""Largest difference between disparities of the same surface, in pixels of the halved images."""
_CELLS_ACROSS = 12
"""Cells in a row of the halved images; with more of them, images of 320 pixels have enough."""
_SMALLEST_CELL = 12
"""Smallest side of a cell, pixels of the halved images: several windows of the matcher, whose results are correlated."""
_LARGEST_CELL = 32
"""Largest side of a cell, pixels of the halved images."""
_LEAST_COMMON = 0.3
"""A cell counts if both images show at least this share of it."""
_LEAST_DIFFERENCE = 0.1
"""A cell counts if its numbers of matches on the given and the shifted rows differ by at least this share of what both show."""
_CHANCE_SHARE = 1.0 / 3.0
"""Share of the counting cells in which the given rows match most if they are wrong: one of three is best by chance."""
_CORRECT_SHARE = 0.9
"""The same if they are correct (measured: a small yard, a hall and a pavilion by night)."""
_LEAST_LOG_RATIO = 5.0
"""Rows are confirmed if the log-likelihood ratio reaches this: six cells out of six, or seven out of eight."""


@dataclass(frozen=True)
class Cells:
    """Cells of an image in which the given rows and shifted ones clearly differ."""

    better: Bools
    """(n, m) bool, where clearly more pixels match on the given rows than on any shifted ones."""
    worse: Bools
    """(n, m) bool, where clearly fewer pixels match on the given rows than on the best of the shifted ones."""

    @property
    def confirms_rows(self) -> bool:
        """Are the rows right, by the likelihood ratio?"""
        better_weight = np.log(_CORRECT_SHARE / _CHANCE_SHARE)
        worse_weight = np.log((1.0 - _CORRECT_SHARE) / (1.0 - _CHANCE_SHARE))
        log_ratio = better_weight * self.better.sum() + worse_weight * self.worse.sum()
        return bool(log_ratio >= _LEAST_LOG_RATIO)


@dataclass(frozen=True)
class RowAgreement:
    """Matches on the given rows compared with matches on shifted ones."""

    share: float
    """Share of the common area on which both views agree: the largest for no shift and two rows up or down."""
    chance: float
    """The larger share of agreement with one image shifted by eight rows up or down."""
    row_error_px: float
    """Estimated offset between corresponding rows of the rectified images, with sign."""
    cells: Cells
    """Cells in which more or fewer pixels match on the given rows than on shifted ones."""
    on_ground: Cells | None = None
    """Like `cells`, but only for matches at the known ground, found without this prior; None if the ground is unknown."""

    @property
    def confirmed(self) -> bool:
        """Are the rows right, by all matches or by those on the ground?"""
        if self.cells.confirms_rows:
            return True
        return self.on_ground is not None and self.on_ground.confirms_rows


def match_rows(pair: RectifiedPair) -> tuple[RowAgreement, Float32s, Float32s]:
    """Match a pair at half its size on its rows and on shifted ones.

    Also returns the left image's disparity on the given rows, nan where nothing matches, and confidence, both (h / 2, w / 2).
    """
    small = halved(pair)
    common = small.matchable_pixels()
    disparity, confidence = _matched(small)

    # 1. match on shifted rows, without prior; on the given rows, too, if the match above had one
    by_shift = {}
    for rows in (_SMALL_SHIFT, -_SMALL_SHIFT, _LARGE_SHIFT, -_LARGE_SHIFT):
        by_shift[rows], _ = _matched(_shifted(small, rows))
    if small.prior_left is None:
        by_shift[0] = disparity
    else:
        by_shift[0], _ = _matched(_shifted(small, 0))

    # 2. shares of the common area that match
    shares = {}
    for rows, matched in by_shift.items():
        shares[rows] = float(np.isfinite(matched).sum() / max(common.sum(), 1))
    below = shares[_SMALL_SHIFT]
    here = shares[0]
    above = shares[-_SMALL_SHIFT]
    # the centre of gravity of the three shares, in rows of the full size
    row_error = 2.0 * _SMALL_SHIFT * (below - above) / max(above + here + below, 1e-9)
    best_shift = max((0, _SMALL_SHIFT, -_SMALL_SHIFT), key=shares.__getitem__)

    # 3. the same cell by cell
    shifted = [by_shift[_LARGE_SHIFT], by_shift[-_LARGE_SHIFT]]
    cells = _compared(common, np.isfinite(by_shift[best_shift]), [np.isfinite(other) for other in shifted])
    ground = None
    prior = small.prior_left
    if prior is not None:
        given_on_ground = np.abs(by_shift[0] - prior) <= _SAME_PX
        ground = _compared(common, given_on_ground, [np.abs(other - prior) <= _SAME_PX for other in shifted])

    agreement = RowAgreement(
        share=shares[best_shift],
        chance=max(shares[_LARGE_SHIFT], shares[-_LARGE_SHIFT]),
        row_error_px=row_error,
        cells=cells,
        on_ground=ground,
    )
    return agreement, disparity, confidence


def _compared(common: Bools, given: Bools, shifted: list[Bools]) -> Cells:
    """Compare the pixels that match on the given rows and on each of the shifted ones, all (h, w), cell by cell."""
    side = int(np.clip(common.shape[1] // _CELLS_ACROSS, _SMALLEST_CELL, _LARGEST_CELL))
    common_count = _by_cell(common, side)
    chance = np.max([_by_cell(matching, side) for matching in shifted], axis=0)
    gain = _by_cell(given, side) - chance
    least_gain = _LEAST_DIFFERENCE * common_count
    counted = common_count >= _LEAST_COMMON * side**2
    return Cells(better=counted & (gain >= least_gain), worse=counted & (-gain >= least_gain))


def _by_cell(pixels: Bools, side: int) -> Int64s:
    """(n, m) number of the `pixels` that lie in each cell."""
    height, width = pixels.shape
    padded = np.pad(pixels, ((0, -height % side), (0, -width % side)))
    cells = padded.reshape(-(-height // side), side, -1, side)  # (n, rows of a cell, m, columns of a cell)
    return np.asarray(cells.sum(axis=(1, 3)), dtype=np.int64)


def _shifted(pair: RectifiedPair, rows: int) -> RectifiedPair:
    """The pair with its right image moved down by `rows`, without prior and floor; rows without a partner may not be matched."""
    # rows that roll around come from the other end of the image
    valid = np.roll(pair.valid_right, rows, axis=0)
    if rows > 0:
        valid[:rows] = False
    elif rows < 0:
        valid[rows:] = False
    right = np.roll(pair.right, rows, axis=0)
    without_prior = replace(pair, prior_left=None, prior_right=None, floor_left=None, floor_right=None)
    return replace(without_prior, right=right, valid_right=valid)


def _matched(pair: RectifiedPair) -> tuple[Float32s, Float32s]:
    """Disparity of the left image where both views agree on it, else nan; and its confidence."""
    matches = match_patchmatch(pair)
    usable = pair.matchable_pixels() & (matches.confidence_left > 0)
    smallest = max(_FEWEST_SPECKLE_PX, round(_SPECKLE_SHARE * usable.size))
    return cross_checked(matches.left, matches.right, usable, -1, smallest), matches.confidence_left


_MOST_POINTS = 4000
"""About the largest number of matches that `verify_rows` returns: up to twice as many where they are just too few to thin out."""


def verify_rows(left: Frame, right: Frame, rectification: Rectification) -> tuple[RowAgreement, Float64s, Float64s, Float32s]:
    """Match both frames at half their size as `rectification` resamples them: are its rows right?  Also returns some of the
    matches, evenly spread: pixels (n, 2) of either frame, and confidence (n,), 0 to 1."""
    rows, disparity, confidence = match_rows(with_coarse_range(rectified_pair(left, right, rectification)))
    y, x = np.nonzero(np.isfinite(disparity))
    step = max(1, len(x) // _MOST_POINTS)
    y = y[::step]
    x = x[::step]
    # a pixel of the halved images is the middle of four: 2 x + 0.5
    points1 = np.column_stack([2 * x + 0.5, 2 * y + 0.5])
    shift = np.column_stack([2 * disparity[y, x].astype(np.float64), np.zeros(len(x))])
    points2 = points1 - shift
    x1 = from_rectified(rectification, 1, points1)
    x2 = from_rectified(rectification, 2, points2)
    return rows, x1, x2, confidence[y, x]

"""OpenCV's semi-global matching, three directions, on both views (Hirschmueller, PAMI 2008; OpenCV's StereoSGBM).

A wide range is searched in blocks, each with its own range from a match at half the size: semi-global matching takes time for
every pixel at every disparity, while most parts of an image contain few of the scene's depths.  The price: objects narrower
than 8 pixels, or of less than some 400 pixels, are missed if their disparity is outside the range of their surroundings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from ..core.jit import kernel
from ..types import Bools, Float32s, Uint8s
from .consistency import cross_checked
from .matcher import DenseMatches, RectifiedPair, halved, mirrored

_WINDOW = 3
"""Side of the windows that StereoSGBM compares, pixels."""
_STEP_PENALTY = 7 * _WINDOW**2
"""StereoSGBM's P1, for a change of disparity by 1 from one pixel to the next; larger values flatten slopes."""
_JUMP_PENALTY = 38 * _WINDOW**2
"""StereoSGBM's P2, for larger changes; larger values close over thin objects."""
_GRADIENT_CAP = 20
"""StereoSGBM's preFilterCap: horizontal gradients, which it compares besides grey levels, are cut off at this."""
_RANGE_MULTIPLE = 16
"""StereoSGBM searches a multiple of so many disparities."""
_NARROW_RANGE = 160
"""Ranges of up to this many disparities are searched in one piece, which takes no longer than blocks."""


def match_sgbm(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views, each matched separately; wide ranges are searched in blocks, by a match at half the size."""
    if pair.disparity_max - pair.disparity_min < _NARROW_RANGE:
        return match_in_one_piece(pair)
    small = halved(pair)
    coarse = match_sgbm(small)
    smallest_px = max(small.left.size // 2000, 4)
    coarse_left = cross_checked(coarse.left, coarse.right, small.valid_left, -1, smallest_px)
    coarse_right = cross_checked(coarse.right, coarse.left, small.valid_right, 1, smallest_px)
    left = _in_blocks(pair, coarse_left)
    right = np.ascontiguousarray(_in_blocks(mirrored(pair), coarse_right[:, ::-1])[:, ::-1])
    return DenseMatches(left, right, np.ones_like(left), np.ones_like(right))


def match_in_one_piece(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views, with the whole range searched in the whole image."""
    left = _match_whole(pair)
    right = np.ascontiguousarray(_match_whole(mirrored(pair))[:, ::-1])
    return DenseMatches(left, right, np.ones_like(left), np.ones_like(right))


def _in_blocks(pair: RectifiedPair, coarse: Float32s) -> Float32s:
    """Disparity (h, w) of the left image, searched in blocks around the `coarse` one (h / 2, w / 2) of the halved pair."""
    left = _eight_bit(pair.left)
    right = _eight_bit(pair.right)
    disparity = np.full(left.shape, np.nan, dtype=np.float32)
    for block in blocks(coarse, pair.disparity_min, pair.disparity_max):
        # match the block with its context, and keep its own pixels
        top = max(block.top - CONTEXT_PX, 0)
        start = max(block.left - CONTEXT_PX, 0)
        rows = slice(top, block.bottom + BELOW_PX)
        columns = slice(start, block.right + CONTEXT_PX)
        part = _searched(left[rows, columns], right[rows], start, block.low, block.high)
        own_part = part[block.top - top : block.bottom - top, block.left - start : block.right - start]
        disparity[block.top : block.bottom, block.left : block.right] = own_part
    return disparity


def _match_whole(pair: RectifiedPair) -> Float32s:
    """Disparity (h, w) of the left image, without the columns in which no pixel may be matched."""
    disparity = np.full(pair.left.shape, np.nan, dtype=np.float32)
    used = np.flatnonzero(pair.valid_left.any(axis=0))
    if len(used) == 0:
        return disparity
    columns = slice(max(used[0] - _WINDOW, 0), used[-1] + 1 + _WINDOW)
    left = _eight_bit(pair.left[:, columns])
    right = _eight_bit(pair.right)
    disparity[:, columns] = _searched(left, right, columns.start, pair.disparity_min, pair.disparity_max)
    return disparity


def _searched(left: Uint8s, right: Uint8s, start: int, low: int, high: int) -> Float32s:
    """Disparity (h, w) of a part of the left image that begins at its column `start`; right: the same rows, all columns.

    The right image is shifted so that disparities start at 0, and both are padded on the left: StereoSGBM gives no value in
    columns whose range is not entirely inside the right image.

    Parameters
    ----------
    left, right : (h, w) the part of the left image, and (h, wider) the right image.
    start : column of the whole left image at which the part begins.
    low, high : whole disparities, the range to search, both ends included.
    """
    count = _RANGE_MULTIPLE * -(-(high - low + 1) // _RANGE_MULTIPLE)  # rounded up
    left = np.asarray(cv2.copyMakeBorder(left, 0, 0, count, 0, cv2.BORDER_REPLICATE), dtype=np.uint8)
    matcher = cv2.StereoSGBM.create(
        numDisparities=count,
        blockSize=_WINDOW,
        P1=_STEP_PENALTY,
        P2=_JUMP_PENALTY,
        disp12MaxDiff=-1,  # no check of its own between the views
        preFilterCap=_GRADIENT_CAP,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    columns = np.arange(left.shape[1]) - (count + low - start)
    columns = np.clip(columns, 0, right.shape[1] - 1)  # replicates the border columns
    sixteenths = matcher.compute(left, np.ascontiguousarray(right[:, columns]))[:, count:]
    pixels = sixteenths.astype(np.float32) / 16 + low
    return np.where(sixteenths < 0, np.float32(np.nan), pixels).astype(np.float32)


def _eight_bit(image: Float32s) -> Uint8s:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


class _Piece(NamedTuple):
    """A possible block, which may be split: rows and columns of cells, ends excluded.  Kernels know named tuples."""

    top: int
    bottom: int
    left: int
    right: int
    low: int
    high: int
    cost: float
    """0 if there is nothing to search."""


CELL_PX = 16
"""Side of the square cells that make up blocks; blocks reach one cell beyond what was seen at half the size."""
CONTEXT_PX = 16
"""Margin, in pixels, matched with a block at its sides and top, from where semi-global paths come."""
BELOW_PX = 3
"""Margin, in pixels, matched with a block below it: enough for the windows, as no paths come from there."""
_LEAST_CELLS = 3
"""Smallest width and height, in cells, of the parts into which a block is split."""
_MARGIN_PX = 8
"""The range seen at half the size is extended by this much at both ends, pixels, as it may be wrong."""
_LEAST_RANGE = 96
"""Smallest number of disparities that a block searches: among few of them, both views agree by chance."""
_PIXEL_COST = 35
"""Time for a pixel besides its disparities, in units of a pixel at one disparity (measured: 1.1 ns; OpenCV 5.0)."""
_BLOCK_COST = 2e5
"""Time for a block besides its pixels, in the same unit; larger values give fewer, larger blocks."""


@dataclass(frozen=True)
class Block:
    """Rows from `top` to `bottom` and columns from `left` to `right`, ends excluded and possibly beyond the image, without the
    context; `low`, `high`: whole disparities, the range to search, both ends included."""

    top: int
    bottom: int
    left: int
    right: int
    low: int
    high: int


def blocks(coarse_disparity: Float32s, low: int, high: int) -> list[Block]:
    """Blocks of an image from the `coarse_disparity` at half its size: (h, w), in pixels of that size, nan where unknown.

    Only the range from `low` to `high` is searched, and only near what was seen.  A block is split in two where the parts, with
    their contexts, cost less.
    """
    lowest, highest = _ranges(coarse_disparity)
    lowest = np.maximum(np.floor(2 * lowest - _MARGIN_PX), np.float32(low))
    highest = np.minimum(np.ceil(2 * highest + _MARGIN_PX), np.float32(high))
    # cells that were seen at half the size, and those next to them
    searched = cv2.dilate((lowest <= highest).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    piece = _piece(lowest, highest, searched, 0, searched.shape[0], 0, searched.shape[1])
    found = []
    for part in _cheapest(lowest, highest, searched, piece):
        block = Block(
            top=CELL_PX * part.top,
            bottom=CELL_PX * part.bottom,
            left=CELL_PX * part.left,
            right=CELL_PX * part.right,
            low=max(part.low, low),
            high=min(part.high, high),
        )
        found.append(block)
    return found


def _ranges(disparity: Float32s) -> tuple[Float32s, Float32s]:
    """Smallest and largest disparity of each cell; inf and -inf where it has none."""
    side = CELL_PX // 2
    height, width = disparity.shape
    padded = np.pad(disparity, ((0, -height % side), (0, -width % side)), constant_values=np.nan)
    rows = padded.shape[0] // side
    columns = padded.shape[1] // side
    # (rows, columns, pixels of a cell)
    cells = padded.reshape(rows, side, columns, side).transpose(0, 2, 1, 3).reshape(rows, columns, side * side)
    unknown = np.isnan(cells)
    lowest = np.where(unknown, np.float32(np.inf), cells).min(axis=2)
    highest = np.where(unknown, np.float32(-np.inf), cells).max(axis=2)
    return lowest, highest


def _cheapest(lowest: Float32s, highest: Float32s, searched: Bools, piece: _Piece) -> list[_Piece]:
    """The piece, or its parts (split further in the same way) where these cost less; nothing for an empty piece.

    lowest, highest: (rows, columns) ranges of the cells, empty where nothing was seen; searched: cells to search.
    """
    if piece.cost == 0:
        return []
    first, second = _best_split(lowest, highest, searched, piece.top, piece.bottom, piece.left, piece.right)
    if first.cost == np.inf:
        return [piece]
    pieces = _cheapest(lowest, highest, searched, first) + _cheapest(lowest, highest, searched, second)
    if sum(smaller.cost for smaller in pieces) < piece.cost:
        return pieces
    return [piece]


@kernel
def _piece(lowest: Float32s, highest: Float32s, searched: Bools, top: int, bottom: int, left: int, right: int) -> _Piece:
    """The smallest piece around the cells that are to be searched within a rectangle of cells."""
    # 1. the box around these cells
    row0 = bottom
    row1 = top
    column0 = right
    column1 = left
    for y in range(top, bottom):
        for x in range(left, right):
            if searched[y, x]:
                row0 = min(row0, y)
                row1 = max(row1, y + 1)
                column0 = min(column0, x)
                column1 = max(column1, x + 1)
    if row0 >= row1:
        return _Piece(top, top, left, left, 0, 0, 0.0)
    # 2. the range seen in it and in the cells next to it
    low = np.inf
    high = -np.inf
    for y in range(max(row0 - 1, 0), min(row1 + 1, searched.shape[0])):
        for x in range(max(column0 - 1, 0), min(column1 + 1, searched.shape[1])):
            if lowest[y, x] <= highest[y, x]:
                low = min(low, lowest[y, x])
                high = max(high, highest[y, x])
    widening = max(_LEAST_RANGE - (high - low + 1), 0.0)
    low = low - np.floor(widening / 2)
    high = high + np.ceil(widening / 2)
    # 3. the time to search it, with its context
    height = (row1 - row0) * CELL_PX + CONTEXT_PX + BELOW_PX
    width = (column1 - column0) * CELL_PX + 2 * CONTEXT_PX
    cost = height * width * (_PIXEL_COST + high - low + 1) + _BLOCK_COST
    return _Piece(row0, row1, column0, column1, int(low), int(high), cost)


@kernel
def _best_split(
    lowest: Float32s, highest: Float32s, searched: Bools, top: int, bottom: int, left: int, right: int
) -> tuple[_Piece, _Piece]:
    """The cheapest two parts of a rectangle of cells, above and below or side by side; cost inf if it is too small to split."""
    least_cost = np.inf
    first = _Piece(top, top, left, left, 0, 0, np.inf)
    second = first
    for y in range(top + _LEAST_CELLS, bottom - _LEAST_CELLS + 1):
        upper = _piece(lowest, highest, searched, top, y, left, right)
        lower = _piece(lowest, highest, searched, y, bottom, left, right)
        if upper.cost + lower.cost < least_cost:
            least_cost = upper.cost + lower.cost
            first = upper
            second = lower
    for x in range(left + _LEAST_CELLS, right - _LEAST_CELLS + 1):
        left_part = _piece(lowest, highest, searched, top, bottom, left, x)
        right_part = _piece(lowest, highest, searched, top, bottom, x, right)
        if left_part.cost + right_part.cost < least_cost:
            least_cost = left_part.cost + right_part.cost
            first = left_part
            second = right_part
    return first, second

"""OpenCV's semi-global matching, three directions, on both views (Hirschmueller, PAMI 2008; OpenCV's StereoSGBM).

A wide range is searched in blocks, each with its own range from a match at half the size: semi-global matching takes time for
every pixel at every disparity, while most parts of an image contain few of the scene's depths.  The price: objects narrower
than 8 pixels, or of less than some 400 pixels, are missed if their disparity is outside the range of their surroundings."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..core.jit import kernel
from ..types import Bools, Float32s, Uint8s
from .consistency import cross_checked
from .matcher import DenseMatches, RectifiedPair, halved, mirrored

_BLOCK = 3
_NARROW_RANGE = 160
"""Ranges of up to this many disparities are searched in one piece, which takes no longer than blocks."""


def match_sgbm(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views, each matched separately; wide ranges are searched in blocks, by a match at half the size."""
    if pair.disparity_max - pair.disparity_min < _NARROW_RANGE:
        return match_in_one_piece(pair)
    small = halved(pair)
    coarse, smallest = match_sgbm(small), max(small.left.size // 2000, 4)
    left = _in_blocks(pair, cross_checked(coarse.left, coarse.right, small.valid_left, -1, smallest))
    coarse_right = cross_checked(coarse.right, coarse.left, small.valid_right, 1, smallest)
    right = np.ascontiguousarray(_in_blocks(mirrored(pair), coarse_right[:, ::-1])[:, ::-1])
    return DenseMatches(left, right, np.ones_like(left), np.ones_like(right))


def match_in_one_piece(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views, with the whole range searched in the whole image."""
    left = _match_whole(pair)
    right = np.ascontiguousarray(_match_whole(mirrored(pair))[:, ::-1])
    return DenseMatches(left, right, np.ones_like(left), np.ones_like(right))


def _in_blocks(pair: RectifiedPair, coarse: Float32s) -> Float32s:
    left, right = _eight_bit(pair.left), _eight_bit(pair.right)
    disparity = np.full(left.shape, np.nan, dtype=np.float32)
    for block in blocks(coarse, pair.disparity_min, pair.disparity_max):
        top, start = max(block.top - CONTEXT_PX, 0), max(block.left - CONTEXT_PX, 0)
        rows, columns = slice(top, block.bottom + BELOW_PX), slice(start, block.right + CONTEXT_PX)
        part = _searched(left[rows, columns], right[rows], start, block.low, block.high)
        inner = slice(block.top, block.bottom), slice(block.left, block.right)
        disparity[inner] = part[block.top - top : block.bottom - top, block.left - start : block.right - start]
    return disparity


def _match_whole(pair: RectifiedPair) -> Float32s:
    """Disparity (h, w) of the left image, without the columns in which no pixel may be matched."""
    disparity = np.full(pair.left.shape, np.nan, dtype=np.float32)
    used = np.flatnonzero(pair.valid_left.any(axis=0))
    if len(used) > 0:
        columns = slice(max(used[0] - _BLOCK, 0), used[-1] + 1 + _BLOCK)
        left, right = _eight_bit(pair.left[:, columns]), _eight_bit(pair.right)
        disparity[:, columns] = _searched(left, right, columns.start, pair.disparity_min, pair.disparity_max)
    return disparity


def _searched(left: Uint8s, right: Uint8s, start: int, low: int, high: int) -> Float32s:
    """Disparity (h, w) of a part of the left image that begins at its column `start`; right: the same rows, all columns.

    The right image is shifted so that disparities start at 0, and both are padded on the left: StereoSGBM gives no value in
    columns whose range is not entirely inside the right image.
    """
    count = 16 * -(-(high - low + 1) // 16)
    left = np.asarray(cv2.copyMakeBorder(left, 0, 0, count, 0, cv2.BORDER_REPLICATE), dtype=np.uint8)
    matcher = cv2.StereoSGBM.create(
        numDisparities=count,
        blockSize=_BLOCK,
        P1=7 * _BLOCK**2,
        P2=38 * _BLOCK**2,
        disp12MaxDiff=-1,
        preFilterCap=20,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    columns = np.clip(np.arange(left.shape[1]) - (count + low - start), 0, right.shape[1] - 1)  # replicates the border columns
    sixteenths = matcher.compute(left, np.ascontiguousarray(right[:, columns]))[:, count:]
    return np.where(sixteenths < 0, np.float32(np.nan), sixteenths.astype(np.float32) / 16 + low).astype(np.float32)


def _eight_bit(image: Float32s) -> Uint8s:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


_Piece = tuple[int, int, int, int, int, int, float]
"""A possible block: cells from top to bottom and left to right, its low and high, its cost (0 if there is nothing to search)."""

CELL_PX = 16
"""Side of the square cells that make up blocks; blocks reach one cell beyond what was seen at half the size."""
CONTEXT_PX, BELOW_PX = 16, 3
"""Margins matched with a block, at its sides and top, and below it: semi-global paths come from the former, none from below."""
_LEAST_CELLS = 3
"""Smallest width and height, in cells, of the parts into which a block is split."""
_MARGIN_PX = 8
"""The range seen at half the size is extended by this much at both ends, as it may be wrong."""
_LEAST_RANGE = 96
"""Smallest number of disparities that a block searches: among few of them, both views agree by chance."""
_PIXEL_COST, _BLOCK_COST = 35, 2e5
"""Cost of a pixel and of a block besides their disparities, in units of a pixel at one disparity (1.1 ns; OpenCV 5.0)."""


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
    searched = cv2.dilate((lowest <= highest).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    piece = _piece(lowest, highest, searched, 0, searched.shape[0], 0, searched.shape[1])
    pieces = _cheapest(lowest, highest, searched, piece)
    return [
        Block(CELL_PX * top, CELL_PX * bottom, CELL_PX * left, CELL_PX * right, max(least_d, low), min(most_d, high))
        for top, bottom, left, right, least_d, most_d, _ in pieces
    ]


def _ranges(disparity: Float32s) -> tuple[Float32s, Float32s]:
    """Smallest and largest disparity of each cell; inf and -inf where it has none."""
    side = CELL_PX // 2
    padded = np.pad(disparity, ((0, -disparity.shape[0] % side), (0, -disparity.shape[1] % side)), constant_values=np.nan)
    rows, columns = padded.shape[0] // side, padded.shape[1] // side
    cells = padded.reshape(rows, side, columns, side).transpose(0, 2, 1, 3).reshape(rows, columns, side * side)
    unknown = np.isnan(cells)
    lowest = np.where(unknown, np.float32(np.inf), cells).min(axis=2)
    return lowest, np.where(unknown, np.float32(-np.inf), cells).max(axis=2)


def _cheapest(lowest: Float32s, highest: Float32s, searched: Bools, piece: _Piece) -> list[_Piece]:
    """The piece, or its parts (split further in the same way) where these cost less; nothing for an empty piece.

    lowest, highest: (rows, columns) ranges of the cells, empty where nothing was seen; searched: cells to search.
    """
    if piece[-1] == 0:
        return []
    parts = _best_split(lowest, highest, searched, *piece[:4])
    if parts[0][-1] == np.inf:
        return [piece]
    pieces = [smaller for part in parts for smaller in _cheapest(lowest, highest, searched, part)]
    return pieces if sum(smaller[-1] for smaller in pieces) < piece[-1] else [piece]


@kernel
def _piece(lowest: Float32s, highest: Float32s, searched: Bools, top: int, bottom: int, left: int, right: int) -> _Piece:
    """The smallest piece around the cells that are to be searched within a rectangle of cells."""
    row0, row1, column0, column1 = bottom, top, right, left
    for y in range(top, bottom):
        for x in range(left, right):
            if searched[y, x]:
                row0, row1 = min(row0, y), max(row1, y + 1)
                column0, column1 = min(column0, x), max(column1, x + 1)
    if row0 >= row1:
        return top, top, left, left, 0, 0, 0.0
    low, high = np.inf, -np.inf
    for y in range(max(row0 - 1, 0), min(row1 + 1, searched.shape[0])):
        for x in range(max(column0 - 1, 0), min(column1 + 1, searched.shape[1])):
            if lowest[y, x] <= highest[y, x]:
                low, high = min(low, lowest[y, x]), max(high, highest[y, x])
    height = (row1 - row0) * CELL_PX + CONTEXT_PX + BELOW_PX
    width = (column1 - column0) * CELL_PX + 2 * CONTEXT_PX
    widening = max(_LEAST_RANGE - (high - low + 1), 0.0)
    low, high = low - np.floor(widening / 2), high + np.ceil(widening / 2)
    return row0, row1, column0, column1, int(low), int(high), height * width * (_PIXEL_COST + high - low + 1) + _BLOCK_COST


@kernel
def _best_split(
    lowest: Float32s, highest: Float32s, searched: Bools, top: int, bottom: int, left: int, right: int
) -> tuple[_Piece, _Piece]:
    """The cheapest two parts of a rectangle of cells, above and below or side by side; cost inf if it is too small to split."""
    least_cost = np.inf
    parts = (top, top, left, left, 0, 0, np.inf), (top, top, left, left, 0, 0, np.inf)
    for y in range(top + _LEAST_CELLS, bottom - _LEAST_CELLS + 1):
        upper = _piece(lowest, highest, searched, top, y, left, right)
        lower = _piece(lowest, highest, searched, y, bottom, left, right)
        if upper[-1] + lower[-1] < least_cost:
            least_cost, parts = upper[-1] + lower[-1], (upper, lower)
    for x in range(left + _LEAST_CELLS, right - _LEAST_CELLS + 1):
        left_part = _piece(lowest, highest, searched, top, bottom, left, x)
        right_part = _piece(lowest, highest, searched, top, bottom, x, right)
        if left_part[-1] + right_part[-1] < least_cost:
            least_cost, parts = left_part[-1] + right_part[-1], (left_part, right_part)
    return parts

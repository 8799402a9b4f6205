"""Boards in pictures: how a board is printed, and its corners with their numbers.

References: Garrido-Jurado et al., Automatic generation and detection of highly reliable fiducial markers under occlusion, Pattern
Recognition 2014 (ArUco, ChArUco); Olson, AprilTag, ICRA 2011; Duda & Frese, Accurate detection and localization of checkerboard
corners, BMVC 2018 (all as implemented in OpenCV).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from ..types import Float32s, Float64s, Int32s, Uint8s

_LEAST_CORNERS = 8
"""Fewest corners of a board with markers in a picture that is used."""
_FEW = 6
"""Number of pictures of the sample, at least, in which other ways to print the board are looked for."""
_ENOUGH = 5
"""Number of pictures of the sample, at least, in which a stated board with markers is seen, for no other to be looked for."""
_PLANE_SHARE = 0.02
"""Corners that lie on a plane, up to this share of their extent (lenses bend planes a little), belong together."""
DICTIONARIES = (
    *(f"{n}X{n}_{count}" for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "ARUCO_ORIGINAL",
    "ARUCO_MIP_36h12",
    "APRILTAG_16h5",
    "APRILTAG_25h9",
    "APRILTAG_36h10",
    "APRILTAG_36h11",
)
"""OpenCV's dictionaries of markers, without their prefix `DICT_`.  Each of 50, 100 or 250 is the beginning of that of 1000."""


_LEAST_ALTERNATION = 0.5
"""Least contrast of the outermost squares of a checkerboard, as a share of that of the others."""


@dataclass(frozen=True)
class Board:
    """The calibration board that was photographed."""

    columns: int
    """Inner corners per row of a checkerboard; squares per row of a ChArUco board."""
    rows: int
    square: float = 1.0
    """Edge of a square, in any unit of length."""
    marker: float = 0.0
    """Edge of a ChArUco marker, in the same unit; 0: a plain checkerboard."""
    dictionary: str = "4X4_50"
    """OpenCV's dictionary of the markers, without the prefix `DICT_`."""
    is_inverted: bool = False
    """Are the markers white on black?"""
    is_legacy: bool = False
    """Does a board with an even number of rows begin with a marker, as OpenCV drew it before 4.6, instead of a black square?"""
    grid: str = ""
    """"down" or "up": markers alone, `square` from the beginning of one to that of the next, numbered row by row from the top
    (OpenCV's GridBoard) or from the bottom (Kalibr's AprilGrid); "": markers in the white squares of a checkerboard."""


@dataclass(frozen=True)
class BoardView:
    """The corners detected in one picture."""

    ids: Int32s
    """(n,) int32 numbers of the corners, the same in every picture of the board."""
    board: Float32s
    """(n, 3) corners on the board, in the unit of its squares."""
    image: Float32s
    """(n, 2) the same corners in the picture, pixels."""

    def __len__(self) -> int:
        return len(self.ids)


def spread_over(pictures: Iterable[Uint8s], number: int) -> list[Uint8s]:
    """From `number` to twice as many pictures, spread over all (fewer if there are no more)."""
    chosen: list[Uint8s] = []
    step = 1
    for count, picture in enumerate(pictures):
        if count % step:
            continue
        chosen.append(picture)
        if len(chosen) == 2 * number:
            chosen = chosen[::2]
            step *= 2
    return chosen


def with_most_markers(stated: Board, sample: Sequence[Uint8s], number: int) -> list[Uint8s]:
    """The pictures of a sample, `number` of them, that show the most markers of the stated dictionary."""
    most = _most_markers(stated)
    counts = [max(len(_markers(stated.dictionary, grey, is_inverted, most)) for is_inverted in (False, True)) for grey in sample]
    order = np.argsort(-np.array(counts), kind="stable")[:number]
    return [sample[k] for k in order]


def as_printed(stated: Board, sample: Sequence[Uint8s]) -> Board:
    """The board as it is printed: of all that a statement may mean, what shows the most corners; what is stated, if as many.

    sample: pictures (h, w) uint8, some of which show the board.
    """
    few = sample[:: max(1, len(sample) // _FEW)]
    if not stated.marker:
        # the same board by its squares, and by its corners; a search without success takes long
        others = [replace(stated, columns=stated.columns + k, rows=stated.rows + k) for k in (-1, 1)]
        if _checkers_seen(stated, few):
            return stated
        seen = [_checkers_seen(board, few) for board in others]
        return others[int(np.argmax(seen))] if any(seen) else stated
    best, most = _best_layout(stated, few)
    corners_each = min(_LEAST_CORNERS, (stated.columns - 1) * (stated.rows - 1))
    if most >= corners_each * min(_ENOUGH, len(few)):
        return best
    for dictionary in dict.fromkeys([stated.dictionary, *_likely_dictionaries(stated, few)]):
        found, corners = _best_layout(replace(stated, dictionary=dictionary), few, is_any=True)
        if corners > most:
            best = found
            most = corners
    return best


def _best_layout(stated: Board, sample: Sequence[Uint8s], is_any: bool = False) -> tuple[Board, int]:
    """The layout that shows the most corners (of equal ones, the one most like what is stated), and their number.

    is_any: grids of markers count, too; of a ChArUco board of few squares, a wrong grid may show more corners than it has.
    """
    # markers are looked for once: that takes most of the time, and they are the same for all layouts
    most = _most_markers(stated)
    upright = [_markers(stated.dictionary, grey, False, most) for grey in sample]
    inverted = [_markers(stated.dictionary, grey, True, most) for grey in sample]
    is_inverted = sum(map(len, inverted)) > sum(map(len, upright))
    markers = inverted if is_inverted else upright
    scored = []
    layouts = _layouts(replace(stated, is_inverted=is_inverted))
    if is_any:
        layouts += _grids(replace(stated, is_inverted=is_inverted))
    for board in layouts:
        views = [_detect_marked(grey, board, found) for grey, found in zip(sample, markers, strict=True) if len(found)]
        scored.append((board, _corners_seen(views)))
    return max(scored, key=lambda layout: layout[1])


def _layouts(stated: Board) -> list[Board]:
    """The ChArUco boards that a statement may mean; what is stated comes first."""
    sizes: list[tuple[int, int]] = []
    for more in (0, 1):  # 1: corners are stated, not squares
        columns = stated.columns + more
        rows = stated.rows + more
        sizes += [(columns, rows), (rows, columns)]
    layouts: list[Board] = []
    for columns, rows in dict.fromkeys(sizes):
        layouts.append(replace(stated, columns=columns, rows=rows))
        if rows % 2 == 0:  # with an odd number of rows both layouts are the same
            layouts.append(replace(stated, columns=columns, rows=rows, is_legacy=True))
    return layouts


def _grids(stated: Board) -> list[Board]:
    """The grids of markers that a statement may mean."""
    sizes = dict.fromkeys([(stated.columns, stated.rows), (stated.rows, stated.columns)])
    return [replace(stated, columns=columns, rows=rows, grid=grid) for columns, rows in sizes for grid in ("down", "up")]


def _likely_dictionaries(stated: Board, sample: Sequence[Uint8s]) -> list[str]:
    """The two dictionaries of which the most markers are found, black on white or white on black."""
    most = _most_markers(stated)
    counts: dict[str, int] = {}
    for name in DICTIONARIES:
        if not name.endswith(("_50", "_100", "_250")):  # these are parts of those of 1000
            by_polarity = [sum(len(_markers(name, grey, is_inverted, most)) for grey in sample) for is_inverted in (False, True)]
            counts[name] = max(by_polarity)
    return sorted(counts, key=lambda name: -counts[name])[:2]


def _most_markers(stated: Board) -> int:
    """Most markers that a board may have, however a statement of its size is meant."""
    return max(_marker_count(board) for board in [*_layouts(stated), *_grids(stated)])


def _marker_count(board: Board) -> int:
    """Number of markers of a board, at most."""
    if board.grid:
        return board.columns * board.rows
    return (board.columns * board.rows + 1) // 2


@dataclass(frozen=True)
class _Markers:
    """The markers of a dictionary in one picture."""

    corners: Sequence[Any]
    """The four corners of each marker (1, 4, 2) float32, pixels."""
    ids: Any
    """Their numbers (n, 1) int32; None if there are none."""

    def __len__(self) -> int:
        return len(self.corners)


def _markers(dictionary: str, grey: Uint8s, is_inverted: bool, most: int) -> _Markers:
    """The markers in a picture (h, w), black on white or, inverted, white on black, up to number `most` of a dictionary."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(_dictionary(dictionary, most), parameters)
    corners, ids, _ = detector.detectMarkers(255 - grey if is_inverted else grey)
    return _Markers(corners, ids)


def _checkers_seen(board: Board, sample: Sequence[Uint8s]) -> int:
    return _corners_seen([detect_board(grey, board) for grey in sample])


def _corners_seen(views: Sequence[BoardView | None]) -> int:
    """Number of corners in views of a board, as far as they lie where a plane shows them: a wrong layout mixes them up."""
    count = 0
    for view in views:
        if view is None:
            continue
        limit = _PLANE_SHARE * float(np.ptp(view.image, axis=0).max())
        inliers = cv2.findHomography(view.board[:, :2], view.image, cv2.RANSAC, limit)[1]
        count += 0 if inliers is None else int(np.count_nonzero(inliers))
    return count


def differences(stated: Board, printed: Board) -> list[str]:
    """Messages on how a board is printed, where that is not what was stated."""
    notes: list[str] = []
    if (printed.columns, printed.rows) != (stated.columns, stated.rows):
        counted = "squares" if printed.marker else "inner corners"
        notes.append(
            f"the board has {printed.columns}x{printed.rows} {counted}, not {stated.columns}x{stated.rows}: "
            f"a checkerboard is stated by its inner corners, a ChArUco board by its squares"
        )
    if printed.dictionary != stated.dictionary:
        notes.append(f"its markers are of the dictionary {printed.dictionary}, not {stated.dictionary}")
    if printed.is_inverted:
        notes.append("its markers are white on black (inverted)")
    if printed.grid:
        notes.append(f"it is a grid of markers, {printed.square:g} apart, numbered {printed.grid}wards")
    if printed.is_legacy:
        notes.append("its layout is that of OpenCV before 4.6 (legacy)")
    return notes


def _dictionary_size(name: str) -> int:
    """Number of markers of a dictionary."""
    return len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}")).bytesList)


def _dictionary(name: str, most: int) -> Any:
    """A dictionary's first markers, at most `most`: boards use these, and more take time and may be mistaken for others."""
    whole = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
    return cv2.aruco.Dictionary(whole.bytesList[:most], whole.markerSize, whole.maxCorrectionBits)


def board_corners(board: Board) -> Float64s:
    """(n, 3) float64 places of all corners on the board, by their numbers; of the centre only, if halves are not told apart."""
    columns = board.columns
    rows = board.rows
    if board.grid:
        every = _Markers([np.zeros((4, 2))] * (columns * rows), np.arange(columns * rows))
        view = _grid_view(board, every)
        assert view is not None
        return view.board.astype(np.float64)
    if not is_told_from_half_turn(board):
        return np.zeros((1, 3))
    if board.marker:
        columns -= 1
        rows -= 1
    grid = np.mgrid[0:columns, 0:rows].T.reshape(-1, 2) * board.square
    return np.column_stack([grid, np.zeros(len(grid))])


def detect_board(grey: Uint8s, board: Board) -> BoardView | None:
    """The corners in a picture (h, w); None if the board is not found in it."""
    if board.marker:
        return _detect_marked(grey, board, _markers(board.dictionary, grey, board.is_inverted, _marker_count(board)))
    size = board.columns, board.rows
    if min(size) < 3:
        return None
    image = _checker_corners(grey, board)
    if image is None:
        return None
    grid = np.mgrid[0 : board.columns, 0 : board.rows].T.reshape(-1, 2) * board.square
    points = np.column_stack([grid, np.zeros(len(grid))]).astype(np.float32)
    if _begins_white(grey, board, image):
        image = image[::-1].copy()
    return BoardView(np.arange(len(points), dtype=np.int32), points, image)


def _checker_corners(grey: Uint8s, board: Board) -> Float32s | None:
    """(n, 2) inner corners of a checkerboard in a picture; None if it is not found, or others were taken for them."""
    size = board.columns, board.rows
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    for more in (0, cv2.CALIB_CB_EXHAUSTIVE):
        is_found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags | more)
        if not is_found:
            return None
        image = np.asarray(corners, np.float32).reshape(-1, 2)
        if _alternates_outside(grey, board, image):
            return image
    return None


def _alternates_outside(grey: Uint8s, board: Board, image: Float32s) -> bool:
    """Do the squares beyond the outermost corners alternate as those within do?  At the board's own edge they don't.

    The search may take a line of the board's edge for inner corners, and then has the board turned by a quarter.
    """
    corners = np.mgrid[0 : board.columns, 0 : board.rows].T.reshape(-1, 2).astype(np.float32)
    H, _ = cv2.findHomography(corners, image)
    if H is None:
        return False
    middles = np.mgrid[0 : board.columns + 1, 0 : board.rows + 1].T.astype(np.float32) - 0.5
    places = cv2.perspectiveTransform(middles.reshape(-1, 1, 2), H).reshape(middles.shape).astype(np.float32)
    levels = cv2.remap(grey, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    signs = np.where(np.indices(levels.shape).sum(axis=0) % 2, -1, 1)
    contrast = (levels - np.median(levels)) * signs
    within = float(contrast[1:-1, 1:-1].mean())
    for line in (contrast[0], contrast[-1], contrast[:, 0], contrast[:, -1]):
        if float(line.mean()) * within < _LEAST_ALTERNATION * within**2:
            return False
    return True


def _begins_white(grey: Uint8s, board: Board, image: Float32s) -> bool:
    """Is the square beside the first corner of a checkerboard white?  Then it is turned by half, if its colours tell that."""
    if not is_told_from_half_turn(board):
        return False
    corners = image.reshape(board.rows, board.columns, 2)
    middles = (corners[:-1, :-1] + corners[1:, 1:] + corners[:-1, 1:] + corners[1:, :-1]) / 4
    levels = cv2.remap(grey, middles[..., 0].copy(), middles[..., 1].copy(), cv2.INTER_LINEAR).astype(np.float32)
    signs = np.where(np.indices(levels.shape).sum(axis=0) % 2, -1, 1)
    return bool(levels[signs > 0].mean() > levels[signs < 0].mean())


def is_told_from_half_turn(board: Board) -> bool:
    """Does a board look different when turned by half?  A checkerboard does not, if both its counts are even or both odd."""
    return board.marker > 0 or (board.columns + board.rows) % 2 == 1


def _detect_marked(grey: Uint8s, board: Board, markers: _Markers) -> BoardView | None:
    """The corners of a board with markers in a picture (h, w); None if it is not found."""
    if len(markers) == 0 or board.columns * board.rows // (1 if board.grid else 2) > _dictionary_size(board.dictionary):
        return None  # perhaps the dictionary has not as many markers as the board
    if board.grid:
        return _grid_view(board, markers)
    return _charuco_view(grey, board, markers)


def _charuco_view(grey: Uint8s, board: Board, markers: _Markers) -> BoardView | None:
    """The inner corners of a ChArUco board's squares."""
    dictionary = _dictionary(board.dictionary, _marker_count(board))
    pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)
    pattern.setLegacyPattern(board.is_legacy)
    picture = 255 - grey if board.is_inverted else grey
    corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(
        picture, markerCorners=markers.corners, markerIds=markers.ids
    )
    if ids is None or len(ids) < min(_LEAST_CORNERS, (board.columns - 1) * (board.rows - 1)):
        return None
    numbers = np.asarray(ids, np.int32).ravel()
    points = np.asarray(pattern.getChessboardCorners(), np.float32)[numbers]
    return BoardView(numbers, points, np.asarray(corners, np.float32).reshape(-1, 2))


def _grid_view(board: Board, markers: _Markers) -> BoardView | None:
    """The corners of the markers of a grid: four a marker, clockwise from its own top left."""
    numbers: list[int] = []
    points: list[tuple[float, float, float]] = []
    image: list[Any] = []
    edge = board.marker
    for marker, corners in zip(np.ravel(markers.ids).tolist(), markers.corners, strict=True):
        row, column = divmod(marker, board.columns)
        if row >= board.rows:
            continue
        left = column * board.square
        top = (row if board.grid == "down" else -row) * board.square
        numbers += range(4 * marker, 4 * marker + 4)
        points += [(left, top, 0), (left + edge, top, 0), (left + edge, top + edge, 0), (left, top + edge, 0)]
        image.append(np.reshape(corners, (4, 2)))
    if len(numbers) < min(_LEAST_CORNERS, 4 * board.columns * board.rows):
        return None
    return BoardView(np.array(numbers, np.int32), np.array(points, np.float32), np.concatenate(image).astype(np.float32))

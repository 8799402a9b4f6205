"""A lens from pictures of a board: corners found, the lens fitted, how well it fits and where in the picture it was seen.

References
----------
Zhang, A flexible new technique for camera calibration, PAMI 2000; Garrido-Jurado et al., ArUco, Pattern Recognition 2014 (both as
OpenCV has them).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from .capture.files import BadCapture, decode
from .capture.lens_fit import STARTS, fit_lens
from .capture.video import is_video, pictures
from .types import Capture, Float32s, Float64s, Uint8s

_LEAST_PICTURES, _LEAST_CORNERS = 5, 8
_VIDEO_STEP, _MOST_OF_A_VIDEO = 15, 60
_CELLS = (8, 6)
"""Of the picture, across and down, in which corners are counted."""
_GOOD_PX, _BAD_PX = 0.3, 1.0
"""Residuals that are drawn green, and from which on they are red."""
_POOR_PX = 1.0
"""A lens that misses corners by more, rms, is of another kind than was asked for, or the board is not flat."""


@dataclass(frozen=True)
class Board:
    """What was photographed."""

    columns: int
    """Inner corners of a checkerboard; of ChArUco squares."""
    rows: int
    square: float = 1.0
    """Edge of a square."""
    marker: float = 0.0
    """Edge of a ChArUco marker; 0: a plain checkerboard."""
    dictionary: str = "4X4_50"
    """Of its markers."""


@dataclass(frozen=True)
class _Seen:
    """The board in one picture."""

    name: str
    board: Float32s
    """(n, 3) corners on the board..."""
    image: Float32s
    """...and (n, 2) in the picture."""


def board_files(
    camera: str, pictures_of_it: Mapping[str, bytes], board: Mapping[str, float | str], model: str
) -> tuple[dict[str, bytes], list[str]]:
    """A calibration file and a plot of its coverage, by name, and what to say of them.

    Parameters
    ----------
    camera : its id.
    pictures_of_it : photographs or videos, as they lie on disk, by name.
    board : fields of `Board` by name.
    model : "brown", "rational" (as OpenCV fits them), or a key of `lens_fit.STARTS`.

    Raises
    ------
    ValueError
        The board is seen in too few pictures, or they do not tell the lens.
    """
    what, seen, size, notes = Board(**board), [], (0, 0), []  # type: ignore[arg-type]
    for name, data in pictures_of_it.items():
        try:
            found = _pictures(Capture(name, np.frombuffer(data, np.uint8)))
        except BadCapture as error:
            notes.append(str(error))
            continue
        for each, image in found:
            if size not in {(0, 0), (image.shape[1], image.shape[0])}:
                notes.append(f"{each} has another size than the first picture")
                continue
            size = image.shape[1], image.shape[0]
            corners = _corners(each, np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8), what)
            seen += [corners] if corners else []
            notes += [] if corners else [f"{each}: no board is found"]
    if len(seen) < _LEAST_PICTURES:
        raise ValueError(f"the board is seen in {len(seen)} pictures, {_LEAST_PICTURES} are needed: are columns and rows right?")
    K, distortion, residuals = _fitted(seen, size, model)
    rms = [float(np.sqrt((r**2).sum(axis=1).mean())) for r in residuals]
    covered = _covered(seen, size)
    entry = {
        "K": K.tolist(),
        "width": size[0],
        "height": size[1],
        "model": model,
        "distortion": distortion.tolist(),
        "residuals_px": {each.name: round(value, 4) for each, value in zip(seen, rms, strict=True)},
        "covered": round(covered, 3),
    }
    whole = float(np.sqrt(np.mean(np.concatenate([(r**2).sum(axis=1) for r in residuals]))))
    words = [f"{len(seen)} pictures, {whole:.2f} px rms, corners in {100 * covered:.0f} % of the picture's cells", *notes]
    if whole > _POOR_PX:
        words.append(f"{whole:.1f} px is much: another --model may fit this lens, or the board is not flat")
    plot = cv2.imencode(".png", _plot(seen, residuals, size))[1].tobytes()
    return {f"{camera}.json": json.dumps({camera: entry}, indent=1).encode(), f"{camera}-coverage.png": plot}, words


def _pictures(capture: Capture) -> list[tuple[str, Uint8s]]:
    if is_video(capture):
        return list(pictures(capture, _VIDEO_STEP, _MOST_OF_A_VIDEO))
    return [(capture.name, decode(capture))]


def _corners(name: str, grey: Uint8s, board: Board) -> _Seen | None:
    size = board.columns, board.rows
    if board.marker:
        table = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
        pattern = cv2.aruco.CharucoBoard(size, board.square, board.marker, table)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
        if ids is None or len(ids) < _LEAST_CORNERS:
            return None
        points = np.asarray(pattern.getChessboardCorners(), np.float32)[np.asarray(ids).ravel()]
        return _Seen(name, points, np.asarray(corners, np.float32).reshape(-1, 2))
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
    if not found:
        return None
    grid = np.mgrid[0 : board.columns, 0 : board.rows].T.reshape(-1, 2) * board.square
    points = np.column_stack([grid, np.zeros(len(grid))]).astype(np.float32)
    return _Seen(name, points, np.asarray(corners, np.float32).reshape(-1, 2))


def _fitted(seen: Sequence[_Seen], size: tuple[int, int], model: str) -> tuple[Float64s, Float64s, list[Float64s]]:
    """K, coefficients, and residuals (n, 2) of each picture, pixels."""
    if model in STARTS:
        return fit_lens(
            [each.board.astype(np.float64) for each in seen], [each.image.astype(np.float64) for each in seen], size, model
        )
    board: list[Any] = [each.board[:, None] for each in seen]
    image: list[Any] = [each.image[:, None] for each in seen]
    flags = cv2.CALIB_RATIONAL_MODEL if model == "rational" else 0
    try:
        _, K, D, turns, shifts = cv2.calibrateCamera(board, image, size, np.eye(3), np.zeros(5), flags=flags)
    except cv2.error as error:
        raise ValueError(f"these pictures do not tell a {model} lens: {error.err}") from None
    D = np.asarray(D, dtype=np.float64).ravel()[: {"brown": 5, "rational": 8}[model]]
    residuals = []
    for X, x, turn, shift in zip(board, image, turns, shifts, strict=True):
        there = cv2.projectPoints(X.astype(np.float64), turn, shift, K, D)[0]
        residuals.append(np.asarray(x.reshape(-1, 2) - there.reshape(-1, 2), dtype=np.float64))
    return np.asarray(K, dtype=np.float64), D, residuals


def _covered(seen: Sequence[_Seen], size: tuple[int, int]) -> float:
    """Share of the picture's cells that have a corner: where there is none, the lens is extrapolated."""
    x = np.concatenate([each.image for each in seen]) / size
    cells = np.clip((x * _CELLS).astype(int), 0, np.array(_CELLS) - 1)
    return len(np.unique(cells, axis=0)) / (_CELLS[0] * _CELLS[1])


def _plot(seen: Sequence[_Seen], residuals: Sequence[Float64s], size: tuple[int, int]) -> Uint8s:
    """(h, w, 3) BGR: every corner where it was seen, green where the lens fits it, red where not."""
    scale = min(1.0, 1280 / max(size))
    plot = np.full((round(size[1] * scale), round(size[0] * scale), 3), 255, np.uint8)
    for k in range(1, _CELLS[0]):
        cv2.line(plot, (plot.shape[1] * k // _CELLS[0], 0), (plot.shape[1] * k // _CELLS[0], plot.shape[0]), (225, 225, 225))
    for k in range(1, _CELLS[1]):
        cv2.line(plot, (0, plot.shape[0] * k // _CELLS[1]), (plot.shape[1], plot.shape[0] * k // _CELLS[1]), (225, 225, 225))
    for each, off in zip(seen, residuals, strict=True):
        badness = np.clip((np.linalg.norm(off, axis=1) - _GOOD_PX) / (_BAD_PX - _GOOD_PX), 0, 1)
        for (x, y), bad in zip(each.image * scale, badness, strict=True):
            cv2.circle(plot, (round(float(x)), round(float(y))), 3, (60, 160 * (1 - bad), 60 + 160 * bad), -1, cv2.LINE_AA)
    return plot

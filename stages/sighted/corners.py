"""Corners of a board in each frame of recordings, with standard deviations from how well they lie in a plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..core.lenses import lens_rays
from ..types import Float64s, Int32s, Lens, Uint8s
from .boards import Board, BoardView, as_printed, detect_board, is_told_from_half_turn, spread_over, with_most_markers
from .rows import Rows
from .video import Recording

_SAMPLE = 12
"""Frames of each recording, spread over it, that tell how the board is printed."""
_MOST_SAMPLES = 12
"""Frames of all recordings that do, those with the most markers."""
_LEAST_SIGMA_PX = 0.1
"""Standard deviation in pixels of a corner that agrees perfectly with the others: what detection leaves."""
_OUTLIER_SIGMAS = 3.5
_OUTLIER_PX = 1.0
"""Corners that lie further from where the plane has them than both of these are left out."""
_FIT_SHARE = 0.02
"""Distance, as a share of the board's extent in the picture, up to which a corner may determine its plane: lenses bend planes."""


@dataclass(frozen=True)
class BoardFound:
    """What a recording shows of a board."""

    rows: Rows
    """Its corners by number."""
    frames: int
    """Number of frames that were searched."""
    frames_with_board: int
    picture: Uint8s
    """(h, w, 3) uint8 BGR: the frame that shows most of the board."""


def board_of_recordings(stated: Board, recordings: Sequence[Recording], most_per_s: float) -> Board:
    """The board as it is printed, by frames of all recordings.  Raises BadCapture.

    most_per_s: frames of a second that are enough.
    """
    sample: list[Uint8s] = []
    for recording in recordings:
        sample += spread_over((frame.grey for frame in recording.frames(most_per_s)), _SAMPLE)
    if stated.marker:
        sample = with_most_markers(stated, sample, _MOST_SAMPLES)
    return as_printed(stated, sample)


def find_corners(recording: Recording, board: Board, lens: Lens | None, most_per_s: float) -> BoardFound:
    """The corners of a board in a recording.  Raises BadCapture if there is no frame.

    Parameters
    ----------
    recording : of one camera.
    board : as it is printed.
    lens : of frames of the recording's size; where K is not known, bent lines count as noise.
    most_per_s : frames of a second that are enough.
    """
    times: list[Float64s] = []
    numbers: list[Int32s] = []
    xy: list[Float64s] = []
    sigmas: list[Float64s] = []
    frames = 0
    most = -1
    picture = np.zeros((1, 1, 3), np.uint8)
    for frame in recording.frames(most_per_s):
        frames += 1
        view = detect_board(frame.grey, board)
        seen = 0 if view is None else len(view)
        if seen > most:
            most = seen
            picture = frame.image
        if view is None:
            continue
        sigma = plane_sigmas(view, lens)
        if not is_told_from_half_turn(board):
            view = _centre(view)
            sigma = np.full(1, float(np.nanmedian(sigma)))
        known = np.isfinite(sigma)
        times.append(np.full(int(known.sum()), frame.time))
        numbers.append(view.ids[known])
        xy.append(view.image[known].astype(np.float64))
        sigmas.append(sigma[known])
    if not times:
        return BoardFound(Rows.none(), frames, 0, picture)
    rows = Rows(np.concatenate(times), np.concatenate(numbers), np.concatenate(xy), np.concatenate(sigmas))
    return BoardFound(rows, frames, len(times), picture)


def plane_sigmas(view: BoardView, lens: Lens | None) -> Float64s:
    """(n,) float64 standard deviation of each corner in pixels: how well all lie in a plane; nan for those that do not.

    Motion blur and a rolling shutter bend and smear the board: its corners then lie badly.
    """
    on_board = view.board[:, :2].astype(np.float64)
    straight = view.image.astype(np.float64)
    if lens is not None and lens.K is not None:
        rays = lens_rays(lens, straight)
        # on a plane before the board, so that wide lenses have no rays beside it
        ahead = np.nansum(rays, axis=0)
        ahead /= np.linalg.norm(ahead)
        across = np.linalg.svd(ahead[None])[2][1:]
        straight = float(lens.K[0, 0]) * (rays @ across.T) / (rays @ ahead)[:, None]
    sigmas = np.full(len(view), np.nan)
    known = np.isfinite(straight).all(axis=1)
    if known.sum() < 4:
        return sigmas
    limit = max(_OUTLIER_PX, _FIT_SHARE * float(np.ptp(straight[known], axis=0).max()))
    H, inliers = cv2.findHomography(on_board[known], straight[known], cv2.RANSAC, limit)
    if H is None:
        return sigmas
    on_plane = np.flatnonzero(known)[inliers.ravel() > 0]
    expected = cv2.perspectiveTransform(on_board[None, on_plane], H)[0]
    distance = np.linalg.norm(straight[on_plane] - expected, axis=1)
    # a homography takes eight of the coordinates
    free = 2 * len(on_plane) - 8
    spread = float(np.sqrt((distance**2).sum() / free)) if free > 0 else _OUTLIER_PX
    sigma = float(np.hypot(_LEAST_SIGMA_PX, spread))
    is_good = distance <= max(_OUTLIER_PX, _OUTLIER_SIGMAS * sigma)
    sigmas[on_plane[is_good]] = sigma
    return sigmas


def _centre(view: BoardView) -> BoardView:
    """The centre of a board as its only point: it is the same where corners cannot be told from those opposite."""
    middle = (view.board.min(axis=0) + view.board.max(axis=0)) / 2
    H, _ = cv2.findHomography(view.board[:, :2], view.image)
    image = cv2.perspectiveTransform(middle[None, None, :2].astype(np.float64), H)[0]
    return BoardView(np.zeros(1, np.int32), middle[None], image.astype(np.float32))

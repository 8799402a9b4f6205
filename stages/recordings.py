"""Observations from recordings: a lamp or a board that is carried through the views of fixed cameras, all at the same time.

Reference: T. Svoboda, D. Martinec, T. Pajdla, A Convenient Multi-Camera Self-Calibration for Virtual Environments, Presence 2005.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import BinaryIO

import numpy as np

from .capture.files import BadCapture
from .core.cameras import scaled_intrinsics
from .sighted.boards import DICTIONARIES, Board, board_corners, differences, is_told_from_half_turn
from .sighted.corners import board_of_recordings, find_corners
from .sighted.lamp import find_lamp
from .sighted.picture import found_picture
from .sighted.rows import Rows
from .sighted.video import Recording, open_recording
from .types import Float64s, Lens, Observations, Sightings, ThingSurvey

_MOST_PER_S = 10.0
"""Frames of a second in which things are looked for: between them they move little."""
_MOST_ASPECT_CHANGE = 0.01
"""Largest relative difference between the shapes of two pictures of which one is the other at another size."""


def observe_recordings(
    recordings: Mapping[str, BinaryIO],
    board: Mapping[str, float | str] | None = None,
    *,
    times: Mapping[str, Float64s] | None = None,
    lenses: Mapping[str, Lens] | None = None,
) -> Sightings:
    """What recordings of several cameras, made at the same time, show of a lamp or a board.

    Places are in pixels of the camera's captures: of the size that its lens states, otherwise that of the recording.  Times are
    those of the videos, or `times`; that recordings began at different moments is left to the solver.  Raises ValueError if no
    recording can be read or nothing is found in any.

    Parameters
    ----------
    recordings : video files, open for reading in binary mode, by camera; each is read more than once, and never kept in memory.
    board : fields of `sighted.boards.Board` by name, lengths in metres; None: a lamp is looked for.
    times : (n,) float64 seconds of each frame by the camera's clock, nan where it is not known, for cameras whose videos do not
        tell it.
    lenses : as the site states them.
    """
    opened: dict[str, Recording] = {}
    unusable: list[str] = []
    for camera, file in recordings.items():
        try:
            recording = open_recording(camera, file, (times or {}).get(camera))
            _check_shape(recording, (lenses or {}).get(camera, Lens()))
        except BadCapture as error:
            unusable.append(str(error))
        else:
            opened[camera] = recording
    if len(opened) < 2:
        raise ValueError("; ".join([f"recordings of two cameras or more are needed, not of {len(opened)}", *unusable]))
    if board is None:
        found = _observe_lamp(opened, lenses or {})
    else:
        found = _observe_board(Board(**board), opened, lenses or {})  # type: ignore[arg-type]
    return replace(found, messages=(*unusable, *found.messages))


def _check_shape(recording: Recording, lens: Lens) -> None:
    """Raise BadCapture if a recording is not its camera's whole picture at some size."""
    width, height = recording.size
    if lens.width and abs(width * lens.height / (height * lens.width) - 1) > _MOST_ASPECT_CHANGE:
        raise BadCapture(
            f"{recording.name} is {width} x {height}, but its lens is for {lens.width} x {lens.height} pixels: "
            "it must show all of the picture, and not be turned"
        )


def _observe_board(stated: Board, recordings: Mapping[str, Recording], lenses: Mapping[str, Lens]) -> Sightings:
    """Corners of a board."""
    if stated.dictionary not in DICTIONARIES:
        raise ValueError(f"there is no dictionary {stated.dictionary!r}; there are {', '.join(DICTIONARIES)}")
    printed = board_of_recordings(stated, list(recordings.values()), _MOST_PER_S)
    messages = differences(stated, printed)
    if not is_told_from_half_turn(printed):
        messages.append("the board looks the same turned by half: only its centre is used, which gives no scale")
    rows: dict[str, Rows] = {}
    pictures: dict[str, bytes] = {}
    for camera, recording in recordings.items():
        lens = lenses.get(camera, Lens())
        found = find_corners(recording, printed, _scaled_lens(lens, recording.size), _MOST_PER_S)
        text = f"{camera}: the board is found in {found.frames_with_board} of {found.frames} frames, {len(found.rows)} corners"
        messages.append(text)
        pictures[camera] = found_picture(found.picture, found.rows, text, is_track=False)
        rows[camera] = found.rows.with_motion().scaled(_factor(lens, recording.size))
    if not any(map(len, rows.values())):
        raise ValueError("no recording shows the board: are its columns and rows right, and its dictionary of markers?")
    corners = board_corners(printed)
    names = [f"corner{k}" for k in range(len(corners))]
    return Sightings(_joined(rows, names), ThingSurvey(tuple(names), lengths=_lengths(corners)), pictures, tuple(messages))


def _observe_lamp(recordings: Mapping[str, Recording], lenses: Mapping[str, Lens]) -> Sightings:
    """The track of a lamp."""
    messages: list[str] = []
    rows: dict[str, Rows] = {}
    pictures: dict[str, bytes] = {}
    for camera, recording in recordings.items():
        found = find_lamp(recording, _MOST_PER_S)
        text = f"{camera}: the lamp is found in {len(found.rows)} of {found.frames} frames"
        if len(found.rows) == 0:
            text = f"{camera}: no lamp is found: nothing bright moves before the background in {found.frames} frames"
        messages.append(text)
        pictures[camera] = found_picture(found.picture, found.rows, text, is_track=True)
        rows[camera] = found.rows.with_motion().scaled(_factor(lenses.get(camera, Lens()), recording.size))
    if not any(map(len, rows.values())):
        raise ValueError("no recording shows a lamp: nothing bright moves before the background of any camera")
    return Sightings(_joined(rows, ["lamp"]), ThingSurvey(("lamp",)), pictures, tuple(messages))


def _scaled_lens(lens: Lens, size: tuple[int, int]) -> Lens:
    """The lens for pictures of another size (width, height)."""
    factor = 1 / _factor(lens, size)
    if lens.K is None or factor == 1:
        return lens
    return replace(lens, K=scaled_intrinsics(lens.K, factor, factor), width=size[0], height=size[1])


def _factor(lens: Lens, size: tuple[int, int]) -> float:
    """By how much captures are larger than a recording of size (width, height)."""
    return lens.width / size[0] if lens.width else 1.0


def _lengths(corners: Float64s) -> tuple[tuple[int, int, float], ...]:
    """For each corner of a board (n, 3), the one farthest from it, and the distance: rows of corner, corner, metres."""
    lengths = {}
    for k, corner in enumerate(corners):
        distances = np.linalg.norm(corners - corner, axis=1)
        farthest = int(distances.argmax())
        lengths[min(k, farthest), max(k, farthest)] = float(distances[farthest])
    return tuple((a, b, distance) for (a, b), distance in sorted(lengths.items()) if distance > 0)


def _joined(rows: Mapping[str, Rows], things: Sequence[str]) -> Observations:
    """The rows of all cameras that saw something."""
    cameras = tuple(camera for camera, found in rows.items() if len(found))
    parts = [rows[camera] for camera in cameras]
    numbers = [np.full(len(part), k, np.int32) for k, part in enumerate(parts)]
    return Observations(
        cameras,
        tuple(things),
        np.concatenate(numbers),
        np.concatenate([part.things for part in parts]),
        np.concatenate([part.times for part in parts]),
        np.concatenate([part.xy for part in parts]),
        np.concatenate([part.sigma_px for part in parts]),
    )

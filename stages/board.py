"""Calibrate a lens from pictures of a board: find corners, fit the lens, report the fit and its coverage of the picture.

OpenCV fits perspective lenses starting from homographies between board and picture.  A fisheye picture of a board is not
related to it by a homography, and a ray 90 degrees off the axis meets no image plane: for these lenses, boards are placed by
homographies to *rays*, and least squares then refine lens and poses.

References: Zhang, A flexible new technique for camera calibration, PAMI 2000; Garrido-Jurado et al., ArUco, Pattern
Recognition 2014 (both as implemented in OpenCV); Kannala & Brandt, PAMI 2006, section 4 (boards and a generic lens).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np

from .capture.files import BadCapture
from .capture.video import all_pictures
from .core.least_squares import levenberg_marquardt
from .core.lenses import PROJECTIONS, lens_rays, usable_angle
from .sighted.boards import DICTIONARIES, Board, BoardView, as_printed, detect_board, differences, spread_over
from .types import Capture, Float64s, Lens, Uint8s

_LEAST_PICTURES = 5
"""Fewest pictures with the board from which a lens is fitted."""
_VIDEO_STEP = 3
"""Step in frames between the pictures taken from a video; longer where there would be more than `_MOST_PER_VIDEO`."""
_MOST_PER_VIDEO = 60
"""Most pictures taken from a video."""
_SAMPLE = 12
"""Number of pictures, spread over all, that tell how the board is printed; up to twice as many are taken."""
_CELLS = (8, 6)
"""Columns and rows of the grid of cells over the picture in which corners are counted."""
_GOOD_PX = 0.3
_BAD_PX = 1.0
"""Residuals in pixels: up to the first a corner is drawn green, from the second on red."""
_WARNING_PX = 1.0
"""RMS residual in pixels above which the report warns: the lens is of another model, or the board is not flat."""
_MOST_RMS = 0.01
"""RMS residual, as a share of the picture's longer side, above which there is no result: numbers of corners were mixed up."""
_LEAST_COVERED = 0.4
"""Share of the cells with corners below which the report warns."""


def board_files(
    camera: str, pictures_of_it: Mapping[str, bytes], board: Mapping[str, float | str], model: str
) -> tuple[dict[str, bytes], list[str]]:
    """A calibration file and a plot of its coverage, by file name, and messages for the operator.

    The board may be printed in another way than stated (inverted, in the layout of another version of OpenCV, with markers of
    another dictionary, counted by corners instead of squares): what is found in most pictures is used, and said.  Raises
    ValueError if the board is found in too few pictures, or if they do not determine the lens.

    Parameters
    ----------
    camera : id of the camera.
    pictures_of_it : contents of photograph or video files, by file name.
    board : fields of `Board` by name.
    model : "brown" or "rational" (fitted by OpenCV), or a key of `STARTS`.
    """
    stated = Board(**board)  # type: ignore[arg-type]
    if stated.dictionary not in DICTIONARIES:
        raise ValueError(f"there is no dictionary {stated.dictionary!r}; there are {', '.join(DICTIONARIES)}")
    printed = as_printed(stated, spread_over((grey for _, grey in _grey_pictures(pictures_of_it, [])), _SAMPLE))
    notes = differences(stated, printed)
    views: dict[str, BoardView] = {}
    size = (0, 0)
    for name, grey in _grey_pictures(pictures_of_it, notes):
        height, width = grey.shape
        if size not in {(0, 0), (width, height)}:
            notes.append(f"{name} is not the same size as the first picture")
            continue
        size = width, height
        view = detect_board(grey, printed)
        if view is None:
            notes.append(f"{name}: no board is found")
        else:
            views[name] = view
    if len(views) < _LEAST_PICTURES:
        raise ValueError(f"the board is seen in {len(views)} pictures, {_LEAST_PICTURES} are needed: are columns and rows right?")
    seen = list(views.values())
    K, distortion, residuals = _fit(seen, size, model)
    squares = [(r**2).sum(axis=1) for r in residuals]
    rms_px = [float(np.sqrt(r.mean())) for r in squares]
    overall = float(np.sqrt(np.mean(np.concatenate(squares))))
    if overall > _MOST_RMS * max(size):
        as_found = "; ".join(differences(stated, printed)) or "it was found as stated"
        what = f"no {model} lens shows such a board like this: {overall:.0f} px rms ({as_found})"
        raise ValueError(f"{what}; are columns and rows right, and the pictures not mirrored, or is the lens of another --model?")
    covered = _covered_share(seen, size)
    entry = {
        "K": K.tolist(),
        "width": size[0],
        "height": size[1],
        "model": model,
        "distortion": distortion.tolist(),
        "residuals_px": {name: round(value, 4) for name, value in zip(views, rms_px, strict=True)},
        "covered": round(covered, 3),
    }
    messages = [f"{len(views)} pictures, {overall:.2f} px rms, corners in {100 * covered:.0f} % of the picture's cells", *notes]
    if covered < _LEAST_COVERED:
        messages.append("the lens is known only where corners were: hold the board in every part of the picture, near and far")
    if overall > _WARNING_PX:
        messages.append(f"{overall:.1f} px rms is high: another --model may fit this lens better, or the board is not flat")
    plot = cv2.imencode(".png", _plot(seen, residuals, size))[1].tobytes()
    return {f"{camera}.json": json.dumps({camera: entry}, indent=1).encode(), f"{camera}-coverage.png": plot}, messages


def _grey_pictures(files: Mapping[str, bytes], notes: list[str]) -> Iterator[tuple[str, Uint8s]]:
    """Name and (h, w) grey levels of each picture; a note is added for each file that cannot be read, or not whole."""
    for name, data in files.items():
        capture = Capture(name, np.frombuffer(data, np.uint8))
        try:
            for picture_name, image in all_pictures(capture, _VIDEO_STEP, _MOST_PER_VIDEO):
                yield picture_name, np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        except BadCapture as error:
            notes.append(str(error))


def _fit(views: Sequence[BoardView], size: tuple[int, int], model: str) -> tuple[Float64s, Float64s, list[Float64s]]:
    """K, distortion coefficients, and residuals (n, 2) of each picture, pixels."""
    if model in STARTS:
        return fit_lens([v.board.astype(np.float64) for v in views], [v.image.astype(np.float64) for v in views], size, model)
    board: list[Any] = [v.board[:, None] for v in views]
    image: list[Any] = [v.image[:, None] for v in views]
    flags = cv2.CALIB_RATIONAL_MODEL if model == "rational" else 0
    try:
        _, K, D, rotations, translations = cv2.calibrateCamera(board, image, size, np.eye(3), np.zeros(5), flags=flags)
    except cv2.error as error:
        raise ValueError(f"these pictures do not determine a {model} lens: {error.err}") from None
    D = np.asarray(D, dtype=np.float64).ravel()[: {"brown": 5, "rational": 8}[model]]
    residuals = []
    for X, x, rotation, translation in zip(board, image, rotations, translations, strict=True):
        projected = cv2.projectPoints(X.astype(np.float64), rotation, translation, K, D)[0]
        residuals.append(np.asarray(x.reshape(-1, 2) - projected.reshape(-1, 2), dtype=np.float64))
    return np.asarray(K, dtype=np.float64), D, residuals


def _covered_share(views: Sequence[BoardView], size: tuple[int, int]) -> float:
    """Share of the picture's cells that contain a corner: in the others the lens is extrapolated."""
    x = np.concatenate([v.image for v in views]) / size
    cells = np.clip((x * _CELLS).astype(int), 0, np.array(_CELLS) - 1)
    return len(np.unique(cells, axis=0)) / (_CELLS[0] * _CELLS[1])


def _plot(views: Sequence[BoardView], residuals: Sequence[Float64s], size: tuple[int, int]) -> Uint8s:
    """(h, w, 3) BGR: every corner where it was detected, from green (small residual) to red (large)."""
    scale = min(1.0, 1280 / max(size))
    plot = np.full((round(size[1] * scale), round(size[0] * scale), 3), 255, np.uint8)
    plot[:, [plot.shape[1] * k // _CELLS[0] for k in range(1, _CELLS[0])]] = 225
    plot[[plot.shape[0] * k // _CELLS[1] for k in range(1, _CELLS[1])]] = 225
    for view, residual in zip(views, residuals, strict=True):
        badness = np.clip((np.linalg.norm(residual, axis=1) - _GOOD_PX) / (_BAD_PX - _GOOD_PX), 0, 1)
        for (x, y), bad in zip(view.image * scale, badness, strict=True):
            cv2.circle(plot, (round(float(x)), round(float(y))), 3, (60, 160 * (1 - bad), 60 + 160 * bad), -1, cv2.LINE_AA)
    return plot


STARTS: dict[str, tuple[float, ...]] = {
    "fisheye": (0.0, 0.0, 0.0, 0.0),
    "division": (-0.1,),
    "fov": (0.9,),
    "eucm": (0.6, 1.0),
    "double-sphere": (-0.2, 0.6),
}
"""Lens models that are fitted here instead of by OpenCV, with the initial coefficients of a usual wide lens."""

_HALF_FIELDS_DEG = (20.0, 30.0, 40.0, 52.0, 65.0, 80.0, 95.0)
"""Half fields of view to start from, in degrees between the centre of the picture and its nearer edges."""
_STEPS = 60
_RESIDUAL_LIMIT_PX = 100.0
"""Residual in pixels of a corner that the lens does not image, and upper limit of all residuals."""
_DERIVATIVE_STEP = 1e-6


@dataclass(frozen=True)
class _Estimate:
    """An estimate of the lens and of the board poses."""

    intrinsics: Float64s
    """fx, fy, cx, cy, then the distortion coefficients."""
    poses: Float64s
    """(m, 6) rotation vectors, from board to camera axes, and translations."""


def fit_lens(
    boards: Sequence[Float64s], corners: Sequence[Float64s], size: tuple[int, int], model: str
) -> tuple[Float64s, Float64s, list[Float64s]]:
    """K (3, 3), distortion coefficients, and residuals (n, 2) of each picture in pixels.

    Raises ValueError if no lens of this model fits the corners.

    Parameters
    ----------
    boards, corners : for each picture, (n, 3) corners on the board (z = 0), and (n, 2) where they are detected, pixels.
    size : (width, height) of the pictures.
    model : a key of `STARTS`.
    """
    starts = [start for half_deg in _HALF_FIELDS_DEG if (start := _start(boards, corners, size, model, half_deg))]
    if not starts:
        raise ValueError(f"these pictures do not determine a {model} lens: no field of view fits them")
    best_start = min(starts, key=lambda estimate: _cost(estimate, boards, corners, model))
    try:
        equations = partial(_equations, boards=boards, corners=corners, model=model)
        _, estimate = levenberg_marquardt(best_start, equations, _with_step, steps=_STEPS, damping=1e-3, relative_tolerance=1e-10)
    except np.linalg.LinAlgError:
        raise ValueError(f"these pictures do not determine a {model} lens: its parameters are not independent") from None
    fx, fy, cx, cy, *coefficients = estimate.intrinsics
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    residuals = [_residuals(estimate, k, X, x, model) for k, (X, x) in enumerate(zip(boards, corners, strict=True))]
    return K, np.array(coefficients), residuals


def _start(
    boards: Sequence[Float64s], corners: Sequence[Float64s], size: tuple[int, int], model: str, half_deg: float
) -> _Estimate | None:
    coefficients = np.array(STARTS[model])
    edge_ray = np.array([[np.sin(np.deg2rad(half_deg)), 0.0, np.cos(np.deg2rad(half_deg))]])
    with np.errstate(all="ignore"):
        edge_radius = PROJECTIONS[model].project(np.concatenate([coefficients, np.zeros(14)]), edge_ray)[0, 0]
    if not (np.isfinite(edge_radius) and edge_radius > 0):
        return None
    focal = 0.5 * min(size) / edge_radius
    centre = 0.5 * (np.array(size) - 1.0)
    K = np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])
    lens = Lens(K=K, distortion=coefficients, model=model)
    if np.rad2deg(usable_angle(lens)) < half_deg:
        return None
    poses = [_board_pose(X, lens_rays(lens, x)) for X, x in zip(boards, corners, strict=True)]
    known = [pose for pose in poses if pose is not None]
    if len(known) < len(poses):
        return None
    return _Estimate(np.array([focal, focal, *centre, *coefficients]), np.array([np.concatenate(pose) for pose in known]))


def _board_pose(board: Float64s, rays: Float64s) -> tuple[Float64s, Float64s] | None:
    """Rotation vector and translation of a board whose corners lie on rays (n, 3); None if fewer than six rays are known."""
    known = np.isfinite(rays).all(axis=1)
    if known.sum() < 6:
        return None
    scale = float(np.abs(board).max())
    plane, rays = np.column_stack([board[known, :2] / scale, np.ones(known.sum())]), rays[known]
    x, y, z = (rays[:, k, None] * plane for k in range(3))
    zeros = np.zeros_like(plane)
    rows = np.concatenate([np.hstack([zeros, -z, y]), np.hstack([z, zeros, -x]), np.hstack([-y, x, zeros])])
    H = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    if ((plane @ H.T) * rays).sum() < 0:  # choose the sign that puts the corners on the rays, not on their extensions backwards
        H = -H
    H = H / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    axes = np.column_stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])])
    u, _, vt = np.linalg.svd(axes)
    return np.asarray(cv2.Rodrigues(u @ vt)[0], dtype=np.float64).ravel(), H[:, 2] * scale


def _with_step(estimate: _Estimate, step: Float64s) -> _Estimate:
    n_intrinsics = len(estimate.intrinsics)
    return _Estimate(estimate.intrinsics + step[:n_intrinsics], estimate.poses + step[n_intrinsics:].reshape(-1, 6))


def _residuals(estimate: _Estimate, picture: int, board: Float64s, corners: Float64s, model: str) -> Float64s:
    """(n, 2) detected minus projected corners, pixels."""
    return corners - _project(estimate.intrinsics, estimate.poses[picture], board, model)


def _project(intrinsics: Float64s, pose: Float64s, board: Float64s, model: str) -> Float64s:
    R = np.asarray(cv2.Rodrigues(pose[:3])[0], dtype=np.float64)
    rays = board @ R.T + pose[3:]
    with np.errstate(all="ignore"):
        unit_rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        projected = PROJECTIONS[model].project(np.concatenate([intrinsics[4:], np.zeros(14)]), unit_rays)
    return np.asarray(projected * intrinsics[:2] + intrinsics[2:4], dtype=np.float64)


def _bounded(residuals: Float64s) -> Float64s:
    return np.clip(np.nan_to_num(residuals, nan=_RESIDUAL_LIMIT_PX), -_RESIDUAL_LIMIT_PX, _RESIDUAL_LIMIT_PX)


def _cost(estimate: _Estimate, boards: Sequence[Float64s], corners: Sequence[Float64s], model: str) -> float:
    residuals = (_residuals(estimate, k, X, x, model) for k, (X, x) in enumerate(zip(boards, corners, strict=True)))
    return float(sum((_bounded(r) ** 2).sum() for r in residuals))


def _equations(
    estimate: _Estimate, boards: Sequence[Float64s], corners: Sequence[Float64s], model: str
) -> tuple[float, Float64s, Float64s]:
    """Cost, normal matrix and right-hand side; boards, corners, model: see `fit_lens`."""
    n_intrinsics = len(estimate.intrinsics)
    n_parameters = n_intrinsics + 6 * len(boards)
    normal, rhs, cost = np.zeros((n_parameters, n_parameters)), np.zeros(n_parameters), 0.0
    for k, (X, x) in enumerate(zip(boards, corners, strict=True)):
        state = np.concatenate([estimate.intrinsics, estimate.poses[k]])
        columns = []
        for i in range(len(state)):
            step = np.zeros(len(state))
            step[i] = _DERIVATIVE_STEP * max(1.0, abs(state[i]))
            pixels = [_project(s[:n_intrinsics], s[n_intrinsics:], X, model) for s in (state + step, state - step)]
            columns.append(np.nan_to_num((pixels[0] - pixels[1]).ravel() / (2 * step[i])))
        J, residuals = -np.column_stack(columns), _bounded(_residuals(estimate, k, X, x, model)).ravel()
        indices = np.concatenate([np.arange(n_intrinsics), n_intrinsics + 6 * k + np.arange(6)])
        normal[np.ix_(indices, indices)] += J.T @ J
        rhs[indices] += J.T @ residuals
        cost += float(residuals @ residuals)
    return cost, normal, rhs

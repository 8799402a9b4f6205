"""A lens of any model from the corners of a flat board in several pictures.

OpenCV fits perspective lenses from homographies of the picture; what a fisheye sees of a board is none, and beside the axis by 90
degrees a ray has no place on any plane.  Here boards are placed by homographies to *rays*, and the rest is least squares.

References
----------
Kannala & Brandt, PAMI 2006, section 4 (boards and a generic lens); Zhang, PAMI 2000 (a pose of a homography).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..core.least_squares import levenberg_marquardt
from ..core.lenses import MODELS, lens_rays, reach
from ..types import Float64s, Lens

STARTS: dict[str, tuple[float, ...]] = {
    "fisheye": (0.0, 0.0, 0.0, 0.0),
    "division": (-0.1,),
    "fov": (0.9,),
    "eucm": (0.6, 1.0),
    "double-sphere": (-0.2, 0.6),
}
"""Models that can be fitted, and coefficients to begin with: of a usual wide lens."""

_HALF_FIELDS_DEG = (20.0, 30.0, 40.0, 52.0, 65.0, 80.0, 95.0)
"""Of what is tried, from the middle to the nearer ends of the picture."""
_STEPS = 60
_LOST_PX = 100.0
"""Residual of a corner that the lens does not see."""
_DIFFERENCE = 1e-6


@dataclass(frozen=True)
class _Guess:
    """A lens, and where the boards are."""

    intrinsics: Float64s
    """fx fy cx cy, then the coefficients."""
    turns: Float64s
    """(m, 3) rotation vectors, from board to camera axes."""
    shifts: Float64s
    """(m, 3)."""


def fit_lens(
    boards: Sequence[Float64s], corners: Sequence[Float64s], size: tuple[int, int], model: str
) -> tuple[Float64s, Float64s, list[Float64s]]:
    """K (3, 3), coefficients, and residuals (n, 2) of each picture in pixels.

    Parameters
    ----------
    boards : of each picture, (n, 3) corners on the board (z = 0).
    corners : of each picture, (n, 2) where they are seen, pixels.
    size : (width, height) of the pictures.
    model : a key of `STARTS`.

    Raises
    ------
    ValueError
        No lens of that model shows boards so.
    """
    starts = [start for half in _HALF_FIELDS_DEG if (start := _start(boards, corners, size, model, half))]
    if not starts:
        raise ValueError(f"these pictures do not tell a {model} lens: no field of view fits them")
    first = min(starts, key=lambda guess: _cost(guess, boards, corners, model))
    try:
        _, found = levenberg_marquardt(
            first,
            lambda guess: _equations(guess, boards, corners, model),
            _moved,
            steps=_STEPS,
            damping=1e-3,
            relative_tolerance=1e-10,
        )
    except np.linalg.LinAlgError:
        raise ValueError(f"these pictures do not tell a {model} lens: its numbers depend on each other") from None
    fx, fy, cx, cy, *coefficients = found.intrinsics
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    residuals = [_residuals(found, k, X, x, model) for k, (X, x) in enumerate(zip(boards, corners, strict=True))]
    return K, np.array(coefficients), residuals


def _start(
    boards: Sequence[Float64s], corners: Sequence[Float64s], size: tuple[int, int], model: str, half_deg: float
) -> _Guess | None:
    """The boards as a lens of half a field of view shows them."""
    coefficients = np.array(STARTS[model])
    ahead = np.array([[np.sin(np.deg2rad(half_deg)), 0.0, np.cos(np.deg2rad(half_deg))]])
    with np.errstate(all="ignore"):
        out = MODELS[model].project(np.concatenate([coefficients, np.zeros(14)]), ahead)[0, 0]
    if not (np.isfinite(out) and out > 0):
        return None
    focal = 0.5 * min(size) / out
    middle = 0.5 * (np.array(size) - 1.0)
    K = np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]])
    lens = Lens(K=K, distortion=coefficients, model=model)
    if np.rad2deg(reach(lens)) < half_deg:
        return None
    poses = [_placed(X, lens_rays(lens, x)) for X, x in zip(boards, corners, strict=True)]
    known = [pose for pose in poses if pose is not None]
    if len(known) < len(poses):
        return None
    return _Guess(
        np.array([focal, focal, *middle, *coefficients]), np.array([p[0] for p in known]), np.array([p[1] for p in known])
    )


def _placed(board: Float64s, rays: Float64s) -> tuple[Float64s, Float64s] | None:
    """Rotation vector and shift of a board whose corners lie on rays (n, 3); None where too few are known."""
    known = np.isfinite(rays).all(axis=1)
    if known.sum() < 6:
        return None
    scale = float(np.abs(board).max())
    plane, rays = np.column_stack([board[known, :2] / scale, np.ones(known.sum())]), rays[known]
    x, y, z = (rays[:, k, None] * plane for k in range(3))
    nothing = np.zeros_like(plane)
    rows = np.concatenate([np.hstack([nothing, -z, y]), np.hstack([z, nothing, -x]), np.hstack([-y, x, nothing])])
    H = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    if ((plane @ H.T) * rays).sum() < 0:  # the board lies on the side of the rays
        H = -H
    H = H / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    axes = np.column_stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])])
    u, _, vt = np.linalg.svd(axes)
    return np.asarray(cv2.Rodrigues(u @ vt)[0], dtype=np.float64).ravel(), H[:, 2] * scale


def _moved(guess: _Guess, step: Float64s) -> _Guess:
    count = len(guess.intrinsics)
    poses = step[count:].reshape(-1, 6)
    return replace(
        guess, intrinsics=guess.intrinsics + step[:count], turns=guess.turns + poses[:, :3], shifts=guess.shifts + poses[:, 3:]
    )


def _residuals(guess: _Guess, picture: int, board: Float64s, corners: Float64s, model: str) -> Float64s:
    """(n, 2) seen less reckoned, pixels."""
    return corners - _pixels(guess.intrinsics, np.concatenate([guess.turns[picture], guess.shifts[picture]]), board, model)


def _pixels(intrinsics: Float64s, pose: Float64s, board: Float64s, model: str) -> Float64s:
    R = np.asarray(cv2.Rodrigues(pose[:3])[0], dtype=np.float64)
    rays = board @ R.T + pose[3:]
    with np.errstate(all="ignore"):
        unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        bent = MODELS[model].project(np.concatenate([intrinsics[4:], np.zeros(14)]), unit)
    return np.asarray(bent * intrinsics[:2] + intrinsics[2:4], dtype=np.float64)


def _bounded(residuals: Float64s) -> Float64s:
    return np.clip(np.nan_to_num(residuals, nan=_LOST_PX), -_LOST_PX, _LOST_PX)


def _cost(guess: _Guess, boards: Sequence[Float64s], corners: Sequence[Float64s], model: str) -> float:
    off = (_residuals(guess, k, X, x, model) for k, (X, x) in enumerate(zip(boards, corners, strict=True)))
    return float(sum((_bounded(each) ** 2).sum() for each in off))


def _equations(
    guess: _Guess, boards: Sequence[Float64s], corners: Sequence[Float64s], model: str
) -> tuple[float, Float64s, Float64s]:
    """Cost, normal matrix and right side.

    Parameters
    ----------
    guess : where the boards are, and the lens.
    boards, corners, model : as of `fit_lens`.
    """
    count = len(guess.intrinsics)
    whole = count + 6 * len(boards)
    normal, right, cost = np.zeros((whole, whole)), np.zeros(whole), 0.0
    for k, (X, x) in enumerate(zip(boards, corners, strict=True)):
        state = np.concatenate([guess.intrinsics, guess.turns[k], guess.shifts[k]])
        columns = []
        for i in range(len(state)):
            step = np.zeros(len(state))
            step[i] = _DIFFERENCE * max(1.0, abs(state[i]))
            ends = [_pixels(moved[:count], moved[count:], X, model) for moved in (state + step, state - step)]
            columns.append(np.nan_to_num((ends[0] - ends[1]).ravel() / (2 * step[i])))
        J, off = -np.column_stack(columns), _bounded(_residuals(guess, k, X, x, model)).ravel()
        at = np.concatenate([np.arange(count), count + 6 * k + np.arange(6)])
        normal[np.ix_(at, at)] += J.T @ J
        right[at] += J.T @ off
        cost += float(off @ off)
    return cost, normal, right

"""Points from their observations in any number of posed views."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..types import Bools, Camera, Float64s, Int32s, Int64s
from .tracks import Tracks

POLISH = 4
"""Gauss-Newton steps on the reprojection error after the linear solution."""


def triangulate(cameras: Mapping[int, Camera], tracks: Tracks, use: Bools, scale_px: float) -> Float64s:
    """(count, 3) the point of each track that at least two of the observations in `use` see; nan elsewhere.

    Start: the point nearest to all rays.  Then least squares on the reprojection error with Cauchy weights of `scale_px`.
    """
    rows = np.flatnonzero(use & posed(cameras, tracks))
    track, d, C = tracks.track[rows], rays(cameras, tracks)[rows], _centres(cameras, tracks)[rows]
    M = np.eye(3) - d[:, :, None] * d[:, None, :]
    A = _sum(track, M.reshape(-1, 9), tracks.count).reshape(-1, 3, 3)
    b = _sum(track, np.einsum("nij,nj->ni", M, C), tracks.count)
    seen = np.bincount(track, minlength=tracks.count)
    X = np.full((tracks.count, 3), np.nan)
    enough = np.flatnonzero(seen >= 2)
    enough = enough[np.linalg.eigvalsh(A[enough])[:, 0] > 1e-9]
    X[enough] = np.linalg.solve(A[enough], b[enough, :, None])[:, :, 0]
    for _ in range(POLISH):
        X[enough] = _step(cameras, tracks, rows, X, scale_px)[enough]
    return X


def residuals(cameras: Mapping[int, Camera], tracks: Tracks, X: Float64s) -> Float64s:
    """(n, 2) observed minus projected, pixels; inf where the view has no camera, nan where there is no point, or behind it."""
    found = np.full((len(tracks.track), 2), np.inf)
    for view, camera in cameras.items():
        rows = tracks.view == view
        local = (X[tracks.track[rows]] - camera.C) @ camera.R.T
        with np.errstate(divide="ignore", invalid="ignore"):
            projected = (local @ camera.K.T)[:, :2] / local[:, 2:]
        found[rows] = np.where(local[:, 2:] > 0, tracks.xy[rows] - projected, np.nan)
    return found


def angles(cameras: Mapping[int, Camera], tracks: Tracks, X: Float64s, use: Bools) -> Float64s:
    """(count,) radians: how widely the observations in `use` look at their point (twice the largest angle to their mean ray)."""
    rows = np.flatnonzero(use & posed(cameras, tracks))
    track = tracks.track[rows]
    d = X[track] - _centres(cameras, tracks)[rows]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    mean = _sum(track, np.nan_to_num(d), tracks.count)
    with np.errstate(invalid="ignore"):
        mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    off = np.arccos(np.clip(np.einsum("ni,ni->n", d, mean[track]), -1, 1))
    widest = np.zeros(tracks.count)
    np.maximum.at(widest, track, np.nan_to_num(off))
    return 2 * widest


def posed(cameras: Mapping[int, Camera], tracks: Tracks) -> Bools:
    """(n,) is there a camera for the observation's view?"""
    return np.isin(tracks.view, list(cameras))


def rays(cameras: Mapping[int, Camera], tracks: Tracks) -> Float64s:
    """(n, 3) unit directions in the world of the observations; zeros where the view has no camera."""
    d = np.zeros((len(tracks.track), 3))
    for view, camera in cameras.items():
        rows = tracks.view == view
        x = np.column_stack([tracks.xy[rows], np.ones(int(rows.sum()))])
        d[rows] = x @ np.linalg.inv(camera.K).T @ camera.R
        d[rows] /= np.linalg.norm(d[rows], axis=1, keepdims=True)
    return d


def _centres(cameras: Mapping[int, Camera], tracks: Tracks) -> Float64s:
    C = np.zeros((len(tracks.track), 3))
    for view, camera in cameras.items():
        C[tracks.view == view] = camera.C
    return C


def _step(cameras: Mapping[int, Camera], tracks: Tracks, rows: Int64s, X: Float64s, scale_px: float) -> Float64s:
    """One Gauss-Newton step of all points; a point whose step would be undefined stays."""
    H, g = np.zeros((tracks.count, 9)), np.zeros((tracks.count, 3))
    for view, camera in cameras.items():
        mine = rows[tracks.view[rows] == view]
        track = tracks.track[mine]
        local = (X[track] - camera.C) @ camera.R.T
        KR = camera.K @ camera.R
        with np.errstate(divide="ignore", invalid="ignore"):
            p = local @ camera.K.T
            x = p[:, :2] / p[:, 2:]
            r = tracks.xy[mine] - x
            J = (KR[None, :2, :] - x[:, :, None] * KR[None, 2:, :]) / p[:, 2, None, None]
            weight = 1 / (1 + (r**2).sum(1) / scale_px**2)
        weight = np.where((local[:, 2] > 0) & np.isfinite(weight), weight, 0)
        J, r = np.nan_to_num(J, posinf=0, neginf=0), np.nan_to_num(r, posinf=0, neginf=0)
        H += _sum(track, np.einsum("n,nki,nkj->nij", weight, J, J).reshape(-1, 9), tracks.count)
        g += _sum(track, np.einsum("n,nki,nk->ni", weight, J, r), tracks.count)
    normal = H.reshape(-1, 3, 3)
    trace = np.trace(normal, axis1=1, axis2=2)
    solid = trace > 0
    normal[solid] += 1e-9 * trace[solid, None, None] * np.eye(3)
    moved = X.copy()
    moved[solid] += np.linalg.solve(normal[solid], g[solid, :, None])[:, :, 0]
    return np.where(np.isfinite(moved), moved, X)


def _sum(index: Int32s, values: Float64s, count: int) -> Float64s:
    """Rows of `values` added up by `index`, always in the same order."""
    if len(values) == 0:
        return np.zeros((count, values.shape[1]))
    return np.column_stack([np.bincount(index, weights=column, minlength=count) for column in values.T])

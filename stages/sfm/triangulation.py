"""Points from their observations in any number of posed views."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..core.cameras import ray_angles
from ..core.jit import helper, kernel
from ..types import Bools, Camera, Float64s, Int32s, Int64s
from .tracks import Tracks

POLISHING_STEPS = 4
"""Largest number of Gauss-Newton steps on the reprojection error after the linear solution."""
LEAST_STEP = 1e-6
"""Gain of a Gauss-Newton step, in squared pixels, below which no other follows."""
RAYLEIGH = 1.1774
"""Ratio of the median length of a 2-D normal error to the standard deviation of one coordinate."""
PARALLEL = 1e-9
"""Rays that meet at less than about the square root of this (radians) yield no point."""


def triangulate(cameras: Mapping[int, Camera], tracks: Tracks, use: Bools, scale_px: float) -> Float64s:
    """(count, 3) point of each track that at least two of the observations in `use` see; nan elsewhere.

    The point nearest to all rays, refined by least squares on the reprojection error with Cauchy weights.

    Parameters
    ----------
    cameras : by view number; views without one are ignored.
    tracks, use : the observations, and (n,) bool, which of them to use.
    scale_px : residual at which the weight of an observation is halved.
    """
    KR, C = _stacked(cameras, tracks)
    first = np.searchsorted(tracks.track, np.arange(tracks.count + 1))
    pixels_to_rays = np.zeros_like(KR)
    for view, camera in cameras.items():
        pixels_to_rays[view] = camera.R.T @ np.linalg.inv(camera.K)
    # d: (n, 3) unit direction of each observation's ray in the world
    matrices = pixels_to_rays[tracks.view]
    d = np.einsum("nij,nj->ni", matrices[:, :, :2], tracks.xy) + matrices[:, :, 2]
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-300)
    return _points(first, tracks.view, tracks.xy, use & posed(cameras, tracks), d, KR, C, scale_px)


def residuals(cameras: Mapping[int, Camera], tracks: Tracks, X: Float64s) -> Float64s:
    """(n, 2) observed minus projected, pixels; inf if the view has no camera, nan if the point is missing or behind it."""
    KR, C = _stacked(cameras, tracks)
    p = np.einsum("nij,nj->ni", KR[tracks.view], X[tracks.track] - C[tracks.view])
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = np.where(p[:, 2:] > 0, tracks.xy - p[:, :2] / p[:, 2:], np.nan)
    difference[~posed(cameras, tracks)] = np.inf
    return np.asarray(difference, dtype=np.float64)


def angles(cameras: Mapping[int, Camera], tracks: Tracks, X: Float64s, use: Bools) -> Float64s:
    """(count,) angle in radians at which the observations in `use` see their point (twice the largest angle to their mean ray).

    Parameters
    ----------
    cameras : by view number.
    tracks, X : n observations, and (count, 3) their points.
    use : (n,) bool, which observations count.
    """
    rows = np.flatnonzero(use & posed(cameras, tracks))
    track = tracks.track[rows]
    d = X[track] - _stacked(cameras, tracks)[1][tracks.view[rows]]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    # (count, 3) sum of the unit rays of each track: the direction of its mean ray
    total: Float64s = np.column_stack([np.bincount(track, np.nan_to_num(d[:, i]), tracks.count) for i in range(3)])
    widest = np.zeros(tracks.count)
    np.maximum.at(widest, track, np.nan_to_num(ray_angles(d, total[track])))
    return 2 * widest


def posed(cameras: Mapping[int, Camera], tracks: Tracks) -> Bools:
    """(n,) whether the observation's view has a camera."""
    return np.isin(tracks.view, list(cameras))


def _stacked(cameras: Mapping[int, Camera], tracks: Tracks) -> tuple[Float64s, Float64s]:
    """K R (views, 3, 3) and C (views, 3) by view number, zeros if there is no camera."""
    count = 1 + max(int(tracks.view.max(initial=-1)), max(cameras, default=-1))
    KR = np.zeros((count, 3, 3))
    C = np.zeros((count, 3))
    for view, camera in cameras.items():
        KR[view] = camera.K @ camera.R
        C[view] = camera.C
    return KR, C


@kernel
def _points(
    first: Int64s, view: Int32s, xy: Float64s, use: Bools, d: Float64s, KR: Float64s, C: Float64s, scale_px: float
) -> Float64s:
    """The points of `triangulate`, one after the other; the observations of track t are first[t] to first[t + 1]."""
    X = np.full((len(first) - 1, 3), np.nan)
    H = np.zeros((3, 3))
    g = np.zeros(3)
    J = np.zeros((2, 3))
    step = np.zeros(3)
    for t in range(len(first) - 1):
        # the point nearest to all rays solves sum (I - d d^T) X = sum (I - d d^T) C
        H[:] = 0
        g[:] = 0
        count = 0
        for k in range(first[t], first[t + 1]):
            if not use[k]:
                continue
            count += 1
            c = C[view[k]]
            along = d[k, 0] * c[0] + d[k, 1] * c[1] + d[k, 2] * c[2]
            for i in range(3):
                g[i] += c[i] - d[k, i] * along
                H[i, i] += 1
                for j in range(3):
                    H[i, j] -= d[k, i] * d[k, j]
        # two of the three eigenvalues are about the number of rays, so the determinant measures the smallest one
        if count < 2 or _solve(H, g, step) < PARALLEL * count**2:
            continue
        X[t] = step
        # Gauss-Newton steps on the weighted reprojection error, with a trace of damping
        for _ in range(POLISHING_STEPS):
            H[:] = 0
            g[:] = 0
            for k in range(first[t], first[t + 1]):
                if use[k]:
                    _add(KR[view[k]], C[view[k]], xy[k], X[t], scale_px, J, H, g)
            trace = H[0, 0] + H[1, 1] + H[2, 2]
            for i in range(3):
                H[i, i] += 1e-9 * trace
            gain = 0.0
            if _solve(H, g, step) > 0 and np.isfinite(step.sum()):
                X[t] += step
                gain = g[0] * step[0] + g[1] * step[1] + g[2] * step[2]
            if gain < LEAST_STEP:
                break
    return X


@kernel
def _add(KR: Float64s, C: Float64s, x: Float64s, X: Float64s, scale_px: float, J: Float64s, H: Float64s, g: Float64s) -> None:
    """Add one observation to the normal equations of its point, unless the point is behind the camera."""
    px = 0.0
    py = 0.0
    pz = 0.0
    for i in range(3):
        px += KR[0, i] * (X[i] - C[i])
        py += KR[1, i] * (X[i] - C[i])
        pz += KR[2, i] * (X[i] - C[i])
    if not pz > 0:
        return
    u = px / pz
    v = py / pz
    ru = x[0] - u
    rv = x[1] - v
    weight = 1 / (1 + (ru * ru + rv * rv) / scale_px**2)  # Cauchy
    for i in range(3):
        J[0, i] = (KR[0, i] - u * KR[2, i]) / pz
        J[1, i] = (KR[1, i] - v * KR[2, i]) / pz
    for i in range(3):
        g[i] += weight * (J[0, i] * ru + J[1, i] * rv)
        for j in range(3):
            H[i, j] += weight * (J[0, i] * J[0, j] + J[1, i] * J[1, j])


@helper
def _solve(H: Float64s, g: Float64s, x: Float64s) -> float:
    """x = H^-1 g for a symmetric H, by its cofactors; returns the determinant."""
    a = H[1, 1] * H[2, 2] - H[1, 2] * H[1, 2]
    b = H[0, 2] * H[1, 2] - H[0, 1] * H[2, 2]
    c = H[0, 1] * H[1, 2] - H[0, 2] * H[1, 1]
    e = H[0, 0] * H[2, 2] - H[0, 2] * H[0, 2]
    f = H[0, 1] * H[0, 2] - H[0, 0] * H[1, 2]
    i = H[0, 0] * H[1, 1] - H[0, 1] * H[0, 1]
    determinant = H[0, 0] * a + H[0, 1] * b + H[0, 2] * c
    x[0] = (a * g[0] + b * g[1] + c * g[2]) / determinant
    x[1] = (b * g[0] + e * g[1] + f * g[2]) / determinant
    x[2] = (c * g[0] + f * g[1] + i * g[2]) / determinant
    return float(determinant)

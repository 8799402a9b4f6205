"""Keypoints moved to where they show the same place as in one view of their track: least squares matching.

A detector finds a corner again to a tenth or two of a pixel, worse where the view changes.  Comparing the pixels themselves, with
an affine warp and a gain of exposure between the two views, is several times sharper (Gruen 1985).  The view that all others of a
track are compared with keeps its keypoint: which place of the scene that is does not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from ..kernels import kernel
from ..matching.affine_field import fit_affine_field
from ..types import Bools, Float32s, Float64s, Frame, Int64s
from .mapping import Model
from .triangulation import rays

RADIUS, SIGMA = 6, 3.5
"""Half side of the compared windows, and the standard deviation of their weights, pixels of the reference view."""
SMOOTHING = 0.7
"""Standard deviation, pixels: a little blur makes cubic interpolation exact enough."""
MOST_STEPS = 20
MOST_MOVED = 1.5
"""An observation that moves farther than this (pixels) has found something else..."""
LEAST_CORRELATION = 0.9
"""...and so has one whose windows correlate less than this."""


def sharpened(model: Model, greys: Mapping[int, Float32s]) -> Model:
    """The model with sharper observations; one whose pixels do not agree with its track's reference stays as it is.

    greys: the frames of all its views as `smooth_grey` has them, by number.
    """
    tracks = model.tracks
    reference = _references(model)
    xy = tracks.xy.copy()
    for base in model.cameras:
        for view in model.cameras:
            rows = np.flatnonzero(model.use & (tracks.view == view) & (tracks.view[reference[tracks.track]] == base))
            if base == view or len(rows) == 0:
                continue
            at = tracks.xy[reference[tracks.track[rows]]]
            moved, correlation = _match(greys[base], greys[view], at, tracks.xy[rows], _warps(model, base, view, at))
            good = (correlation >= LEAST_CORRELATION) & (np.linalg.norm(moved - tracks.xy[rows], axis=1) <= MOST_MOVED)
            xy[rows[good]] = moved[good]
    return replace(model, tracks=replace(tracks, xy=xy))


def smooth_grey(frame: Frame) -> Float32s:
    """(h, w) what windows are compared in."""
    grey = cv2.cvtColor(np.ascontiguousarray(frame.image), cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), SMOOTHING), dtype=np.float32)


def _references(model: Model) -> Int64s:
    """(count,) the observation of each track whose ray is nearest to their mean: the least change of view for all."""
    tracks = model.tracks
    d = rays(model.cameras, tracks)
    mean = np.column_stack([np.bincount(tracks.track[model.use], column[model.use], tracks.count) for column in d.T])
    nearness = np.where(model.use, np.einsum("ni,ni->n", d, mean[tracks.track]), -np.inf)
    order = np.lexsort((-nearness, tracks.track))
    return np.asarray(order[np.searchsorted(tracks.track[order], np.arange(tracks.count))], dtype=np.int64)


def _warps(model: Model, base: int, view: int, at: Float64s) -> Float64s:
    """(n, 2, 2) how steps from the pixels `at` in one view go over to the other, as the tracks around them have it."""
    tracks = model.tracks
    rows, others = (np.flatnonzero(model.use & (tracks.view == v)) for v in (base, view))
    _, a, b = np.intersect1d(tracks.track[rows], tracks.track[others], return_indices=True)
    unturned = np.repeat(np.eye(2)[None], len(a), axis=0)
    if len(a) < 2:
        return np.repeat(np.eye(2)[None], len(at), axis=0)
    return fit_affine_field(tracks.xy[rows[a]], tracks.xy[others[b]], unturned, np.ones(len(a)), at).affine


def _match(base: Float32s, other: Float32s, at: Float64s, start: Float64s, warps: Float64s) -> tuple[Float64s, Float64s]:
    """Where in `other` (n, 2) is what `base` shows around `at`, and how well the windows then correlate (0: not found)."""
    moved, correlation = start.copy(), np.zeros(len(start))
    inside: Bools = np.all((at >= RADIUS + 2) & (at < np.array(base.shape[::-1]) - RADIUS - 3), axis=1)
    _least_squares(base, other, at, warps, inside, moved, correlation)
    return moved, correlation


@kernel
def _least_squares(
    base: Float32s, other: Float32s, at: Float64s, warps: Float64s, inside: Bools, moved: Float64s, correlation: Float64s
) -> None:
    """Gauss-Newton over warp (4), place (2), gain and offset; `moved` is where to start, and the result."""
    h, w = other.shape
    side = 2 * RADIUS + 1
    template, weight = np.empty((side, side)), np.empty((side, side))
    for j in range(side):
        for i in range(side):
            weight[j, i] = np.exp(-0.5 * ((i - RADIUS) ** 2 + (j - RADIUS) ** 2) / SIGMA**2)
    here, J, H, g = np.empty(3), np.empty(8), np.empty((8, 8)), np.empty(8)
    for k in range(len(at)):
        if not inside[k]:
            continue
        for j in range(side):
            for i in range(side):
                _cubic(base, at[k, 0] + i - RADIUS, at[k, 1] + j - RADIUS, here)
                template[j, i] = here[0]
        a, b, c, d = warps[k, 0, 0], warps[k, 0, 1], warps[k, 1, 0], warps[k, 1, 1]
        x0, y0 = moved[k, 0], moved[k, 1]
        gain, offset, good = 1.0, 0.0, True
        for step in range(MOST_STEPS + 1):
            H[:], g[:] = 0.0, 0.0
            sw, st, sv, stt, svv, stv = 1e-12, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(side):
                for i in range(side):
                    u, v = i - RADIUS, j - RADIUS
                    x, y = a * u + b * v + x0, c * u + d * v + y0
                    if not (x >= 2 and y >= 2 and x < w - 3 and y < h - 3):
                        good = False
                        break
                    _cubic(other, x, y, here)
                    t, m = template[j, i], weight[j, i]
                    sw, st, sv = sw + m, st + m * t, sv + m * here[0]
                    stt, svv, stv = stt + m * t * t, svv + m * here[0] * here[0], stv + m * t * here[0]
                    dx, dy = gain * here[1], gain * here[2]
                    J[0], J[1], J[2], J[3] = dx * u, dx * v, dy * u, dy * v
                    J[4], J[5], J[6], J[7] = dx, dy, here[0], 1.0
                    left = t - gain * here[0] - offset
                    for p in range(8):
                        g[p] += m * J[p] * left
                        for q in range(p + 1):
                            H[p, q] += m * J[p] * J[q]
                if not good:
                    break
            if not good:
                break
            tt, vv, tv = stt / sw - (st / sw) ** 2, svv / sw - (sv / sw) ** 2, stv / sw - st * sv / sw**2
            correlation[k] = tv / np.sqrt(max(tt * vv, 1e-12))
            if step == 0:  # exposure first: the steps after it are small
                gain = tv / max(vv, 1e-9)
                offset = st / sw - gain * sv / sw
                if gain <= 0.05:
                    good = False
                    break
                continue
            slack = 1e-3 * (H[4, 4] + H[5, 5])  # holds what the pixels leave open of the warp
            for p in range(8):
                H[p, p] += 1e-6 * H[p, p] + (slack if p < 4 else 0.0)
            if not _solve(H, g):
                good = False
                break
            a, b, c, d = a + g[0], b + g[1], c + g[2], d + g[3]
            x0, y0, gain, offset = x0 + g[4], y0 + g[5], gain + g[6], offset + g[7]
            if g[4] ** 2 + g[5] ** 2 < 1e-5:
                break
        if good:
            moved[k, 0], moved[k, 1] = x0, y0
        else:
            correlation[k] = 0.0


@kernel
def _cubic(image: Float32s, x: float, y: float, out: Float64s) -> None:
    """Value and slopes along x and y by Catmull-Rom splines; (x, y) at least one pixel inside."""
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    s, t = x - x0, y - y0
    out[:] = 0.0
    for j in range(4):
        wy, dy = _spline(j, t)
        row, slope = 0.0, 0.0
        for i in range(4):
            wx, dx = _spline(i, s)
            value = image[y0 + j - 1, x0 + i - 1]
            row += wx * value
            slope += dx * value
        out[0] += wy * row
        out[1] += wy * slope
        out[2] += dy * row


@kernel
def _spline(k: int, t: float) -> tuple[float, float]:
    """Weight of the k-th of four neighbours at t in 0..1, and its derivative."""
    if k == 0:
        return 0.5 * t * (-1 + t * (2 - t)), 0.5 * (-1 + t * (4 - 3 * t))
    if k == 1:
        return 0.5 * (2 + t * t * (-5 + 3 * t)), 0.5 * t * (-10 + 9 * t)
    if k == 2:
        return 0.5 * t * (1 + t * (4 - 3 * t)), 0.5 * (1 + t * (8 - 9 * t))
    return 0.5 * t * t * (-1 + t), 0.5 * t * (-2 + 3 * t)


@kernel
def _solve(H: Float64s, g: Float64s) -> bool:
    """Solve H x = g in place by Cholesky's method; only the lower half of H is read.  False where H is not definite."""
    n = len(g)
    for p in range(n):
        for q in range(p + 1):
            total = H[p, q]
            for r in range(q):
                total -= H[p, r] * H[q, r]
            if p > q:
                H[p, q] = total / H[q, q]
            elif total > 0:
                H[p, p] = np.sqrt(total)
            else:
                return False
    for p in range(n):
        for r in range(p):
            g[p] -= H[p, r] * g[r]
        g[p] /= H[p, p]
    for p in range(n - 1, -1, -1):
        for r in range(p + 1, n):
            g[p] -= H[r, p] * g[r]
        g[p] /= H[p, p]
    return True

"""Principal points of lenses that nobody stated, solved with the lens that their cameras share and with everything else.

Cameras by one maker share a lens, but each sensor sits elsewhere behind it, by half a per cent of the width or so.  What a wrong
principal point does to a picture is nearly a turn of the camera, and the rest goes into the focal length: so all are solved at
once, each principal point held to the middle by a standard deviation (maximum a posteriori; Triggs et al. 2000, section 4).
Reduced to the cameras by Schur's complement (ibid., section 6), with Cauchy's weights.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..core.bending import bent_px
from ..core.rotations import rotation_matrix
from ..types import Camera, Float64s, Int64s
from .incremental import FOCALS_FROM, Model

BENT_SHARE = 0.02
"""A lens tells its centre if it moves the corners by more than this share of the width."""
MIN_SEEN = 200
"""Observations that each of the views needs."""
SIGMA = 0.005
"""Standard deviation of a principal point, of the width."""
LOSS = 2.385
"""Scale of the Cauchy loss in standard deviations of the noise: 95 % efficient (Holland & Welsch 1977).
A quarter of what poses are solved with: what is a little wrong bends a lens more than it moves a camera."""
STEPS = 25
ENOUGH, START, FARTHEST = 1e-6, 1e-4, 1e3
"""Steps end when one lowers the cost by no more than this share; damping at first, and at most."""
_POSE, _CENTRE, _LENS = 6, 2, 3
"""Numbers of each."""
_AT_ONCE = 256
"""Points: bounds memory."""
_DIFFERENCE = 1e-6


def with_centres(model: Model) -> Model:
    """The model with the principal points of views that bend strongly; the same where these are too few to tell."""
    bent = list(_bent(model))
    if len(bent) < FOCALS_FROM or len(bent) < len(model.cameras) or model.held:
        return model
    return _solved(model)


def _bent(model: Model) -> Iterator[int]:
    """The views that tell their principal point."""
    seen = np.bincount(model.tracks.view[model.use], minlength=max(model.cameras, default=0) + 1)
    for view, camera in model.cameras.items():
        if view in model.lenses and bent_px(camera) > BENT_SHARE * camera.width and seen[view] >= MIN_SEEN:
            yield view


@dataclass(frozen=True)
class _State:
    """What is solved."""

    cameras: dict[int, Camera]
    X: Float64s


@dataclass(frozen=True)
class _Seen:
    """Observations, by the place of their camera among all, of its lens among all, and of their point."""

    xy: Float64s
    camera: Int64s
    lens: Int64s
    point: Int64s
    names: tuple[int, ...]
    lenses: tuple[int, ...]
    """Of each camera."""


def _project(state: tuple[Float64s, ...], X: Float64s) -> Float64s:
    """(n, 2) pixels of points by rows of turns (n, 3, 3), centres (n, 3), principal points (n, 2) and lenses (n, 3)."""
    R, C, centre, lens = state
    Y = np.einsum("nij,nj->ni", R, X - C)
    x = Y[:, :2] / Y[:, 2:]
    r2 = (x * x).sum(axis=1)
    return np.asarray(centre + (lens[:, 0] * (1 + r2 * (lens[:, 1] + r2 * lens[:, 2])))[:, None] * x)


def _rows(state: _State, seen: _Seen) -> tuple[Float64s, ...]:
    """What `_project` takes, of each observation."""
    cameras = [state.cameras[name] for name in seen.names]
    k = seen.camera
    lens = np.array([[c.K[0, 0], *c.radial] for c in cameras])
    return (
        np.array([c.R for c in cameras])[k],
        np.array([c.C for c in cameras])[k],
        np.array([c.K[:2, 2] for c in cameras])[k],
        lens[k],
    )


def _jacobians(state: _State, seen: _Seen) -> tuple[Float64s, Float64s, Float64s]:
    """Residuals (n, 2), and their slopes by camera and lens (n, 2, 11), and by the point (n, 2, 3)."""
    R, C, centre, lens = _rows(state, seen)
    X = state.X[seen.point]
    there = _project((R, C, centre, lens), X)
    columns = []
    for axis in range(3):
        turn = rotation_matrix(np.eye(3)[axis] * _DIFFERENCE)
        columns.append(
            (_project((turn @ R, C, centre, lens), X) - _project((turn.T @ R, C, centre, lens), X)) / (2 * _DIFFERENCE)
        )
    size = _DIFFERENCE * np.linalg.norm(X - C, axis=1).mean()
    shifts = []
    for axis in range(3):
        step = np.eye(3)[axis] * size
        shifts.append((_project((R, C, centre, lens), X + step) - _project((R, C, centre, lens), X - step)) / (2 * size))
    columns += [-shift for shift in shifts]
    columns += [np.tile([1.0, 0.0], (len(X), 1)), np.tile([0.0, 1.0], (len(X), 1))]
    for k, scale in enumerate((1e-4 * lens[:, 0].mean(), 1e-5, 1e-5)):
        step = np.eye(3)[k] * scale
        columns.append((_project((R, C, centre, lens + step), X) - _project((R, C, centre, lens - step), X)) / (2 * scale))
    return there - seen.xy, np.stack(columns, axis=2), np.stack(shifts, axis=2)


def _solved(model: Model) -> Model:
    """The model that meets the observations and the expected principal points best."""
    names = tuple(model.cameras)
    lenses = sorted({model.lenses[name] for name in names})
    rows = np.flatnonzero(model.use)
    points, point = np.unique(model.tracks.track[rows], return_inverse=True)
    place = np.zeros(max(names) + 1, np.int64)
    place[list(names)] = np.arange(len(names))
    camera = place[model.tracks.view[rows]]
    of = np.array([lenses.index(model.lenses[name]) for name in names])
    seen = _Seen(model.tracks.xy[rows], camera, of[camera], point, names, tuple(of.tolist()))
    errors = model.error_px()[rows]
    noise = float(np.median(errors)) / 1.1774
    state, damping = _State(dict(model.cameras), model.X[points]), START
    cost = _cost(state, seen, noise)
    for _ in range(STEPS):
        stepped = _step(state, seen, noise, damping)
        after = _cost(stepped, seen, noise)
        if after < cost:
            settled = after > (1 - ENOUGH) * cost
            state, cost, damping = stepped, after, damping / 5
            if settled:
                break
        else:
            damping *= 10
            if damping > FARTHEST:
                break
    X = model.X.copy()
    X[points] = state.X
    return replace(model, cameras=state.cameras, X=X)


def _cost(state: _State, seen: _Seen, noise: float) -> float:
    off = (_project(_rows(state, seen), state.X[seen.point]) - seen.xy) / noise
    return float((LOSS**2 * np.log1p((off**2).sum(axis=1) / LOSS**2)).sum() + (_beside(state, seen) ** 2).sum())


def _beside(state: _State, seen: _Seen) -> Float64s:
    """(cameras, 2) principal points from the middle, in standard deviations."""
    cameras = [state.cameras[name] for name in seen.names]
    return np.array([(c.K[:2, 2] - 0.5 * np.array([c.width - 1.0, c.height - 1.0])) / (SIGMA * c.width) for c in cameras])


def _step(state: _State, seen: _Seen, noise: float, damping: float) -> _State:
    """One step of Levenberg and Marquardt, the points eliminated."""
    off, J, P = _jacobians(state, seen)
    weight = np.sqrt(1 / (1 + ((off / noise) ** 2).sum(axis=1) / LOSS**2)) / noise
    off, J, P = off * weight[:, None], J * weight[:, None, None], P * weight[:, None, None]
    own, count = _POSE + _CENTRE, len(seen.names)
    size = own * count + _LENS * (max(seen.lenses) + 1)
    at = np.concatenate(
        [own * seen.camera[:, None] + np.arange(own), own * count + _LENS * seen.lens[:, None] + np.arange(_LENS)], axis=1
    )
    H, g = np.zeros((size, size)), np.zeros(size)
    np.add.at(H, (at[:, :, None], at[:, None, :]), np.einsum("nki,nkj->nij", J, J))
    np.add.at(g, at, np.einsum("nki,nk->ni", J, off))
    beside, widths = _beside(state, seen), [SIGMA * state.cameras[name].width for name in seen.names]
    for k in range(count):
        for axis in range(2):
            i = own * k + _POSE + axis
            H[i, i] += 1 / widths[k] ** 2
            g[i] += beside[k, axis] / widths[k]
    V, h = np.zeros((len(state.X), 3, 3)), np.zeros((len(state.X), 3))
    np.add.at(V, seen.point, np.einsum("nki,nkj->nij", P, P))
    np.add.at(h, seen.point, np.einsum("nki,nk->ni", P, off))
    V[:, range(3), range(3)] *= 1 + damping
    V += 1e-12 * np.trace(V, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    inverse = np.linalg.inv(V)
    between = np.einsum("nki,nkj->nij", J, P)  # of each observation's camera and point
    H[range(size), range(size)] *= 1 + damping
    for first in range(0, len(state.X), _AT_ONCE):
        part, W = _coupled(between, at, seen, first, size)
        WV = W @ inverse[part]
        H -= np.einsum("pij,pkj->ik", WV, W, optimize=True)
        g -= np.einsum("pij,pj->i", WV, h[part])
    d = np.asarray(-np.linalg.solve(H, g), dtype=np.float64)
    np.add.at(h, seen.point, np.einsum("nij,ni->nj", between, d[at]))
    dX = -np.einsum("pij,pj->pi", inverse, h)
    return _moved(state, seen, d, dX)


def _coupled(between: Float64s, at: Int64s, seen: _Seen, first: int, size: int) -> tuple[slice, Float64s]:
    """Some of the points, and how the cameras' numbers depend on theirs: (points, size, 3)."""
    last = min(first + _AT_ONCE, int(seen.point[-1]) + 1)
    rows = slice(*np.searchsorted(seen.point, [first, last]).tolist())
    W = np.zeros((last - first, size, 3))
    np.add.at(W, (seen.point[rows, None] - first, at[rows]), between[rows])
    return slice(first, last), W


def _moved(state: _State, seen: _Seen, d: Float64s, dX: Float64s) -> _State:
    """After a step of the cameras, one after the other, and their lenses; and of the points."""
    own, count = _POSE + _CENTRE, len(seen.names)
    cameras = {}
    for k, (name, lens) in enumerate(zip(seen.names, seen.lenses, strict=True)):
        c, mine, bend = state.cameras[name], d[own * k : own * (k + 1)], d[own * count + _LENS * lens :][:_LENS]
        K = c.K.copy()
        K[0, 0] = K[1, 1] = K[0, 0] + bend[0]
        K[:2, 2] += mine[6:]
        radial = (c.radial[0] + float(bend[1]), c.radial[1] + float(bend[2]))
        cameras[name] = replace(c, K=K, R=rotation_matrix(mine[:3]) @ c.R, C=c.C + mine[3:6], radial=radial)
    return _State(cameras, state.X + dX)

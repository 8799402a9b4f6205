"""How well the images of a site tell the lenses that were solved with its poses.

From the normal equations of the adjustment, reduced to cameras and lenses (Triggs et al. 2000, section 6), with Cauchy's weights.
A principal point is not solved, but is not known either: each enters with a standard deviation, and so widens what it trades
against.  What a turn of the camera would undo is not counted.

What is wrong in matches is wrong in many at once: what wet ground mirrors, a texture that repeats.  So besides what independent
noise leaves open it is asked how far the parts of the scene pull the lenses apart (the covariance of clustered observations:
Liang & Zeger, Longitudinal Data Analysis Using Generalized Linear Models, Biometrika 1986).  The larger of both counts.
"""

from __future__ import annotations

import numpy as np

from ..core.residual_distortion import without_distortion
from ..types import Camera, Float64s, Int64s, LensSigma
from .incremental import Model

MOST_SIGMA_PX = 1.0
"""A lens whose border is not known to a pixel is not known: as of rows of stated poses, dense matching does not look farther."""
MOST_VIEWS = 64
"""So many views tell their lenses, and the equations of more are not worth their time."""
CENTRE_SIGMA = 0.005
"""Standard deviation of a principal point from the middle of the picture, of its width."""
LOSS = 2.385
"""Scale of the Cauchy loss in standard deviations of the noise: 95 % efficient (Holland & Welsch 1977)."""
RAYLEIGH = 1.1774
"""Median distance over the standard deviation of one coordinate."""
_POSE, _CENTRE, _LENS = 6, 2, 3
_OWN = _POSE + _CENTRE
_LOOSE = 1e-10
"""A share that holds the world where it is, whose place, turn and scale nothing tells."""
_AT_ONCE = 256
"""Points: bounds memory."""
_HALVINGS = 3
"""Of the scene, into parts with as many points: eight.  Fewer say little of a variance, and smaller ones are wrong together."""
_AT_LEAST = 1 / (1 + 2 / np.sqrt(2 * (2**_HALVINGS - 1)))
"""Of a standard deviation from so many parts, which has one of its own (27 % of it): what it is if it came out two too large."""
_LONG_SIDE = 768
"""Of larger frames, whose pixels show less, as many more pixels may be open by what is wrong in matches; as of rows."""


def lens_sigmas(model: Model, centre_sigma: float = CENTRE_SIGMA) -> dict[int, LensSigma]:
    """Of each view whose lens was solved, how well the observations of an adjusted model tell it.

    Parameters
    ----------
    model : adjusted: its residuals are the noise.
    centre_sigma : of principal points, of the width.
    """
    if not any(view in model.lenses for view in model.cameras) or not model.use.any() or len(model.cameras) > MOST_VIEWS:
        return {}
    by_noise, by_parts, place = _covariances(model, centre_sigma)
    found = {}
    for view in [view for view in place if view in model.lenses]:
        where, camera = np.ix_(place[view], place[view]), model.cameras[view]
        share = _AT_LEAST * min(1.0, _LONG_SIDE / max(camera.width, camera.height))
        both = _lens_sigma(camera, by_noise[where]), _lens_sigma(camera, by_parts[where] * share**2)
        found[view] = max(both, key=lambda sigma: sigma.border_px)
    return found


def _lens_sigma(camera: Camera, covariance: Float64s) -> LensSigma:
    """From the covariance (5, 5) of cx, cy, f, k1, k2."""
    border, everywhere = _pixels(camera, 0.02, True), _pixels(camera, 0.02, False)
    (turn, of), (turn_b, of_b) = _slopes_at(camera, everywhere), _slopes_at(camera, border)
    undone = of_b - turn_b @ np.linalg.lstsq(turn, of, rcond=None)[0]
    variance = np.einsum("ni,ij,nj->", undone, covariance, undone) / len(border)
    return LensSigma(float(np.sqrt(covariance[2, 2])) / float(camera.K[0, 0]), float(np.sqrt(max(variance, 0.0))))


def _pixels(camera: Camera, margin: float, border: bool) -> Float64s:
    """(n, 2) pixels of a grid over the frame, or of its rim."""
    x = np.linspace(margin, 1 - margin, 17) * (camera.width - 1)
    y = np.linspace(margin, 1 - margin, 11) * (camera.height - 1)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    if not border:
        return np.asarray(grid.reshape(-1, 2), dtype=np.float64)
    return np.concatenate([grid[0], grid[-1], grid[1:-1, 0], grid[1:-1, -1]])


def _slopes_at(camera: Camera, x: Float64s) -> tuple[Float64s, Float64s]:
    """How pixels (n, 2) move with a turn of the camera (2n, 3), and with cx, cy, f, k1, k2 (2n, 5)."""
    straight = without_distortion(camera, x)
    Y = np.column_stack([(straight - camera.K[:2, 2]) / camera.K[0, 0], np.ones(len(x))])
    lens = np.tile([camera.K[0, 0], *camera.radial], (len(x), 1))
    D, L = _slopes(Y, lens)
    turn = np.stack([(D @ np.cross(np.eye(3)[axis], Y)[:, :, None])[:, :, 0] for axis in range(3)], axis=2)
    centre = np.tile(np.eye(2), (len(x), 1, 1))
    return turn.reshape(-1, 3), np.concatenate([centre, L], axis=2).reshape(-1, 5)


def _slopes(Y: Float64s, lens: Float64s) -> tuple[Float64s, Float64s]:
    """How pixels move with points (n, 3) in camera axes, (n, 2, 3), and with their lenses f, k1, k2, (n, 2, 3)."""
    f, k1, k2 = lens.T
    x = Y[:, :2] / Y[:, 2:]
    r2 = (x * x).sum(axis=1)
    factor, rise = 1 + r2 * (k1 + r2 * k2), k1 + 2 * r2 * k2
    by_x = f[:, None, None] * (factor[:, None, None] * np.eye(2) + 2 * rise[:, None, None] * x[:, :, None] * x[:, None, :])
    to_x = np.concatenate([np.tile(np.eye(2), (len(Y), 1, 1)), -x[:, :, None]], axis=2) / Y[:, 2][:, None, None]
    by_lens = np.stack([factor[:, None] * x, (f * r2)[:, None] * x, (f * r2 * r2)[:, None] * x], axis=2)
    return by_x @ to_x, by_lens


def _covariances(model: Model, centre_sigma: float) -> tuple[Float64s, Float64s, dict[int, list[int]]]:
    """Covariances of all cameras and lenses, by the noise and by the parts of the scene, and where in them cx, cy, f, k1, k2 of
    each view are."""
    rows = np.flatnonzero(model.use)
    names = np.unique(model.tracks.view[rows]).tolist()
    owners = [model.lenses.get(name, -1 - name) for name in names]
    lenses = {lens: k for k, lens in enumerate(dict.fromkeys(owners))}
    start, size = _OWN * len(names), _OWN * len(names) + _LENS * len(lenses)
    own = _OWN * np.arange(len(names))[:, None] + np.arange(_OWN)
    at = np.column_stack([own, start + _LENS * np.array([lenses[owner] for owner in owners])[:, None] + np.arange(_LENS)])
    of = np.searchsorted(names, model.tracks.view[rows])
    points, point = np.unique(model.tracks.track[rows], return_inverse=True)
    noise = max(float(np.median(model.error_px()[rows])) / RAYLEIGH, 1e-6)
    J, P, r = _linearised(model, names, rows, of)
    off = model.error_px()[rows] / noise
    weight = np.sqrt(1 / (1 + off**2 / LOSS**2)) / noise
    J, P, r = J * weight[:, None, None], P * weight[:, None, None], r * weight[:, None]
    inverse = _inverses(P, point, len(points))
    H = _reduced(J, P, inverse, at[of], point, size)
    H[range(size), range(size)] *= 1 + _LOOSE
    known = _known(model, names, at, size, centre_sigma)
    free = np.flatnonzero(np.isfinite(known))
    H[free, free] += known[free]
    scale = 1 / np.sqrt(np.maximum(np.diag(H)[free], 1e-300))
    by_noise = np.zeros((size, size))
    by_noise[np.ix_(free, free)] = np.linalg.inv(H[np.ix_(free, free)] * scale[:, None] * scale) * scale[:, None] * scale
    pulls = _pulls(J, P, r, inverse, at[of], point, _parts(model.X[points]), size)
    between = pulls.T @ pulls * len(pulls) / (len(pulls) - 1)
    between[free, free] += known[free]
    return by_noise, by_noise @ between @ by_noise, {name: at[k, _POSE:].tolist() for k, name in enumerate(names)}


def _parts(X: Float64s) -> Int64s:
    """(n,) the part of the scene that each point is in: halved again and again across its longest side."""
    part = np.zeros(len(X), np.int64)
    for _ in range(_HALVINGS):
        beyond = np.zeros(len(X), bool)
        for k in np.unique(part).tolist():
            own = np.flatnonzero(part == k)
            low, high = np.percentile(X[own], [10, 90], axis=0)
            along = X[own, int((high - low).argmax())]
            beyond[own] = along > np.median(along)
        part = 2 * part + beyond
    return part


def _pulls(
    J: Float64s, P: Float64s, r: Float64s, inverse: Float64s, at: Int64s, point: Int64s, part: Int64s, size: int
) -> Float64s:
    """(parts, size) by how much the points of each part of the scene pull cameras and lenses, the points themselves moved where
    they like; in sum nothing."""
    pulled = np.zeros((len(inverse), 3))
    np.add.at(pulled, point, np.einsum("nki,nk->ni", P, r))
    left = r - np.einsum("nki,nij,nj->nk", P, inverse[point], pulled[point])
    pulls = np.zeros((1 << _HALVINGS, size))
    np.add.at(pulls, (part[point][:, None], at), np.einsum("nki,nk->ni", J, left))
    return pulls


def _known(model: Model, names: list[int], at: Int64s, size: int, centre_sigma: float) -> Float64s:
    """(size,) how well each number is known beforehand, as the inverse of its variance: infinity where it isn't solved."""
    known = np.zeros(size)
    for k, name in enumerate(names):
        if name in model.lenses:
            known[at[k, _POSE:_OWN]] = (centre_sigma * model.cameras[name].width) ** -2.0
        else:
            known[at[k, _POSE:]] = np.inf
        if name in model.held:
            known[at[k, :_POSE]] = np.inf
    return known


def _linearised(model: Model, names: list[int], rows: Int64s, of: Int64s) -> tuple[Float64s, Float64s, Float64s]:
    """Slopes of the pixels by turn, centre, principal point and lens (n, 2, 11), and by the point (n, 2, 3); how far the pixels
    are from where the model has them (n, 2)."""
    cameras = [model.cameras[name] for name in names]
    R = np.array([camera.R for camera in cameras])[of]
    C = np.array([camera.C for camera in cameras])[of]
    lens = np.array([[camera.K[0, 0], *camera.radial] for camera in cameras])[of]
    Y = np.einsum("nij,nj->ni", R, model.X[model.tracks.track[rows]] - C)
    D, L = _slopes(Y, lens)
    turn = np.stack([np.einsum("nij,nj->ni", D, np.cross(np.eye(3)[axis], Y)) for axis in range(3)], axis=2)
    P = D @ R
    x = Y[:, :2] / Y[:, 2:]
    r2 = (x * x).sum(axis=1)
    aspect = np.array([[1.0, camera.K[1, 1] / camera.K[0, 0]] for camera in cameras])[of]
    bent = (lens[:, 0] * (1 + r2 * (lens[:, 1] + r2 * lens[:, 2])))[:, None] * aspect * x
    off = model.tracks.xy[rows] - np.array([camera.K[:2, 2] for camera in cameras])[of] - bent
    return np.concatenate([turn, -P, np.tile(np.eye(2), (len(rows), 1, 1)), L], axis=2), P, off


def _inverses(P: Float64s, point: Int64s, count: int) -> Float64s:
    """(count, 3, 3) of the normal equations of each point alone."""
    V = np.zeros((count, 3, 3))
    np.add.at(V, point, np.einsum("nki,nkj->nij", P, P))
    return np.linalg.inv(V + _LOOSE * np.trace(V, axis1=1, axis2=2)[:, None, None] * np.eye(3))


def _reduced(J: Float64s, P: Float64s, inverse: Float64s, at: Int64s, point: Int64s, size: int) -> Float64s:
    """The normal equations of cameras and lenses (size, size) without the points.

    Points are taken together that have as many observations: of these only the cameras that see them are touched.
    """
    H, count = np.zeros(size * size), len(inverse)
    np.add.at(H, (at[:, :, None] * size + at[:, None, :]).ravel(), np.einsum("nki,nkj->nij", J, J).ravel())
    between = np.einsum("nki,nkj->nij", J, P)
    first, seen = np.searchsorted(point, np.arange(count)), np.bincount(point, minlength=count)
    for many in np.unique(seen).tolist():
        alike = np.flatnonzero(seen == many)
        for k in range(0, len(alike), _AT_ONCE):
            part = alike[k : k + _AT_ONCE]
            rows = first[part][:, None] + np.arange(many)
            W, where = between[rows].reshape(len(part), -1, 3), at[rows].reshape(len(part), -1)
            lost = W @ inverse[part] @ np.swapaxes(W, 1, 2)
            np.subtract.at(H, (where[:, :, None] * size + where[:, None, :]).ravel(), lost.ravel())
    return H.reshape(size, size)

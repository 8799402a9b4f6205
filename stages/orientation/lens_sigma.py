"""How well the images of a site tell the lenses that were solved with its poses.

From the normal equations of the adjustment, reduced to cameras and lenses (Triggs et al. 2000, section 6), with Cauchy's weights.
A principal point is not solved with the rest, since matches that are wrong together pull it far: it moves as far as pictures tell
it better than that it is near the middle.  By how much what stays open of it puts all else off enters beside the noise (consider
parameters: Tapley, Schutz, Born, Statistical Orbit Determination, 2004, chapter 6).  It is one for all views of a lens, as all
else of the lens.  What a turn of the camera would undo is not counted.

What is wrong in matches is wrong in many at once: what wet ground mirrors, a texture that repeats.  So besides what independent
noise leaves open it is asked how far the lenses move when parts of the scene are left out, one at a time (the jackknife of
clusters: Bell & McCaffrey, Bias reduction in standard errors for linear regression with multi-stage samples, Survey Methodology
2002).  The larger of both counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..core.residual_distortion import without_distortion
from ..sfm.incremental import Model, refine
from ..types import Camera, Float64s, Int64s, LensSigma

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
_POSE, _LENS = 6, 5
"""Numbers of a pose (turn, centre), and of a lens (cx, cy, f, k1, k2)."""
_LOOSE = 1e-10
"""A share that holds the world where it is, whose place, turn and scale nothing tells."""
_AT_ONCE = 256
"""Points: bounds memory."""
_HALVINGS = 3
"""Of the scene, into parts with as many points: eight.  Fewer say little of a variance, and smaller ones are wrong together."""
_KEPT = 1e-3
"""Of its weight, by a part that is left out: what no other part shows is solved still."""
_LONG_SIDE = 768
"""Of larger frames, whose pixels show less, as many more pixels may be open by wrong matches or a principal point."""


@dataclass(frozen=True)
class _Equations:
    """The normal equations of an adjusted model."""

    H: Float64s
    """(parts, n, n) for turn and centre of each view, then cx, cy, f, k1, k2 of each lens, by part of the scene..."""
    pulls: Float64s
    """...(parts, n) and their right sides."""
    at: dict[int, Int64s]
    """Of each view, (11,) where in them its numbers are."""
    solved: Int64s
    """Where those are that are solved..."""
    centres: dict[int, Int64s]
    """...and (2,) the principal points of solved lenses, by the first view of each."""


@dataclass(frozen=True)
class _PrincipalPoint:
    """Where a principal point is likelier than where it is, pixels, and how well that is known."""

    step: Float64s
    """(2,) by how much it moves there..."""
    without: Float64s
    """...(parts, 2) and farther where a part of the scene is left out; squares of all parts add up to variances."""
    by_noise: Float64s
    """(2, 2) covariance of what noise does to it..."""
    left: Float64s
    """...and of what is left of what was open beforehand."""


def with_principal_points(model: Model) -> Model:
    """An adjusted model whose principal points are in the middle, adjusted again with them where they are likelier."""
    if not _may_ask(model):
        return model
    cameras = dict(model.cameras)
    for first, found in _principal_points(model, _equations(model), CENTRE_SIGMA).items():
        for view in [view for view in cameras if model.lenses.get(view) == model.lenses[first]]:
            K = cameras[view].K.copy()
            K[:2, 2] += found.step
            cameras[view] = replace(cameras[view], K=K)
    return refine(replace(model, cameras=cameras), rounds=3)


def lens_sigmas(model: Model, centre_sigma: float = CENTRE_SIGMA) -> dict[int, LensSigma]:
    """Of each view whose lens was solved, how well the observations of an adjusted model, whose residuals are the noise, tell it.

    centre_sigma: of principal points, of the width, before they were looked for.
    """
    if not _may_ask(model):
        return {}
    equations = _equations(model)
    covariances = _covariances(equations, _principal_points(model, equations, centre_sigma))
    found = {}
    for view in [view for view in equations.at if view in model.lenses]:
        lens, camera = equations.at[view][_POSE:], model.cameras[view]
        share = min(1.0, _LONG_SIDE / max(camera.width, camera.height))
        noise, parts, centre = (_border_px(camera, covariance[np.ix_(lens, lens)]) for covariance in covariances)
        noise_f, parts_f, centre_f = (float(np.sqrt(covariance[lens[2], lens[2]])) for covariance in covariances)
        focal = np.hypot(max(noise_f, parts_f), centre_f) / camera.K[0, 0]
        found[view] = LensSigma(float(focal), float(np.hypot(max(noise, share * parts), share * centre)))
    return found


def _may_ask(model: Model) -> bool:
    return any(view in model.lenses for view in model.cameras) and bool(model.use.any()) and len(model.cameras) <= MOST_VIEWS


def _principal_points(model: Model, equations: _Equations, centre_sigma: float) -> dict[int, _PrincipalPoint]:
    """Of each solved lens, by its first view: its principal point by what is known beforehand and by what the pictures tell."""
    columns = np.concatenate([equations.solved, *equations.centres.values()])
    by_noise, without, step = _left_out(equations, columns)
    found = {}
    for view, at in equations.centres.items():
        by_parts = without[:, at].T @ without[:, at]
        told = max(by_noise[np.ix_(at, at)], by_parts, key=np.trace)
        before = np.eye(2) * (centre_sigma * model.cameras[view].width) ** 2
        gain = before @ np.linalg.inv(before + told)
        ungained = np.eye(2) - gain
        of_noise, left = gain @ by_noise[np.ix_(at, at)] @ gain.T, ungained @ before @ ungained.T
        found[view] = _PrincipalPoint(gain @ step[at], without[:, at] @ gain.T, of_noise, left)
    return found


def _border_px(camera: Camera, covariance: Float64s) -> float:
    """Standard deviation of pixels at the border, from the covariance (5, 5) of cx, cy, f, k1, k2."""
    x, y = np.linspace(0.02, 0.98, 17) * (camera.width - 1), np.linspace(0.02, 0.98, 11) * (camera.height - 1)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    border = np.concatenate([grid[0], grid[-1], grid[1:-1, 0], grid[1:-1, -1]])
    (turn, of), (turn_b, of_b) = (_slopes_at(camera, pixels) for pixels in (grid.reshape(-1, 2), border))
    undone = of_b - turn_b @ np.linalg.lstsq(turn, of, rcond=None)[0]
    return float(np.sqrt(max(np.einsum("ni,ij,nj->", undone, covariance, undone) / len(border), 0.0)))


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


def _equations(model: Model) -> _Equations:
    """The normal equations of an adjusted model, its points moved where they like."""
    rows = np.flatnonzero(model.use)
    names = np.unique(model.tracks.view[rows]).tolist()
    owners = [model.lenses.get(name, -1 - name) for name in names]
    lenses = {lens: k for k, lens in enumerate(dict.fromkeys(owners))}
    start, size = _POSE * len(names), _POSE * len(names) + _LENS * len(lenses)
    lens = start + _LENS * np.array([lenses[owner] for owner in owners])[:, None] + np.arange(_LENS)
    at = np.column_stack([_POSE * np.arange(len(names))[:, None] + np.arange(_POSE), lens])
    of = np.searchsorted(names, model.tracks.view[rows])
    points, point = np.unique(model.tracks.track[rows], return_inverse=True)
    noise = max(float(np.median(model.error_px()[rows])) / RAYLEIGH, 1e-6)
    J, P, r = _linearised(model, names, rows, of)
    off = model.error_px()[rows] / noise
    weight = np.sqrt(1 / (1 + off**2 / LOSS**2)) / noise
    J, P, r = J * weight[:, None, None], P * weight[:, None, None], r * weight[:, None]
    V = np.zeros((len(points), 3, 3))  # of each point alone
    np.add.at(V, point, np.einsum("nki,nkj->nij", P, P))
    inverse = np.linalg.inv(V + _LOOSE * np.trace(V, axis1=1, axis2=2)[:, None, None] * np.eye(3))
    part = _parts(model.X[points])
    H, pulls = np.zeros((1 << _HALVINGS, size, size)), _pulls(J, P, r, inverse, at[of], point, part, size)
    for k in range(len(H)):
        mine, own = part[point] == k, np.flatnonzero(part == k)
        H[k] = _reduced(J[mine], P[mine], inverse[own], at[of[mine]], np.searchsorted(own, point[mine]), size)
    poses = [at[k, :_POSE] for k, name in enumerate(names) if name not in model.held]
    first = {owner: k for k, owner in reversed([*enumerate(owners)]) if names[k] in model.lenses}
    solved = np.concatenate([*poses, *(at[k, _POSE + 2 :] for k in first.values())])
    centres = {names[k]: at[k, _POSE : _POSE + 2] for k in first.values()}
    return _Equations(H, pulls, {name: at[k] for k, name in enumerate(names)}, solved, centres)


def _covariances(equations: _Equations, centres: dict[int, _PrincipalPoint]) -> tuple[Float64s, Float64s, Float64s]:
    """Covariances (n, n) of all cameras and lenses: by the noise, by the parts of the scene, and by what is left open of where
    principal points are."""
    by_noise, without, _ = _left_out(equations, equations.solved)
    by_centre, whole, without = np.zeros_like(by_noise), equations.H.sum(axis=0), without.copy()
    solved = by_noise
    for view, centre in centres.items():
        moved = -solved @ whole[:, equations.centres[view]]
        moved[equations.centres[view]] = np.eye(2)
        by_noise = by_noise + moved @ centre.by_noise @ moved.T
        without += centre.without @ moved.T
        by_centre += moved @ centre.left @ moved.T
    return by_noise, without.T @ without, by_centre


def _left_out(equations: _Equations, columns: Int64s) -> tuple[Float64s, Float64s, Float64s]:
    """Where only some of the numbers are solved, by their columns: their covariance (n, n) by the equations; how they move
    (parts, n) without each part of these, as roots of variances that add up; by how much (n,) they would still move."""
    H, pulls = equations.H[:, columns[:, None], columns], equations.pulls[:, columns]
    whole = H.sum(axis=0)
    whole[np.diag_indices_from(whole)] *= 1 + _LOOSE
    scale = 1 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
    scale = scale[:, None] * scale
    C = np.linalg.inv(whole * scale) * scale
    step = C @ pulls.sum(axis=0)
    without = np.linalg.inv((whole - (1 - _KEPT) * H) * scale) * scale
    moved = (1 - _KEPT) * (without @ (pulls - H @ step)[:, :, None])[:, :, 0]
    by_noise, moves, steps = (np.zeros_like(equations.H[0]), np.zeros_like(equations.pulls), np.zeros_like(equations.pulls[0]))
    by_noise[np.ix_(columns, columns)] = C
    moves[:, columns] = moved * np.sqrt((len(H) - 1) / len(H))
    steps[columns] = step
    return by_noise, moves, steps


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

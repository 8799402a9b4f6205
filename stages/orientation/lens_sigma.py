"""Uncertainty of the lenses that were solved together with the poses of a site.

It follows from the normal equations of the adjustment, reduced to cameras and lenses (Triggs et al. 2000, section 6), with Cauchy
weights.  A principal point is not solved with the rest, since correlated wrong matches pull it far: its correction is weighted by
how well the images determine it, compared with the prior, the image centre.  Its remaining uncertainty is propagated to all
other parameters, in addition to the noise (consider parameters: Tapley, Schutz, Born, Statistical Orbit Determination, 2004,
chapter 6).  All views of a lens share one principal point.  Effects that a rotation of the camera would undo are not counted.

Wrong matches come in groups: reflections in wet ground, a repetitive texture.  So besides the uncertainty due to independent
noise, this module measures how far the lenses move when parts of the scene are left out, one at a time (the jackknife of
clusters: Bell & McCaffrey, Bias reduction in standard errors for linear regression with multi-stage samples, Survey Methodology
2002).  The larger of the two counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..core.residual_distortion import without_distortion
from ..sfm.incremental import Model, refine
from ..sfm.triangulation import RAYLEIGH
from ..types import Camera, Float64s, Int64s, LensSigma

MOST_SIGMA_PX = 1.0
"""Largest standard deviation of border pixels for a lens to count as known: dense matching searches no farther off its rows."""
MOST_VIEWS = 64
"""Models with more views are not analysed: this many determine their lenses well, and larger equations take too long."""
CENTRE_SIGMA = 0.005
"""Prior standard deviation of a principal point around the image centre, as a share of the width."""
LOSS = 2.385
"""Scale of the Cauchy loss in standard deviations of the noise: 95 % efficient (Holland & Welsch 1977)."""
_POSE = 6
"""Number of parameters of a pose: rotation, centre."""
_LENS = 5
"""Number of parameters of a lens: cx, cy, f, k1, k2."""
_REGULARISATION = 1e-10
"""Relative regularisation that fixes the gauge: position, rotation and scale of the world are undetermined."""
_BATCH_POINTS = 256
"""Number of points processed together, which bounds memory."""
_HALVINGS = 3
"""Halvings of the scene, into eight parts of equal size: fewer estimate a variance badly, and smaller ones are correlated."""
_KEPT_SHARE = 1e-3
"""Share of its weight that a left-out part keeps, so that parameters which no other part determines stay solvable."""
_LONG_SIDE = 768
"""For larger frames, uncertainty from wrong matches or principal points is scaled down to this size: their pixels are finer."""


@dataclass(frozen=True)
class _Equations:
    """The normal equations of an adjusted model, separately for each part of the scene."""

    H: Float64s
    """(parts, n, n) normal matrices: rotation and centre of each view, then cx, cy, f, k1, k2 of each lens."""
    pulls: Float64s
    """(parts, n) right sides of the equations: the pull of each part's points; the parts add up to zero."""
    columns: dict[int, Int64s]
    """(11,) indices of each view's parameters."""
    solved: Int64s
    """Indices of the solved parameters."""
    centres: dict[int, Int64s]
    """(2,) indices of the principal point of each solved lens, by the first view of the lens."""


@dataclass(frozen=True)
class _PrincipalPoint:
    """Correction of a principal point in pixels, and its uncertainty."""

    step: Float64s
    """(2,) correction."""
    jackknife: Float64s
    """(parts, 2) further correction if a part of the scene is left out; the squares of all parts add up to variances."""
    by_noise: Float64s
    """(2, 2) covariance due to the noise."""
    prior_covariance: Float64s
    """(2, 2) covariance that remains from the prior."""


def with_principal_points(model: Model) -> Model:
    """The adjusted model with its principal points moved from the image centre to likelier positions, and adjusted again."""
    if not _can_estimate(model):
        return model
    cameras = dict(model.cameras)
    for first_view, correction in _principal_points(model, _equations(model), CENTRE_SIGMA).items():
        for view, camera in model.cameras.items():
            if model.lenses.get(view) == model.lenses[first_view]:
                K = camera.K.copy()
                K[:2, 2] += correction.step
                cameras[view] = replace(camera, K=K)
    return refine(replace(model, cameras=cameras), rounds=3)


def lens_sigmas(model: Model, centre_sigma: float = CENTRE_SIGMA) -> dict[int, LensSigma]:
    """Uncertainty of each view's lens if it was solved; the residuals of the adjusted model serve as the noise.

    centre_sigma: prior standard deviation of principal points, as a share of the width.
    """
    if not _can_estimate(model):
        return {}
    equations = _equations(model)
    covariances = _covariances(equations, _principal_points(model, equations, centre_sigma))
    sigmas = {}
    for view in equations.columns:
        if view not in model.lenses:
            continue
        columns = equations.columns[view][_POSE:]
        camera = model.cameras[view]
        shrinkage = min(1.0, _LONG_SIDE / max(camera.width, camera.height))
        px = []
        f = []
        for covariance in covariances:
            own = covariance[np.ix_(columns, columns)]
            px.append(_border_px(camera, own))
            f.append(float(np.sqrt(own[2, 2])))
        # The larger of noise and parts of the scene counts, and the principal point in addition.
        noise_px, parts_px, centre_px = px
        noise_f, parts_f, centre_f = f
        border_px = np.hypot(max(noise_px, shrinkage * parts_px), shrinkage * centre_px)
        focal_sigma = np.hypot(max(noise_f, parts_f), centre_f) / camera.K[0, 0]
        sigmas[view] = LensSigma(focal=float(focal_sigma), border_px=float(border_px))
    return sigmas


def _can_estimate(model: Model) -> bool:
    """Was any lens solved, by observations, among not too many views?"""
    has_lens = any(view in model.lenses for view in model.cameras)
    return has_lens and bool(model.use.any()) and len(model.cameras) <= MOST_VIEWS


def _principal_points(model: Model, equations: _Equations, centre_sigma: float) -> dict[int, _PrincipalPoint]:
    """Correction of the principal point of each solved lens from the prior and the images, by the first view of the lens."""
    columns = np.concatenate([equations.solved, *equations.centres.values()])
    by_noise, jackknife, step = _solve_columns(equations, columns)
    corrections = {}
    for view, centre in equations.centres.items():
        # Its uncertainty from the noise, and from the parts of the scene: the larger counts.
        by_parts = jackknife[:, centre].T @ jackknife[:, centre]
        measured = max(by_noise[np.ix_(centre, centre)], by_parts, key=np.trace)
        # The mean of prior (the image centre) and measurement, each weighted by the inverse of its covariance.
        prior = np.eye(2) * (centre_sigma * model.cameras[view].width) ** 2
        gain = prior @ np.linalg.inv(prior + measured)
        prior_share = np.eye(2) - gain
        corrections[view] = _PrincipalPoint(
            step=gain @ step[centre],
            jackknife=jackknife[:, centre] @ gain.T,
            by_noise=gain @ by_noise[np.ix_(centre, centre)] @ gain.T,
            prior_covariance=prior_share @ prior @ prior_share.T,
        )
    return corrections


def _border_px(camera: Camera, covariance: Float64s) -> float:
    """Standard deviation of border pixels, from the covariance (5, 5) of cx, cy, f, k1, k2, apart from what a rotation undoes."""
    x = np.linspace(0.02, 0.98, 17) * (camera.width - 1)
    y = np.linspace(0.02, 0.98, 11) * (camera.height - 1)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    border = np.concatenate([grid[0], grid[-1], grid[1:-1, 0], grid[1:-1, -1]])
    turn, lens = _derivatives_at(camera, grid.reshape(-1, 2))
    border_turn, border_lens = _derivatives_at(camera, border)
    # The rotation that best undoes a change of the lens over the whole image leaves this at the border.
    undoing = np.linalg.lstsq(turn, lens, rcond=None)[0]
    remaining = border_lens - border_turn @ undoing
    variance = np.einsum("ni,ij,nj->", remaining, covariance, remaining) / len(border)
    return float(np.sqrt(max(variance, 0.0)))


def _derivatives_at(camera: Camera, x: Float64s) -> tuple[Float64s, Float64s]:
    """Derivatives of pixels (n, 2) by a rotation of the camera (2n, 3), and by cx, cy, f, k1, k2 (2n, 5)."""
    undistorted = without_distortion(camera, x)
    Y = np.column_stack([(undistorted - camera.K[:2, 2]) / camera.K[0, 0], np.ones(len(x))])
    lens = np.tile([camera.K[0, 0], *camera.radial], (len(x), 1))
    by_point, by_lens = _derivatives(Y, lens)
    by_axis = []
    for axis in np.eye(3):  # a small rotation about an axis moves a point by axis x Y
        by_axis.append((by_point @ np.cross(axis, Y)[:, :, None])[:, :, 0])
    by_rotation = np.stack(by_axis, axis=2)
    by_centre = np.tile(np.eye(2), (len(x), 1, 1))
    return by_rotation.reshape(-1, 3), np.concatenate([by_centre, by_lens], axis=2).reshape(-1, 5)


def _derivatives(Y: Float64s, lens: Float64s) -> tuple[Float64s, Float64s]:
    """Derivatives of pixels by points (n, 3) in camera axes, (n, 2, 3), and by their lenses f, k1, k2, (n, 2, 3)."""
    f, k1, k2 = lens.T
    x = Y[:, :2] / Y[:, 2:]
    r2 = (x * x).sum(axis=1)
    # px = f factor(r2) x, with factor = 1 + k1 r2 + k2 r2^2, and slope its derivative by r2.
    factor = 1 + r2 * (k1 + r2 * k2)
    slope = k1 + 2 * r2 * k2
    px_by_x = f[:, None, None] * (factor[:, None, None] * np.eye(2) + 2 * slope[:, None, None] * x[:, :, None] * x[:, None, :])
    x_by_point = np.concatenate([np.tile(np.eye(2), (len(Y), 1, 1)), -x[:, :, None]], axis=2) / Y[:, 2][:, None, None]
    px_by_lens = np.stack([factor[:, None] * x, (f * r2)[:, None] * x, (f * r2 * r2)[:, None] * x], axis=2)
    return px_by_x @ x_by_point, px_by_lens


def _equations(model: Model) -> _Equations:
    """The normal equations of an adjusted model with its points eliminated."""
    # 1. Columns (views, 11) of each view's pose and lens: poses first, then lenses; views of one lens share its columns.
    rows = np.flatnonzero(model.use)
    views = np.unique(model.tracks.view[rows]).tolist()
    lens_ids = [model.lenses.get(view, -1 - view) for view in views]  # a lens that was not solved has a number of its own
    lens_index = {lens_id: k for k, lens_id in enumerate(dict.fromkeys(lens_ids))}
    lens_start = _POSE * len(views)
    size = lens_start + _LENS * len(lens_index)
    lens_of_view = np.array([lens_index[lens_id] for lens_id in lens_ids])
    pose_columns = _POSE * np.arange(len(views))[:, None] + np.arange(_POSE)
    lens_columns = lens_start + _LENS * lens_of_view[:, None] + np.arange(_LENS)
    columns = np.column_stack([pose_columns, lens_columns])

    # 2. Observations, linearised and weighted by the Cauchy loss in units of the noise.
    view_of = np.searchsorted(views, model.tracks.view[rows])
    points, point_of = np.unique(model.tracks.track[rows], return_inverse=True)
    noise = max(float(np.median(model.error_px()[rows])) / RAYLEIGH, 1e-6)
    J, P, r = _linearised(model, views, rows, view_of)
    error = model.error_px()[rows] / noise
    weight = np.sqrt(1 / (1 + error**2 / LOSS**2)) / noise
    J = J * weight[:, None, None]
    P = P * weight[:, None, None]
    r = r * weight[:, None]

    # 3. The points' own normal matrices V (points, 3, 3), and the residuals that remain with the points at their optimum.
    V = np.zeros((len(points), 3, 3))
    np.add.at(V, point_of, np.einsum("nki,nkj->nij", P, P))
    inverse = np.linalg.inv(V + _REGULARISATION * np.trace(V, axis1=1, axis2=2)[:, None, None] * np.eye(3))
    gradient = np.zeros((len(points), 3))
    np.add.at(gradient, point_of, np.einsum("nki,nk->ni", P, r))
    remaining = r - np.einsum("nki,nij,nj->nk", P, inverse[point_of], gradient[point_of])

    # 4. The equations of each part of the scene.
    part = _parts(model.X[points])
    pulls = np.zeros((1 << _HALVINGS, size))
    np.add.at(pulls, (part[point_of][:, None], columns[view_of]), np.einsum("nki,nk->ni", J, remaining))
    H = np.zeros((1 << _HALVINGS, size, size))
    for k in range(len(H)):
        own = part[point_of] == k
        members = np.flatnonzero(part == k)
        own_points = np.searchsorted(members, point_of[own])  # numbered within the part
        H[k] = _reduced(J[own], P[own], inverse[members], columns[view_of[own]], own_points, size)
    solved, centres = _solved_columns(model, views, lens_ids, columns)
    return _Equations(H, pulls, {view: columns[k] for k, view in enumerate(views)}, solved, centres)


def _solved_columns(model: Model, views: list[int], lens_ids: list[int], columns: Int64s) -> tuple[Int64s, dict[int, Int64s]]:
    """Columns of the poses that are not held and of the solved lenses without principal points; and those of the latter."""
    poses = [columns[k, :_POSE] for k, view in enumerate(views) if view not in model.held]
    first_views = {}  # by lens
    for k, lens_id in reversed(list(enumerate(lens_ids))):
        if views[k] in model.lenses:
            first_views[lens_id] = k
    lenses = [columns[k, _POSE + 2 :] for k in first_views.values()]
    centres = {views[k]: columns[k, _POSE : _POSE + 2] for k in first_views.values()}
    return np.concatenate([*poses, *lenses]), centres


def _covariances(equations: _Equations, centres: dict[int, _PrincipalPoint]) -> tuple[Float64s, Float64s, Float64s]:
    """Covariances (n, n) of all cameras and lenses: from the noise, from the parts of the scene, and from the remaining
    uncertainty of the principal points."""
    by_noise, jackknife, _ = _solve_columns(equations, equations.solved)
    by_centre = np.zeros_like(by_noise)
    total = equations.H.sum(axis=0)
    jackknife = jackknife.copy()
    solved = by_noise
    for view, centre in centres.items():
        # (n, 2): how far all parameters move if the principal point is moved by a pixel.
        sensitivity = -solved @ total[:, equations.centres[view]]
        sensitivity[equations.centres[view]] = np.eye(2)
        by_noise = by_noise + sensitivity @ centre.by_noise @ sensitivity.T
        jackknife += centre.jackknife @ sensitivity.T
        by_centre += sensitivity @ centre.prior_covariance @ sensitivity.T
    return by_noise, jackknife.T @ jackknife, by_centre


def _solve_columns(equations: _Equations, columns: Int64s) -> tuple[Float64s, Float64s, Float64s]:
    """Solve some of the parameters, named by their columns: their covariance (n, n); their changes (parts, n) without each part,
    scaled so that squares add up to variances; and the step (n,) that they would still take."""
    H = equations.H[:, columns[:, None], columns]
    pulls = equations.pulls[:, columns]
    total = H.sum(axis=0)
    total[np.diag_indices_from(total)] *= 1 + _REGULARISATION
    # Parameters have different units: inverted with a unit diagonal, and scaled back.
    scale = 1 / np.sqrt(np.maximum(np.diag(total), 1e-300))
    scale = scale[:, None] * scale
    covariance = np.linalg.inv(total * scale) * scale
    step = covariance @ pulls.sum(axis=0)
    part_inverse = np.linalg.inv((total - (1 - _KEPT_SHARE) * H) * scale) * scale
    change = (1 - _KEPT_SHARE) * (part_inverse @ (pulls - H @ step)[:, :, None])[:, :, 0]
    # All of them are of all parameters; those that were not solved stay where they are.
    by_noise = np.zeros_like(equations.H[0])
    moves = np.zeros_like(equations.pulls)
    steps = np.zeros_like(equations.pulls[0])
    by_noise[np.ix_(columns, columns)] = covariance
    moves[:, columns] = change * np.sqrt((len(H) - 1) / len(H))
    steps[columns] = step
    return by_noise, moves, steps


def _parts(X: Float64s) -> Int64s:
    """(n,) the part of the scene that each point is in: repeatedly halved across its longest side."""
    part = np.zeros(len(X), np.int64)
    for _ in range(_HALVINGS):
        in_upper_half = np.zeros(len(X), bool)
        for k in np.unique(part).tolist():
            members = np.flatnonzero(part == k)
            low, high = np.percentile(X[members], [10, 90], axis=0)
            coordinate = X[members, int((high - low).argmax())]
            in_upper_half[members] = coordinate > np.median(coordinate)
        part = 2 * part + in_upper_half
    return part


def _linearised(model: Model, views: list[int], rows: Int64s, view_of: Int64s) -> tuple[Float64s, Float64s, Float64s]:
    """Derivatives of the pixels by rotation, centre, principal point and lens (n, 2, 11), and by the point (n, 2, 3); and the
    residuals (n, 2), observed minus projected."""
    cameras = [model.cameras[view] for view in views]
    R = np.array([camera.R for camera in cameras])[view_of]
    C = np.array([camera.C for camera in cameras])[view_of]
    lens = np.array([[camera.K[0, 0], *camera.radial] for camera in cameras])[view_of]
    Y = np.einsum("nij,nj->ni", R, model.X[model.tracks.track[rows]] - C)
    by_point, by_lens = _derivatives(Y, lens)
    by_rotation = np.stack([np.einsum("nij,nj->ni", by_point, np.cross(axis, Y)) for axis in np.eye(3)], axis=2)
    P = by_point @ R
    x = Y[:, :2] / Y[:, 2:]
    r2 = (x * x).sum(axis=1)
    aspect = np.array([[1.0, camera.K[1, 1] / camera.K[0, 0]] for camera in cameras])[view_of]
    distorted = (lens[:, 0] * (1 + r2 * (lens[:, 1] + r2 * lens[:, 2])))[:, None] * aspect * x
    error = model.tracks.xy[rows] - np.array([camera.K[:2, 2] for camera in cameras])[view_of] - distorted
    return np.concatenate([by_rotation, -P, np.tile(np.eye(2), (len(rows), 1, 1)), by_lens], axis=2), P, error


def _reduced(J: Float64s, P: Float64s, inverse: Float64s, columns: Int64s, point_of: Int64s, size: int) -> Float64s:
    """The normal matrix of cameras and lenses (size, size) with the points eliminated.

    Points with equally many observations are processed together, and touch only the cameras that see them.
    """
    count = len(inverse)
    H = np.zeros(size * size)
    np.add.at(H, (columns[:, :, None] * size + columns[:, None, :]).ravel(), np.einsum("nki,nkj->nij", J, J).ravel())
    coupling = np.einsum("nki,nkj->nij", J, P)
    # Observations are sorted by point: those of a point begin at its first row.
    first_row = np.searchsorted(point_of, np.arange(count))
    sightings = np.bincount(point_of, minlength=count)
    for n in np.unique(sightings).tolist():
        points = np.flatnonzero(sightings == n)
        for k in range(0, len(points), _BATCH_POINTS):
            batch = points[k : k + _BATCH_POINTS]
            rows = first_row[batch][:, None] + np.arange(n)
            W = coupling[rows].reshape(len(batch), -1, 3)
            coupled = columns[rows].reshape(len(batch), -1)
            eliminated = W @ inverse[batch] @ np.swapaxes(W, 1, 2)
            np.subtract.at(H, (coupled[:, :, None] * size + coupled[:, None, :]).ravel(), eliminated.ravel())
    return H.reshape(size, size)

"""Growing a set of cameras: two views first, then one after the other by the points it shares with those that are there.

Every decision is by rank or by the noise of the residuals themselves: no length enters, since the scale is free.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
import poselib

from ..epipolar import triangulate_depth
from ..types import Bools, Camera, Float64s, Geometry
from .bundle import adjust
from .tracks import Edge, Tracks, straightened, without_distortion
from .triangulation import angles, posed, residuals, triangulate

LOOSE_PX = 4.0
"""An observation farther from its point than this is wrong, whatever the noise; also the threshold of resection."""
NOISES = 20.0
"""In the end, an observation farther from its point than this many standard deviations of the noise is wrong.  So many, because
the noise is that of the many small keypoints: those of large ones scatter more, and they are what ties wide views together."""
COARSE_PX = 1.0
"""Scale of the robust loss while views are still being added..."""
FINE = 10.0
"""...and in the end, in standard deviations of the noise."""
MIN_ANGLE = np.radians(1.0)
"""Rays that meet at less than this don't make a point."""
MIN_POINTS = 12
"""So many points at least must agree on the pose of a view."""
MIN_SHARED = 5
"""So many at least on how far it is from a view that it makes a pair with..."""
SAME_LENGTH = 0.1
"""...to this share of the distance; and at least half of those that could."""
FOCALS_FROM = 3
"""Focal lengths are solved once there are so many views: two leave them nearly free."""

LENSES_DIFFER = 0.02
"""Views don't share a lens if their own focal lengths spread by more than this share..."""
OWN_LENS_GAIN = 0.85
"""...and having their own brings the median error below this share of what it was."""


@dataclass(frozen=True)
class Model:
    """cameras: by number of the view; tracks: the observations, as they are in the frames; X: (count, 3) points of the tracks,
    nan where there is none; use: (n,) which observations they rest on; lenses: views whose focal length and distortion are solved
    too, each with the number of the lens that it may share with others."""

    cameras: dict[int, Camera]
    tracks: Tracks
    X: Float64s
    use: Bools
    lenses: Mapping[int, int]

    @property
    def straight(self) -> Tracks:
        """The observations as pinhole cameras would have them."""
        return straightened(self.tracks, self.cameras)

    def error_px(self) -> Float64s:
        """(n,) distance of each observation to its projected point; nan or inf where there is none."""
        return np.asarray(np.linalg.norm(residuals(self.cameras, self.straight, self.X), axis=1), dtype=np.float64)


def grow(
    cameras: Mapping[int, Camera],
    tracks: Tracks,
    geometries: Mapping[Edge, Geometry],
    *,
    lenses: Mapping[int, int] | None = None,
) -> Model | None:
    """Solve as many views as hang together with the best pair.

    Parameters
    ----------
    cameras
        Intrinsics of every view, known or guessed; R and C don't count.
    tracks
        Observations.
    geometries
        The pairs that are believed, with relative poses.
    lenses
        See `Model`.

    Returns
    -------
    Model, or None when not even two views can be placed.
    """
    model = _from_best_pair(cameras, tracks, geometries, lenses or {})
    if model is None:
        return None
    failed: dict[int, int] = {}
    while True:
        seen = _visible_points(model, set(cameras) - set(model.cameras))
        candidates = [view for view, count in seen.items() if count >= MIN_SHARED and failed.get(view, -1) < count]
        if not candidates:
            break
        view = max(candidates, key=lambda v: (seen[v], -v))
        bare = _with_lens(cameras[view], view, model)
        camera = _resect(bare, view, model) or _attached(bare, view, model, geometries)
        if camera is None:
            failed[view] = seen[view]
            continue
        model = refine(replace_cameras(model, {**model.cameras, view: camera}), rounds=1, loss_px=COARSE_PX)
    return _with_own_lenses(refine(model, rounds=4, loss_px=COARSE_PX))


def refine(
    model: Model,
    known: Collection[int] = (),
    rounds: int = 2,
    loss_px: float | None = None,
    positions: Mapping[int, tuple[Float64s, float]] | None = None,
) -> Model:
    """The model after so many rounds of triangulation, adjustment and sorting out; cameras in `known` stay.

    loss_px: scale of the robust loss; None: from the noise of the residuals; positions: of three views or more, with standard
    deviations, in the world where the model already stands.
    """
    free = {view: lens for view, lens in model.lenses.items() if view in model.cameras}
    if len(model.cameras) < FOCALS_FROM and not known:
        free = {}
    for _ in range(rounds):
        model = _retriangulated(model)
        if not model.use.any():
            return model
        held = [view for view in known if view in model.cameras]
        noise = max(_noise(model.error_px()[model.use]), 4e-4)
        loss = FINE * noise if loss_px is None else loss_px
        weighed = {view: (C, sigma / noise) for view, (C, sigma) in (positions or {}).items()}
        args = model.cameras, model.tracks, model.X, model.use
        cameras, X = adjust(*args, held=held, focals=free, positions=weighed, loss_px=loss)
        model = _filtered(replace(model, cameras=cameras, X=X))
    return model


def replace_cameras(model: Model, cameras: dict[int, Camera]) -> Model:
    """The model with other cameras, in the order of their numbers."""
    return replace(model, cameras=dict(sorted(cameras.items())))


def _from_best_pair(
    cameras: Mapping[int, Camera], tracks: Tracks, geometries: Mapping[Edge, Geometry], lenses: Mapping[int, int]
) -> Model | None:
    """The pair with most points at a good angle; points that other views share count twice, since these are to follow."""
    best: tuple[float, Model] | None = None
    lengths = np.bincount(tracks.track, minlength=tracks.count)
    for (i, j), geometry in geometries.items():
        R, t = geometry.cam2_R_cam1, geometry.cam2_t_cam1
        if R is None or t is None:
            continue
        pair = {i: replace(cameras[i], R=np.eye(3), C=np.zeros(3)), j: replace(cameras[j], R=R, C=-R.T @ t)}
        unseen = Model(pair, tracks, np.full((tracks.count, 3), np.nan), np.zeros(len(tracks.track), bool), lenses)
        model = _retriangulated(unseen)
        wide = angles(pair, tracks, model.X, model.use)
        worth = float((np.minimum(wide / np.radians(15), 1) * (1 + (lengths > 2))).sum())
        if best is None or worth > best[0]:
            best = (worth, model)
    if best is None or np.isfinite(best[1].X[:, 0]).sum() < MIN_POINTS:
        return None
    return refine(best[1], rounds=2, loss_px=COARSE_PX)


def _visible_points(model: Model, views: Collection[int]) -> dict[int, int]:
    there = np.isfinite(model.X[model.tracks.track, 0])
    return {view: int((there & (model.tracks.view == view)).sum()) for view in sorted(views)}


def _with_lens(camera: Camera, view: int, model: Model) -> Camera:
    """The camera with the focal length and distortion that views of the same lens have been found to have."""
    for other, found in model.cameras.items():
        if view in model.lenses and model.lenses.get(other) == model.lenses[view]:
            return replace(camera, K=found.K, radial=found.radial)
    return camera


def _resect(camera: Camera, view: int, model: Model) -> Camera | None:
    """The view's pose from the points it shares with the model; None when too few agree."""
    tracks = model.tracks
    rows = np.flatnonzero((tracks.view == view) & np.isfinite(model.X[tracks.track, 0]))
    x, X = without_distortion(camera, tracks.xy[rows]), model.X[tracks.track[rows]]
    K = camera.K
    pinhole = {
        "model": "PINHOLE",
        "width": camera.width,
        "height": camera.height,
        "params": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
    }
    options = {"max_reproj_error": LOOSE_PX, "max_iterations": 10000, "min_iterations": 200, "seed": 0}
    pose, found = poselib.estimate_absolute_pose(x, X, pinhole, options, {})
    if found["num_inliers"] < max(MIN_POINTS, 0.25 * len(rows)):
        return None
    R, t = np.asarray(pose.R), np.asarray(pose.t)
    return replace(camera, R=R, C=-R.T @ t)


def _attached(camera: Camera, view: int, model: Model, geometries: Mapping[Edge, Geometry]) -> Camera | None:
    """The view's pose from that of a pair with a solved view; points that a third view sees tell only the length of the baseline.

    For views so wide apart that too few points are seen by three of them.
    """
    best: tuple[int, Camera] | None = None
    tracks = model.straight
    mine = np.flatnonzero((tracks.view == view) & np.isfinite(model.X[tracks.track, 0]))
    for edge, geometry in geometries.items():
        other = edge[1] if edge[0] == view else edge[0]
        R, t = geometry.cam2_R_cam1, geometry.cam2_t_cam1
        if view not in edge or other not in model.cameras or R is None or t is None:
            continue
        base = model.cameras[other]
        R, step = (R.T @ base.R, base.R.T @ t) if edge[0] == view else (R @ base.R, -base.R.T @ R.T @ t)
        theirs = np.flatnonzero(tracks.view == other)
        _, a, b = np.intersect1d(tracks.track[theirs], tracks.track[mine], return_indices=True)
        x_base, x = tracks.xy[theirs[a]], without_distortion(camera, tracks.xy[mine[b]])
        unit, _ = triangulate_depth(base, replace(camera, R=R, C=base.C + step), x_base, x)
        lengths = ((model.X[tracks.track[mine[b]]] - base.C) @ base.R[2]) / unit
        lengths = lengths[np.isfinite(lengths) & (lengths > 0)]
        if len(lengths) < MIN_SHARED:
            continue
        length = float(np.median(lengths))
        agree = int((np.abs(lengths / length - 1) < SAME_LENGTH).sum())
        if agree >= max(MIN_SHARED, 0.5 * len(x)) and (best is None or agree > best[0]):
            best = agree, replace(camera, R=R, C=base.C + length * step)
    return None if best is None else best[1]


def _with_own_lenses(model: Model) -> Model:
    """The model with a lens for each view instead of shared ones, where these turn out to differ and that explains the images."""
    members: dict[int, list[int]] = {}
    for view in model.cameras:
        if view in model.lenses:
            members.setdefault(model.lenses[view], []).append(view)
    if all(len(views) == 1 for views in members.values()):
        return model
    own = refine(replace(model, lenses={view: view for view in model.lenses}), rounds=4, loss_px=COARSE_PX)
    focal = {view: np.log(camera.K[0, 0]) for view, camera in own.cameras.items()}
    spread = max(np.ptp([focal[view] for view in views]) for views in members.values())
    gain = np.median(own.error_px()[own.use]) / np.median(model.error_px()[model.use])
    return own if spread > LENSES_DIFFER and gain < OWN_LENS_GAIN else model


def _retriangulated(model: Model) -> Model:
    """All points anew from all observations; then without those that don't fit."""
    tracks = model.straight
    everything = posed(model.cameras, tracks)
    X = triangulate(model.cameras, tracks, everything, 1.0)
    first = _filtered(replace(model, X=X, use=everything))
    X = triangulate(model.cameras, tracks, first.use, 1.0)
    return _filtered(replace(model, X=X, use=everything))


def _filtered(model: Model) -> Model:
    """Only observations that fit, and points that two of them see at an angle."""
    tracks, error = model.tracks, model.error_px()
    with np.errstate(invalid="ignore"):
        use = model.use & (error < _limit(error[model.use]))
    wide = angles(model.cameras, tracks, model.X, use) >= MIN_ANGLE
    enough = np.bincount(tracks.track[use], minlength=tracks.count) >= 2
    use &= (wide & enough)[tracks.track]
    X = np.where((wide & enough)[:, None], model.X, np.nan)
    return replace(model, X=X, use=use)


def _limit(error: Float64s) -> float:
    """Largest error of a right observation: `NOISES` standard deviations of their core (Rayleigh), at most `LOOSE_PX`."""
    return min(LOOSE_PX, max(NOISES * _noise(error), 1e-9))


def _noise(error: Float64s) -> float:
    """Standard deviation of one coordinate, from the median of errors that can be right (Rayleigh)."""
    fits = error[error < LOOSE_PX]
    return float(np.median(fits)) / 1.1774 if len(fits) else LOOSE_PX

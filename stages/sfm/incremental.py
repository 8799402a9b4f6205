"""Incremental reconstruction: start with two views, then add one view after the other by the points it shares with the model.

All decisions use ranks or the noise of the residuals: no length enters, since the scale is free.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
import poselib

from ..core.cameras import backproject, project, ray_angles
from ..core.epipolar import triangulate_depth
from ..core.residual_distortion import without_distortion
from ..twoview.robust import pinhole
from ..types import Bools, Camera, Float64s, Geometry
from .bundle import adjust
from .rigs import posed_by_sibling
from .tracks import Edge, Tracks, spread_tracks, undistort_tracks
from .triangulation import RAYLEIGH, angles, posed, residuals, triangulate

LOOSE_PX = 4.0
"""Observations farther from their point than this are outliers at any noise level; also the threshold of resection."""
NOISES = 20.0
"""Observations farther from their point than this many standard deviations of the noise are outliers.  So large a factor, because
the noise is that of the many small keypoints: large keypoints scatter more, and they connect wide views."""
COARSE_PX = 1.0
"""Scale of the robust loss while views are still being added."""
FINE_SIGMAS = 10.0
"""Scale of the robust loss in the final adjustment, in standard deviations of the noise."""
MIN_ANGLE = np.radians(1.0)
"""Rays that meet at less than this (radians) yield no point."""
MIN_POINTS = 12
"""Fewest points of a first model, and fewest that must agree on the pose of a view."""
MIN_SHARED = 5
"""Fewest points that must agree on the distance of a view from the view that it is paired with."""
KNOWN_SHARE = 0.5
"""A model starts from known cameras if these agree on this share of the points that at least two of them see."""
SAME_LENGTH = 0.1
"""Points agree on a baseline if the lengths they imply differ from the median by less than this share; half of them must."""
LEAST_CHANGED = 1e-3
"""Rounds end when no more than this share of the observations enters or leaves."""
ROUGH_GAIN = 1e-5
"""The adjustment of a growing model ends when a step lowers its cost by no more than this share."""
EXACT_GAIN = 1e-6
"""The same for the final adjustment.  Long rows of cameras need it this small, as bending them costs almost nothing."""
GROWTH_FACTOR = 1.25
"""All cameras are adjusted again when their number has grown by this factor since the last time."""
SKETCH_OBSERVATIONS = 5
"""Observations in each grid field of a view that enter an adjustment while the model grows."""
SKETCH_STEPS = 10
"""Most steps of an adjustment while the model grows."""
FOCALS_FROM = 3
"""Focal lengths are solved from this number of views on: two views leave them nearly free."""
LENSES_DIFFER = 0.02
"""Views get lenses of their own only if the focal lengths solved separately spread by more than this share."""
OWN_LENS_GAIN = 0.85
"""Views get lenses of their own only if this lowers the median error below this share of what it was."""


@dataclass(frozen=True)
class Model:
    """Cameras and points in a frame of their own, with the observations that support them."""

    cameras: dict[int, Camera]
    """By view number."""
    tracks: Tracks
    """The observations, in frame pixels."""
    X: Float64s
    """(count, 3) points of the tracks, nan if there is none."""
    use: Bools
    """(n,) which observations support the points."""
    lenses: Mapping[int, int]
    """Views whose focal length and distortion are solved too, each with the number of its lens, which views may share."""
    held: tuple[int, ...] = ()
    """Views whose cameras are known and stay fixed."""

    @classmethod
    def without_points(cls, cameras: Mapping[int, Camera], tracks: Tracks, lenses: Mapping[int, int]) -> Model:
        """Cameras whose points are yet to be triangulated."""
        return cls(dict(cameras), tracks, np.full((tracks.count, 3), np.nan), np.zeros(len(tracks.track), bool), lenses)

    @property
    def undistorted_tracks(self) -> Tracks:
        """The observations with the radial distortion of the cameras removed."""
        return undistort_tracks(self.tracks, self.cameras)

    def error_px(self) -> Float64s:
        """(n,) distance of each observation to its projected point; nan or inf if there is none."""
        return np.asarray(np.linalg.norm(residuals(self.cameras, self.undistorted_tracks, self.X), axis=1), dtype=np.float64)


def grow(
    cameras: Mapping[int, Camera],
    tracks: Tracks,
    geometries: Mapping[Edge, Geometry],
    *,
    lenses: Mapping[int, int] | None = None,
    known: Mapping[int, Camera] | None = None,
) -> Model | None:
    """Solve all views that connect to the known cameras, or to the best pair; None if not even two can be placed.

    Parameters
    ----------
    cameras : intrinsics of every view, known or guessed; R and C are ignored.
    tracks : observations of all views.
    geometries : the accepted pairs, with relative poses.
    lenses : see `Model`.
    known : cameras whose poses are known: if at least two of them see the same points, the model starts from them, in their
        world frame.
    """
    model = _from_known(known or {}, tracks, lenses or {})
    if model is None:
        model = _from_best_pair(cameras, tracks, geometries, lenses or {})
    if model is None:
        return None
    adjusted_count = len(model.cameras)
    failed: dict[int, int] = {}
    while next_view := _next_view(model, cameras, geometries, failed):
        view, camera = next_view
        model = replace_cameras(model, {**model.cameras, view: camera})
        # adjusting all cameras for each new one would cost the square of their number
        if len(model.cameras) >= GROWTH_FACTOR * adjusted_count:
            model = _sketched(model)
            adjusted_count = len(model.cameras)
        else:
            model = _with_view_fitted(model, view)
    return _with_own_lenses(_sketched(model))


def _next_view(
    model: Model, cameras: Mapping[int, Camera], geometries: Mapping[Edge, Geometry], failed: dict[int, int]
) -> tuple[int, Camera] | None:
    """The view that sees most of the model's points among those that can be placed, and its camera; a view of a camera that is
    already placed by another view comes first.

    failed: number of points seen by each view that could not be placed; it is tried again only with more.
    """
    for view, unposed in cameras.items():
        if view in model.cameras:
            continue
        placed = posed_by_sibling(unposed, model.cameras)
        if placed is not None:
            return view, placed
    # the number of points that each view sees
    tracks = model.tracks
    counts = np.bincount(tracks.view[np.isfinite(model.X[tracks.track, 0])], minlength=max(cameras) + 1)
    waiting = []
    for view in cameras:
        needed = max(MIN_SHARED, failed.get(view, 0) + 1)
        if view not in model.cameras and counts[view] >= needed:
            waiting.append(view)
    for view in sorted(waiting, key=lambda v: (-counts[v], v)):
        unposed = _with_lens(cameras[view], view, model)
        camera = _resect(unposed, view, model) or _attached_to_pair(unposed, view, model, geometries)
        if camera is not None:
            return view, camera
        failed[view] = int(counts[view])
    return None


def _sketched(model: Model) -> Model:
    """The growing model after a quick adjustment, of some of the tracks in a few steps, that suffices for adding views."""
    model = _retriangulated(model)
    focals = _solved_lenses(model) if len(model.cameras) >= FOCALS_FROM else {}
    cameras, _ = adjust(
        model.cameras,
        model.tracks,
        model.X,
        _spread_use(model),
        held=model.held,
        focals=focals,
        loss_px=COARSE_PX,
        tolerance=ROUGH_GAIN,
        iterations=SKETCH_STEPS,
    )
    return _retriangulated(replace(model, cameras=cameras))


def _with_view_fitted(model: Model, view: int) -> Model:
    """The model with this one camera fitted; the other cameras, and points that it does not see, stay fixed."""
    tracks = model.tracks
    seen = np.zeros(tracks.count, bool)
    seen[tracks.track[tracks.view == view]] = True
    if not seen.any():
        return model
    # the part of the model that the view sees, with its tracks numbered anew
    rows = seen[tracks.track]
    number = np.cumsum(seen, dtype=np.int32) - 1
    part_tracks = Tracks(number[tracks.track[rows]], tracks.view[rows], tracks.xy[rows], int(seen.sum()))
    part_cameras = {v: model.cameras[v] for v in np.unique(part_tracks.view).tolist() if v in model.cameras}
    part = _retriangulated(Model(part_cameras, part_tracks, model.X[seen], model.use[rows], model.lenses))
    # a view of a camera that is already placed by another view has no freedom
    others = {v: camera for v, camera in model.cameras.items() if v != view}
    if part.use.any() and posed_by_sibling(model.cameras[view], others) is None:
        # a lens that other views share is not solved from this view alone
        lenses = _solved_lenses(model)
        is_own_lens = list(lenses.values()).count(lenses.get(view, -1)) == 1
        cameras, _ = adjust(
            part_cameras,
            part_tracks,
            part.X,
            _spread_use(part),
            held=[v for v in part_cameras if v != view],
            focals={view: lenses[view]} if is_own_lens else {},
            loss_px=COARSE_PX,
            tolerance=ROUGH_GAIN,
            iterations=SKETCH_STEPS,
        )
        part = _retriangulated(replace(part, cameras=cameras))
    X = model.X.copy()
    X[seen] = part.X
    use = model.use.copy()
    use[rows] = part.use
    return replace(model, cameras=model.cameras | part.cameras, X=X, use=use)


def _spread_use(model: Model) -> Bools:
    """(n,) observations in use of a subset of the tracks that still covers every view."""
    in_subset = spread_tracks(model.tracks, model.use, SKETCH_OBSERVATIONS)
    return np.asarray(model.use & in_subset[model.tracks.track])


def _solved_lenses(model: Model) -> dict[int, int]:
    """The solved lenses of the views that the model has."""
    return {view: lens for view, lens in model.lenses.items() if view in model.cameras}


def refine(
    model: Model,
    known: Collection[int] = (),
    rounds: int = 2,
    rough: bool = False,
    positions: Mapping[int, tuple[Float64s, float]] | None = None,
) -> Model:
    """The model after rounds of triangulation, adjustment and outlier removal, until the observations settle.

    Parameters
    ----------
    model : initial model.
    known : views whose cameras stay fixed.
    rounds : largest number of rounds.
    rough : use the loss and the tolerance of a growing model.
    positions : known centres (3,) of at least three views, with standard deviations, in the world frame of the model.
    """
    has_fixed = bool(known) or bool(model.held)
    free_lenses = _solved_lenses(model) if len(model.cameras) >= FOCALS_FROM or has_fixed else {}
    held = [view for view in model.cameras if view in known or view in model.held]
    adjusted_use = np.zeros_like(model.use)
    for _ in range(rounds):
        model = _retriangulated(model)
        if (model.use != adjusted_use).sum() <= LEAST_CHANGED * model.use.sum():
            break
        adjusted_use = model.use
        noise = max(_noise(model.error_px()[model.use]), 4e-4)  # observations without any noise would have infinite weight
        cameras, X = adjust(
            model.cameras,
            model.tracks,
            model.X,
            model.use,
            held=held,
            focals=free_lenses,
            positions={view: (C, sigma / noise) for view, (C, sigma) in (positions or {}).items()},
            loss_px=COARSE_PX if rough else FINE_SIGMAS * noise,
            tolerance=ROUGH_GAIN if rough else EXACT_GAIN,
        )
        model = _filtered(replace(model, cameras=cameras, X=X))
    return model


def replace_cameras(model: Model, cameras: dict[int, Camera]) -> Model:
    """The model with other cameras, sorted by view number."""
    return replace(model, cameras=dict(sorted(cameras.items())))


def _from_known(known: Mapping[int, Camera], tracks: Tracks, lenses: Mapping[int, int]) -> Model | None:
    """A model of the known cameras and the points that they share; None if too few points agree with them."""
    if len(known) < 2:
        return None
    model = _retriangulated(replace(Model.without_points(known, tracks, lenses), held=tuple(known)))
    point_count = int(np.isfinite(model.X[:, 0]).sum())
    views_of_track = np.bincount(tracks.track[posed(known, tracks)], minlength=tracks.count)
    shared_count = int((views_of_track >= 2).sum())
    if point_count < max(MIN_POINTS, KNOWN_SHARE * shared_count):
        return None
    return model


def _from_best_pair(
    cameras: Mapping[int, Camera], tracks: Tracks, geometries: Mapping[Edge, Geometry], lenses: Mapping[int, int]
) -> Model | None:
    """A model of the pair with most points at a good angle; points that other views see count twice: they place those."""
    best: tuple[float, dict[int, Camera]] | None = None
    track_lengths = np.bincount(tracks.track, minlength=tracks.count)
    rows = {view: np.flatnonzero(tracks.view == view) for view in cameras}
    for (i, j), geometry in geometries.items():
        R = geometry.cam2_R_cam1
        t = geometry.cam2_t_cam1
        if R is None or t is None:
            continue
        left = replace(cameras[i], R=np.eye(3), C=np.zeros(3))
        right = replace(cameras[j], R=R, C=-R.T @ t)
        shared, a, b = np.intersect1d(tracks.track[rows[i]], tracks.track[rows[j]], return_indices=True)
        angle = _angles_of_pair(left, right, tracks.xy[rows[i][a]], tracks.xy[rows[j][b]])
        angle_worth = np.minimum(angle / np.radians(15), 1)  # wider angles place a point no better
        worth = float((angle_worth * (1 + (track_lengths[shared] > 2))).sum())
        if best is None or worth > best[0]:
            best = (worth, {i: left, j: right})
    if best is None:
        return None
    model = _retriangulated(Model.without_points(best[1], tracks, lenses))
    if np.isfinite(model.X[:, 0]).sum() < MIN_POINTS:
        return None
    model = refine(model, rounds=2, rough=True)
    if np.isfinite(model.X[:, 0]).sum() < MIN_POINTS:  # the adjustment may leave too few
        return None
    return model


def _angles_of_pair(left: Camera, right: Camera, x1: Float64s, x2: Float64s) -> Float64s:
    """(n,) angle in radians between the rays of two cameras; 0 if they miss each other, or meet behind a camera."""
    X = backproject(left, x1, triangulate_depth(left, right, x1, x2)[0])
    projected, depth = project(right, X)
    with np.errstate(invalid="ignore"):
        meets = (np.linalg.norm(projected - x2, axis=1) < LOOSE_PX) & (depth > 0)
    angle = ray_angles(X - left.C, X - right.C)
    return np.where(meets & np.isfinite(angle), angle, 0.0)


def _with_lens(camera: Camera, view: int, model: Model) -> Camera:
    """The camera with the focal length and distortion that other views of its lens have in the model."""
    for other, solved in model.cameras.items():
        if view in model.lenses and model.lenses.get(other) == model.lenses[view]:
            return replace(camera, K=solved.K, radial=solved.radial)
    return camera


def _resect(camera: Camera, view: int, model: Model) -> Camera | None:
    """The view's pose from the points it shares with the model; None if too few agree."""
    tracks = model.tracks
    rows = np.flatnonzero((tracks.view == view) & np.isfinite(model.X[tracks.track, 0]))
    x = without_distortion(camera, tracks.xy[rows])
    X = model.X[tracks.track[rows]]
    options = {"max_reproj_error": LOOSE_PX, "max_iterations": 10000, "min_iterations": 200, "seed": 0}
    pose, statistics = poselib.estimate_absolute_pose(x, X, pinhole(camera), options, {})
    if statistics["num_inliers"] < max(MIN_POINTS, 0.25 * len(rows)):
        return None
    R = np.asarray(pose.R)
    return replace(camera, R=R, C=-R.T @ np.asarray(pose.t))


def _attached_to_pair(camera: Camera, view: int, model: Model, geometries: Mapping[Edge, Geometry]) -> Camera | None:
    """The view's pose from its pair with a solved view; points of the model determine only the length of the baseline.

    This serves views so far apart that too few points are seen by three of them.
    """
    best: Camera | None = None
    most_agreeing = 0
    tracks = model.undistorted_tracks
    rows = np.flatnonzero((tracks.view == view) & np.isfinite(model.X[tracks.track, 0]))
    for edge, geometry in geometries.items():
        other = edge[1] if edge[0] == view else edge[0]
        R_pair = geometry.cam2_R_cam1
        t = geometry.cam2_t_cam1
        if view not in edge or other not in model.cameras or R_pair is None or t is None:
            continue
        # rotation of the view, and unit vector from the solved view to it, both in the model's world
        base = model.cameras[other]
        if edge[0] == view:
            R = R_pair.T @ base.R
            direction = base.R.T @ t
        else:
            R = R_pair @ base.R
            direction = -base.R.T @ R_pair.T @ t
        # each shared point implies a length: its depth in the model over its depth for a baseline of length 1
        base_rows = np.flatnonzero(tracks.view == other)
        _, a, b = np.intersect1d(tracks.track[base_rows], tracks.track[rows], return_indices=True)
        x_base = tracks.xy[base_rows[a]]
        x = without_distortion(camera, tracks.xy[rows[b]])
        unit_depth, _ = triangulate_depth(base, replace(camera, R=R, C=base.C + direction), x_base, x)
        lengths = ((model.X[tracks.track[rows[b]]] - base.C) @ base.R[2]) / unit_depth
        lengths = lengths[np.isfinite(lengths) & (lengths > 0)]
        if len(lengths) < MIN_SHARED:
            continue
        length = float(np.median(lengths))
        agreeing = int((np.abs(lengths / length - 1) < SAME_LENGTH).sum())
        if agreeing >= max(MIN_SHARED, 0.5 * len(x)) and agreeing > most_agreeing:
            best = replace(camera, R=R, C=base.C + length * direction)
            most_agreeing = agreeing
    return best


def _with_own_lenses(model: Model) -> Model:
    """The model with a lens for each view instead of shared ones, if these differ clearly and lower the errors."""
    lens_of = _solved_lenses(model)
    members: dict[int, list[int]] = {}
    for view, lens in lens_of.items():
        members.setdefault(lens, []).append(view)
    if all(len(views) == 1 for views in members.values()):
        return model
    model = refine(model, rounds=4, rough=True)
    separate = refine(replace(model, lenses={view: view for view in model.lenses}), rounds=4, rough=True)
    log_focal = {view: np.log(camera.K[0, 0]) for view, camera in separate.cameras.items()}
    spread = max(np.ptp([log_focal[view] for view in views]) for views in members.values())
    gain = np.median(separate.error_px()[separate.use]) / np.median(model.error_px()[model.use])
    if spread > LENSES_DIFFER and gain < OWN_LENS_GAIN:
        return separate
    return model


def _retriangulated(model: Model) -> Model:
    """The model with all points triangulated again from all observations, then without outliers."""
    tracks = model.undistorted_tracks
    all_posed = posed(model.cameras, tracks)
    X = triangulate(model.cameras, tracks, all_posed, 1.0)
    filtered = _filtered(replace(model, X=X, use=all_posed))
    # again without the outliers; what fits the new points counts, whether it was an outlier of the first ones or not
    X = triangulate(model.cameras, tracks, filtered.use, 1.0)
    return _filtered(replace(model, X=X, use=all_posed))


def _filtered(model: Model) -> Model:
    """The model with only observations that fit, and points that at least two of them see at an angle."""
    tracks = model.tracks
    error = model.error_px()
    with np.errstate(invalid="ignore"):
        limit_px = min(LOOSE_PX, max(NOISES * _noise(error[model.use]), 1e-9))
        use = model.use & (error < limit_px)
    is_wide = angles(model.cameras, tracks, model.X, use) >= MIN_ANGLE
    is_seen_twice = np.bincount(tracks.track[use], minlength=tracks.count) >= 2
    is_good = is_wide & is_seen_twice
    use &= is_good[tracks.track]
    X = np.where(is_good[:, None], model.X, np.nan)
    return replace(model, X=X, use=use)


def _noise(error: Float64s) -> float:
    """Standard deviation of one coordinate, from the median of errors below `LOOSE_PX` (Rayleigh)."""
    inlier_error = error[error < LOOSE_PX]
    if not len(inlier_error):
        return LOOSE_PX
    return float(np.median(inlier_error)) / RAYLEIGH

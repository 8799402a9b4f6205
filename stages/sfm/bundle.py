"""Bundle adjustment with Ceres as COLMAP drives it (pycolmap): one thread and a fixed gauge, so that results repeat exactly."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pycolmap

from ..types import Bools, Camera, Float64s
from .rigs import first_views, rotation_between
from .tracks import Tracks

pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value  # rejected steps of Ceres are no cause for concern


def adjust(
    cameras: Mapping[int, Camera],
    tracks: Tracks,
    X: Float64s,
    use: Bools,
    *,
    held: Collection[int] = (),
    focals: Mapping[int, int] | None = None,
    positions: Mapping[int, tuple[Float64s, float]] | None = None,
    loss_px: float,
    tolerance: float,
    iterations: int = 100,
) -> tuple[dict[int, Camera], Float64s]:
    """Move cameras and points to minimise the reprojection errors of the observations in `use`.

    Parameters
    ----------
    cameras : by view number.
    tracks, X, use : observations in frame pixels, (count, 3) their points, and (n,) which observations to use; each of these
        needs a camera and a point.
    held : cameras that stay fixed.  Without any, one camera and its distance to another fix the gauge.
    focals : views whose focal length and radial distortion are solved too, each with the number of its lens: views of one lens
        share them.
    positions : known centres (3,) of views, each with its standard deviation divided by that of the pixel noise; at least
        three, or none.  The cameras must already be in world coordinates.
    loss_px : scale of the Cauchy loss.
    tolerance : stop when a step lowers the cost by no more than this share.
    iterations : largest number of steps.
    """
    focals = focals or {}
    rows = np.flatnonzero(use)
    if not len(rows):
        return dict(cameras), X.copy()  # no observation constrains anything
    # COLMAP's ids count from 1, ours from 0
    model, points = _model(cameras, tracks, X, rows, focals)
    config = pycolmap.BundleAdjustmentConfig()
    for view in cameras:
        config.add_image(view + 1)
        if view not in focals:
            config.set_constant_cam_intrinsics(view + 1)
    first = first_views(cameras)
    for frame in {first[view] for view in held}:
        config.set_constant_rig_from_world_pose(frame + 1)
    options = _options(loss_px, tolerance, iterations, bool(focals))
    if positions:
        priors = _position_priors(model, {view: prior for view, prior in positions.items() if first[view] == view})
        prior_options = pycolmap.PosePriorBundleAdjustmentOptions()
        prior_options.alignment_ransac.random_seed = 0
        solver = pycolmap.create_pose_prior_bundle_adjuster(options, prior_options, config, priors, model)
    else:
        if not held:
            config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        solver = pycolmap.create_default_bundle_adjuster(options, config, model)
    solver.solve()
    new_X = X.copy()
    new_X[points] = [model.point3D(i + 1).xyz for i in range(len(points))]
    solved = {}
    for view, camera in cameras.items():
        solved[view] = _solved_camera(model, view, camera, view in focals, view in held)
    return solved, new_X


def _model(
    cameras: Mapping[int, Camera], tracks: Tracks, X: Float64s, rows: Any, focals: Mapping[int, int]
) -> tuple[pycolmap.Reconstruction, Any]:
    """COLMAP reconstruction of the cameras and observations, and the tracks to which its points (1, 2, ...) belong.

    Pixels keep their origin: Ceres uses only differences to the principal point.  Views of one camera are one frame of a rig.
    """
    model = pycolmap.Reconstruction()
    first = first_views(cameras)
    rigs: dict[int, list[int]] = {}
    for view, first_view in first.items():
        rigs.setdefault(first_view, []).append(view)
    for views in rigs.values():
        if len(views) > 1:
            _add_rig(model, {view: cameras[view] for view in views})
    keypoint = np.zeros(len(tracks.track), np.int64)
    lenses: dict[int, int] = {}
    for view, camera in cameras.items():
        # views that share a solved lens have the COLMAP camera of the first of them
        lens = view + 1
        if view in focals:
            lens = lenses.setdefault(focals[view], view + 1)
        is_alone = len(rigs[first[view]]) == 1
        if lens == view + 1 and is_alone:
            model.add_camera_with_trivial_rig(_lens(camera, lens, view in focals))
        view_rows = rows[tracks.view[rows] == view]
        keypoint[view_rows] = np.arange(len(view_rows))
        image = pycolmap.Image(name=str(view), keypoints=tracks.xy[view_rows], camera_id=lens, image_id=view + 1)
        if is_alone:
            model.add_image_with_trivial_frame(image, _rigid(camera))
        else:
            image.frame_id = first[view] + 1
            model.add_image(image)
    # observations are sorted by track: each point's are the rows from its start to the next one's
    points, starts = np.unique(tracks.track[rows], return_index=True)
    views = (tracks.view[rows] + 1).tolist()
    keypoints = keypoint[rows].tolist()
    for point, start, end in zip(points.tolist(), starts.tolist(), [*starts.tolist()[1:], len(rows)], strict=True):
        track = pycolmap.Track()
        for k in range(start, end):
            track.add_element(views[k], keypoints[k])
        model.add_point3D(X[point], track)
    return model, points


def _add_rig(model: pycolmap.Reconstruction, cameras: Mapping[int, Camera]) -> None:
    """Add the views of one camera as the sensors of a rig with one frame, numbered after the first view."""
    first = next(iter(cameras))
    rig = pycolmap.Rig(rig_id=first + 1)
    frame = pycolmap.Frame(frame_id=first + 1, rig_id=first + 1)
    for view, camera in cameras.items():
        model.add_camera(_lens(camera, view + 1, False))
        sensor = model.camera(view + 1).sensor_id
        if view == first:
            rig.add_ref_sensor(sensor)
        else:
            turn = np.column_stack([rotation_between(cameras[first].lens, camera.lens), np.zeros(3)])
            rig.add_sensor(sensor, pycolmap.Rigid3d(turn))
        frame.add_data_id(pycolmap.data_t(sensor, view + 1))
    model.add_rig(rig)
    frame.rig_from_world = _rigid(cameras[first])
    model.add_frame(frame)
    model.register_frame(first + 1)


def _rigid(camera: Camera) -> pycolmap.Rigid3d:
    """The transform from world to camera coordinates."""
    return pycolmap.Rigid3d(np.column_stack([camera.R, -camera.R @ camera.C]))


def _lens(camera: Camera, number: int, solved: bool) -> pycolmap.Camera:
    """COLMAP camera of a view; one whose lens is solved has one focal length and two coefficients of radial distortion."""
    K = camera.K
    if solved:
        model = "RADIAL"
        params = [0.5 * (K[0, 0] + K[1, 1]), K[0, 2], K[1, 2], *camera.radial]
    else:
        model = "PINHOLE"
        params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    return pycolmap.Camera(camera_id=number, model=model, width=camera.width, height=camera.height, params=params)


def _position_priors(model: pycolmap.Reconstruction, positions: Mapping[int, tuple[Float64s, float]]) -> list[pycolmap.PosePrior]:
    """Known centres (3,) of views with their standard deviations, the same in all directions."""
    priors = []
    for view, (C, sigma) in positions.items():
        prior = pycolmap.PosePrior(
            pose_prior_id=view + 1,
            corr_data_id=model.image(view + 1).data_id,
            position=C,
            position_covariance=sigma**2 * np.eye(3),
            coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
        )
        priors.append(prior)
    return priors


def _options(loss_px: float, tolerance: float, iterations: int, refine_focal: bool) -> pycolmap.BundleAdjustmentOptions:
    """Settings of Ceres: one thread, since sums in another order differ in the last bits."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_sensor_from_rig = False
    options.print_summary = False
    options.refine_focal_length = refine_focal
    options.refine_principal_point = False
    options.refine_extra_params = refine_focal
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = loss_px
    solver = options.ceres.solver_options
    solver.num_threads = 1
    solver.max_num_iterations = iterations
    solver.function_tolerance = tolerance
    solver.gradient_tolerance = 1e-10
    solver.parameter_tolerance = 1e-12
    return options


def _solved_camera(model: pycolmap.Reconstruction, view: int, camera: Camera, solved: bool, fixed: bool) -> Camera:
    """The camera after adjustment; solved: with its lens; fixed: with the pose that it had, to the last bit."""
    image = model.image(view + 1)
    if solved:
        f, _, _, k1, k2 = model.camera(image.camera_id).params
        K = camera.K.copy()
        K[0, 0] = K[1, 1] = f
        camera = replace(camera, K=K, radial=(float(k1), float(k2)))
    if fixed:
        return camera
    pose = image.cam_from_world()
    R = np.asarray(pose.rotation.matrix(), dtype=np.float64)
    return replace(camera, R=R, C=-R.T @ pose.translation)

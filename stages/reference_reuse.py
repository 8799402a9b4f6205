"""Geometry taken over from the reference instead of estimated again, corrected for cameras that have turned or moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .contracts.defaults import EPIPOLAR_ERROR_PX, RAY_ANGLE_DEG, ROTATION_ERROR_DEG
from .contracts.reasons import Reason, Rejected
from .core.cameras import same_camera
from .poses import solve_poses, stated_calibration
from .sfm.rigs import rotation_between
from .types import Bools, Camera, CameraHealth, Float64s, Geometry, Pair, Placement, Poses, Survey, View, at_rows

_IDENTITY: Float64s = np.eye(3)


def turn_geometry(pinned: Geometry | None, left: CameraHealth, right: CameraHealth) -> Geometry | Rejected:
    """The reference's geometry of a pair, corrected for cameras that have turned: a turn moves all pixels by a homography.

    A camera that is not `corrected` counts as unmoved.

    References: Hartley & Zisserman (2004), section 8.4: a camera that turns about its centre; F' = H2^-T F H1^-1.
    """
    if pinned is None:
        return Rejected(Reason.NOTHING_KNOWN)
    H1, R1 = _motion(left)
    H2, R2 = _motion(right)
    # Matches that a turn has moved out of either picture are dropped.
    x1, inside1 = _mapped(pinned.x1, H1, pinned.view1)
    x2, inside2 = _mapped(pinned.x2, H2, pinned.view2)
    keep = inside1 & inside2
    F = np.linalg.inv(H2).T @ pinned.F @ np.linalg.inv(H1)
    R = pinned.cam2_R_cam1
    if R is not None:
        R = R2 @ R @ R1.T
    t = pinned.cam2_t_cam1
    if t is not None:
        t = R2 @ t
    return replace(
        at_rows(replace(pinned, x1=x1, x2=x2), keep),
        F=F / np.linalg.norm(F),
        i1=None,
        i2=None,
        cam2_R_cam1=R,
        cam2_t_cam1=t,
        inliers=int(keep.sum()),
    )


def hold_poses(
    pinned: Poses | None,
    healths: Mapping[str, CameraHealth],
    views: Mapping[str, View],
    geometries: Mapping[Pair, Geometry],
    survey: Survey | None = None,
    *,
    max_rotation_error_deg: float = ROTATION_ERROR_DEG,
    max_epipolar_px: float = EPIPOLAR_ERROR_PX,
    min_angle_deg: float = RAY_ANGLE_DEG,
) -> Poses | Rejected:
    """The cameras of the reference: those that have turned are corrected, those that were moved or are new are solved.

    If no camera has to be solved, matches and calibration check are the reference's; otherwise the check is repeated.

    Parameters
    ----------
    pinned : the reference's poses.
    healths : states of the cameras, without those that show nothing of the site.
    views : the pinholes of tonight's frames.
    geometries : two-view geometries of the pairs; moved and new cameras are solved from those that contain them.
    survey : known distances and control points.
    max_rotation_error_deg, max_epipolar_px, min_angle_deg : see the stage `poses`.
    """
    if pinned is None:
        return Rejected(Reason.NOTHING_KNOWN)
    # 1. Cameras that have not been moved keep the pose of the reference, or that pose and their turn.
    healths = _with_shared_turns(healths, views)
    free = [name for name, health in healths.items() if _is_moved(health) or name not in pinned.cameras]
    held = _without(free, pinned, healths)
    if not free:
        return held

    # 2. The calibration is checked again: those that were moved must not contradict the others.
    stated = {}
    for name, camera in pinned.cameras.items():
        if name in views and pinned.sources.get(name) in {"stated", "refined", "observed"}:
            stated[name] = camera
    unmoved = {name: held.cameras[name] for name in stated if name in held.cameras}
    held = replace(held, calibration=stated_calibration(stated, unmoved, geometries))

    # 3. Solve the free cameras from their pairs, with the held ones in place and all lenses as in the reference.
    usable = {*held.cameras, *free}
    relevant = {}
    for pair, geometry in geometries.items():
        if set(pair) & set(free) and set(pair) <= usable:
            relevant[pair] = geometry
    if not relevant:
        return _with_solved(held, Rejected(Reason.NO_POSED_CAMERA), free)
    fixed = {name: camera for name, camera in held.main_cameras().items() if name in views}
    solver_views = {name: view for name, view in views.items() if name in fixed or name in free}
    for name in solver_views.keys() & pinned.cameras.keys():
        solver_views[name] = replace(solver_views[name], K=pinned.cameras[name].K, focal_known=True)
    placements = {name: Placement(camera.R, camera.C, metric=pinned.metric) for name, camera in fixed.items()}
    poses = solve_poses(
        solver_views,
        placements,
        relevant,
        survey,
        max_rotation_error_deg=max_rotation_error_deg,
        max_epipolar_px=max_epipolar_px,
        min_angle_deg=min_angle_deg,
    )
    return _with_solved(held, poses, free)


def _without(free: list[str], pinned: Poses, healths: Mapping[str, CameraHealth]) -> Poses:
    """The poses of the reference without the free cameras, and with the turns of those that have turned."""
    cameras = {}
    sources = {}
    turned = []
    for name, camera in pinned.cameras.items():
        if name in free:
            continue
        cameras[name] = _turned(camera, healths.get(name))
        if name in healths and healths[name].corrected:
            turned.append(name)
    for name, source in pinned.sources.items():
        if name in cameras:
            sources[name] = "corrected" if name in turned else source
    moved = [name for name in free if name in pinned.cameras]
    notes = [f"{name}: {healths[name].text}" for name in (*turned, *moved)]
    return replace(pinned, cameras=cameras, sources=sources, notes=(*notes, *pinned.notes))


def _with_shared_turns(healths: Mapping[str, CameraHealth], views: Mapping[str, View]) -> dict[str, CameraHealth]:
    """The healths, but with the same turn for all views of one camera: that of the view with the most patches found again."""
    usable = {}
    for name, health in healths.items():
        if name in views and health.state not in {"obscured", "wrong-scene"}:
            usable[name] = health

    def evidence(name: str) -> tuple[bool, float | str]:
        """Views that noticed a motion come first, then those with more patches."""
        health = usable[name]
        noticed = health.corrected or _is_moved(health)
        return noticed, health.figures.get("patches", 0.0)

    shared = dict(healths)
    for name in usable:
        views_of_camera = [other for other in usable if same_camera(views[name], views[other])]
        best = max(views_of_camera, key=evidence, default=name)
        if best == name:
            continue
        # The turn is about the axes of the best view: it is carried over to those of this one.
        turn = usable[best].turn
        if turn is not None:
            to_own = rotation_between(views[best].lens, views[name].lens)
            turn = to_own @ turn @ to_own.T
        shared[name] = replace(usable[best], turn=turn, homography=usable[name].homography)
    return shared


def _with_solved(held: Poses, poses: Poses | Rejected, free: list[str]) -> Poses:
    """The held cameras, and those of the free ones that could be solved in the same world."""
    # What the reference says about the free cameras no longer holds.
    checks = {}
    for pair_name, check in held.pair_checks.items():
        if not _concerns(pair_name, free):
            checks[pair_name] = check
    other_reasons = {name: reason for name, reason in held.unsolved.items() if name not in free}
    components = []
    for group in held.components or ((),):
        components.append(tuple(name for name in group if name not in free))
    if isinstance(poses, Rejected):
        reasons = dict.fromkeys(free, f"moved, and not solved: {poses.reason}")
        return replace(held, pair_checks=checks, unsolved=other_reasons | reasons, components=tuple(components))

    solved = {}
    reasons = {}
    for name in free:
        if name in poses.cameras and poses.cameras[name].component == 0:
            solved[name] = poses.cameras[name]
        else:
            why = poses.unsolved.get(name, "its pairs do not connect it with the others")
            reasons[name] = f"moved, and not solved: {why}"
    for pair_name, check in poses.pair_checks.items():
        if _concerns(pair_name, free):
            checks[pair_name] = check
    return replace(
        held,
        cameras={**held.cameras, **solved},
        unsolved=other_reasons | reasons,
        pair_checks=checks,
        components=((*components[0], *solved), *components[1:]),
        sources={**held.sources, **dict.fromkeys(solved, "solved")},
        source="mixed",
        points=poses.points,
        reprojection_px=poses.reprojection_px,
    )


def _concerns(pair_name: str, names: list[str]) -> bool:
    """Does a pair, named `left--right`, contain one of the cameras?"""
    return not set(pair_name.split("--")).isdisjoint(names)


def _motion(health: CameraHealth) -> tuple[Float64s, Float64s]:
    """Homography from old to new pixels, and rotation from old to new axes; identities if the camera has not turned."""
    if not health.corrected or health.homography is None or health.turn is None:
        return _IDENTITY, _IDENTITY
    return health.homography, health.turn


def _turned(camera: Camera, health: CameraHealth | None) -> Camera:
    """The camera with the turn of its health, if that is to be corrected."""
    if health is None or not health.corrected or health.turn is None:
        return camera
    return replace(camera, R=health.turn @ camera.R)


def _is_moved(health: CameraHealth) -> bool:
    """Was the camera moved in a way that no turn corrects, so that it has to be solved?"""
    return health.state == "moved" and not health.corrected


def _mapped(points: Float64s, H: Float64s, view: View) -> tuple[Float64s, Bools]:
    """Points (n, 2) mapped by a homography, and whether they are still in the picture."""
    if H is _IDENTITY:  # points of a camera that has not turned keep their bits
        return points, np.ones(len(points), dtype=bool)
    mapped = np.column_stack([points, np.ones(len(points))]) @ H.T
    mapped = mapped[:, :2] / mapped[:, 2:]
    # Centres of pixels have integer coordinates: the picture ends half a pixel beyond them.
    inside = (mapped >= -0.5).all(axis=1) & (mapped < [view.width - 0.5, view.height - 0.5]).all(axis=1)
    return mapped, np.asarray(inside)

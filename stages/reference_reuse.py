"""Geometry taken over from the reference instead of estimated again, corrected for cameras that have turned or moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

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
    (H1, R1), (H2, R2) = _motion(left), _motion(right)
    x1, inside1 = _mapped(pinned.x1, H1, pinned.view1)
    x2, inside2 = _mapped(pinned.x2, H2, pinned.view2)
    keep = inside1 & inside2
    F = np.linalg.inv(H2).T @ pinned.F @ np.linalg.inv(H1)
    R, t = pinned.cam2_R_cam1, pinned.cam2_t_cam1
    return replace(
        at_rows(replace(pinned, x1=x1, x2=x2), keep),
        F=F / np.linalg.norm(F),
        i1=None,
        i2=None,
        cam2_R_cam1=None if R is None else R2 @ R @ R1.T,
        cam2_t_cam1=None if t is None else R2 @ t,
        inliers=int(keep.sum()),
    )


def hold_poses(
    pinned: Poses | None,
    healths: Mapping[str, CameraHealth],
    views: Mapping[str, View],
    geometries: Mapping[Pair, Geometry],
    survey: Survey | None = None,
    *,
    max_rotation_error_deg: float = 4.0,
    max_epipolar_px: float = 2.0,
    min_angle_deg: float = 0.7,
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
    healths = _with_shared_turns(healths, views)
    free = [n for n, health in healths.items() if _is_free(health) or n not in pinned.cameras]  # cameras to solve
    held = _without(free, pinned, healths)
    if not free:
        return held
    stated = {n: camera for n, camera in pinned.cameras.items() if n in views and pinned.sources.get(n) in {"stated", "refined"}}
    unmoved = {n: held.cameras[n] for n in stated if n in held.cameras}
    held = replace(held, calibration=stated_calibration(stated, unmoved, geometries))
    relevant = {pair: g for pair, g in geometries.items() if set(pair) & set(free) and set(pair) <= {*held.cameras, *free}}
    if not relevant:
        return _with_solved(held, Rejected(Reason.NO_POSED_CAMERA), free)
    fixed = {n: camera for n, camera in held.main_cameras().items() if n in views}
    solver_views = {n: view for n, view in views.items() if n in fixed or n in free}
    for name in solver_views.keys() & pinned.cameras.keys():
        solver_views[name] = replace(solver_views[name], K=pinned.cameras[name].K, focal_known=True)
    poses = solve_poses(
        solver_views,
        {n: Placement(camera.R, camera.C, metric=pinned.metric) for n, camera in fixed.items()},
        relevant,
        survey,
        max_rotation_error_deg=max_rotation_error_deg,
        max_epipolar_px=max_epipolar_px,
        min_angle_deg=min_angle_deg,
    )
    return _with_solved(held, poses, free)


def _without(free: list[str], pinned: Poses, healths: Mapping[str, CameraHealth]) -> Poses:
    """The poses of the reference without the free cameras, and with the turns of those that have turned."""
    cameras = {n: _turned(camera, healths.get(n)) for n, camera in pinned.cameras.items() if n not in free}
    turned = [n for n in cameras if n in healths and healths[n].corrected]
    sources = {n: "corrected" if n in turned else source for n, source in pinned.sources.items() if n in cameras}
    notes = [f"{name}: {healths[name].text}" for name in (*turned, *(n for n in free if n in pinned.cameras))]
    return replace(pinned, cameras=cameras, sources=sources, notes=(*notes, *pinned.notes))


def _with_shared_turns(healths: Mapping[str, CameraHealth], views: Mapping[str, View]) -> dict[str, CameraHealth]:
    """The healths, but with the same turn for all views of one camera: that of the view with the most patches found again."""
    usable = {n: health for n, health in healths.items() if n in views and health.state not in {"obscured", "wrong-scene"}}

    def evidence(name: str) -> tuple[bool, float | str]:
        return usable[name].corrected or _is_free(usable[name]), usable[name].figures.get("patches", 0.0)

    shared = dict(healths)
    for name in usable:
        best = max((n for n in usable if same_camera(views[name], views[n])), key=evidence, default=name)
        if best != name:
            to_own, turn = rotation_between(views[best].lens, views[name].lens), usable[best].turn
            turned = None if turn is None else to_own @ turn @ to_own.T
            shared[name] = replace(usable[best], turn=turned, homography=usable[name].homography)
    return shared


def _with_solved(held: Poses, poses: Poses | Rejected, free: list[str]) -> Poses:
    """The held cameras, and those of the free ones that could be solved in the same world."""
    checks = {name: check for name, check in held.pair_checks.items() if not set(name.split("--")) & set(free)}
    other_reasons = {name: reason for name, reason in held.unsolved.items() if name not in free}
    components = tuple(tuple(n for n in group if n not in free) for group in held.components) or ((),)
    if isinstance(poses, Rejected):
        reasons = dict.fromkeys(free, f"moved, and not solved: {poses.reason}")
        return replace(held, pair_checks=checks, unsolved=other_reasons | reasons, components=components)
    solved = {name: poses.cameras[name] for name in free if name in poses.cameras and poses.cameras[name].component == 0}
    unconnected = "its pairs do not connect it with the others"
    reasons = {n: f"moved, and not solved: {poses.unsolved.get(n, unconnected)}" for n in free if n not in solved}
    return replace(
        held,
        cameras={**held.cameras, **solved},
        unsolved=other_reasons | reasons,
        pair_checks={**checks, **{name: check for name, check in poses.pair_checks.items() if set(name.split("--")) & set(free)}},
        components=((*components[0], *solved), *components[1:]),
        sources={**held.sources, **dict.fromkeys(solved, "solved")},
        source="mixed",
        points=poses.points,
        reprojection_px=poses.reprojection_px,
    )


def _motion(health: CameraHealth) -> tuple[Float64s, Float64s]:
    """Homography from old to new pixels, and rotation from old to new axes; identities if the camera has not turned."""
    if not health.corrected or health.homography is None or health.turn is None:
        return _IDENTITY, _IDENTITY
    return health.homography, health.turn


def _turned(camera: Camera, health: CameraHealth | None) -> Camera:
    return camera if health is None or not health.corrected or health.turn is None else replace(camera, R=health.turn @ camera.R)


def _is_free(health: CameraHealth) -> bool:
    return health.state == "moved" and not health.corrected


def _mapped(points: Float64s, H: Float64s, view: View) -> tuple[Float64s, Bools]:
    """Points (n, 2) mapped by a homography, and whether they are still in the picture."""
    if H is _IDENTITY:
        return points, np.ones(len(points), dtype=bool)
    mapped = np.column_stack([points, np.ones(len(points))]) @ H.T
    mapped = mapped[:, :2] / mapped[:, 2:]
    return mapped, np.asarray((mapped >= -0.5).all(axis=1) & (mapped < [view.width - 0.5, view.height - 0.5]).all(axis=1))

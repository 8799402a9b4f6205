"""Geometry taken over from the reference instead of estimated again, corrected for cameras that have turned or moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .core.cameras import same_camera
from .poses import solve_poses, stated_calibration
from .reasons import Reason, Rejected
from .types import Bools, Camera, CameraHealth, Float64s, Geometry, Pair, Placement, Poses, Survey, View, at_rows

_ITSELF: Float64s = np.eye(3)


def turn_geometry(pinned: Geometry | None, left: CameraHealth, right: CameraHealth) -> Geometry | Rejected:
    """The reference's geometry of a pair, corrected for cameras that have turned: a turn moves all pixels by a homography.

    A camera that is not `corrected` counts as unmoved.

    References: Hartley & Zisserman (2004), section 8.4: a camera that turns about its centre; F' = H2^-T F H1^-1.
    """
    if pinned is None:
        return Rejected(Reason.NOTHING_KNOWN)
    (H1, R1), (H2, R2) = _motion(left), _motion(right)
    x1, inside1 = _moved(pinned.x1, H1, pinned.view1)
    x2, inside2 = _moved(pinned.x2, H2, pinned.view2)
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

    If none has to be solved, the matches are the reference's, and so is the calibration check; otherwise it is repeated.

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
    healths = _shared(healths, views)
    lost = [n for n, health in healths.items() if _lost(health) or n not in pinned.cameras]
    cameras = {n: _turned(camera, healths.get(n)) for n, camera in pinned.cameras.items() if n not in lost}
    turned = [n for n in cameras if n in healths and healths[n].corrected]
    sources = {n: "corrected" if n in turned else source for n, source in pinned.sources.items() if n in cameras}
    notes = tuple(f"{name}: {healths[name].text}" for name in (*turned, *(n for n in lost if n in pinned.cameras)))
    held = replace(pinned, cameras=cameras, sources=sources, notes=(*notes, *pinned.notes))
    if not lost:
        return held
    around = {pair: g for pair, g in geometries.items() if set(pair) & set(lost) and set(pair) <= {*cameras, *lost}}
    stated = {n: camera for n, camera in pinned.cameras.items() if n in views and pinned.sources.get(n) in {"stated", "refined"}}
    still = {n: cameras[n] for n in stated if n in cameras}
    held = replace(held, calibration=stated_calibration(stated, still, {*stated} - {*still}, geometries))
    known = {n: replace(view, K=pinned.cameras[n].K, focal_known=True) for n, view in views.items() if n in pinned.cameras}
    main = {n: camera for n, camera in cameras.items() if camera.component == 0 and n in views}
    placements = {n: Placement(camera.R, camera.C, metric=pinned.metric) for n, camera in main.items()}
    asked = {n: known.get(n, view) for n, view in views.items() if n in main or n in lost}
    if not around:
        return _with_solved(held, Rejected(Reason.NO_POSED_CAMERA), lost)
    found = solve_poses(
        asked,
        placements,
        around,
        survey,
        max_rotation_error_deg=max_rotation_error_deg,
        max_epipolar_px=max_epipolar_px,
        min_angle_deg=min_angle_deg,
    )
    return _with_solved(held, found, lost)


def _shared(healths: Mapping[str, CameraHealth], views: Mapping[str, View]) -> dict[str, CameraHealth]:
    """The healths, but with the same turn for all views of one camera: that of the view with the most patches found again."""
    found = dict(healths)
    usable = {n: health for n, health in healths.items() if n in views and health.state not in {"obscured", "wrong-scene"}}
    for name in usable:
        own = views[name].lens
        alike = [n for n in usable if same_camera(views[name], views[n])]
        best = max(
            alike, key=lambda n: (usable[n].corrected or _lost(usable[n]), usable[n].figures.get("patches", 0.0)), default=name
        )
        theirs, turn = views[best].lens, usable[best].turn
        if best != name and own and theirs and own.turn is not None and theirs.turn is not None:
            to_own = own.turn @ theirs.turn.T
            turned = None if turn is None else to_own @ turn @ to_own.T
            found[name] = replace(usable[best], turn=turned, homography=usable[name].homography)
    return found


def _with_solved(held: Poses, found: Poses | Rejected, lost: list[str]) -> Poses:
    """The held cameras, and those of the lost ones that could be solved in the same world."""
    theirs = {name: check for name, check in held.pair_checks.items() if not set(name.split("--")) & set(lost)}
    others = {name: reason for name, reason in held.unsolved.items() if name not in lost}
    components = tuple(tuple(n for n in group if n not in lost) for group in held.components) or ((),)
    if isinstance(found, Rejected):
        why = dict.fromkeys(lost, f"moved, and not solved: {found.reason}")
        return replace(held, pair_checks=theirs, unsolved=others | why, components=components)
    solved = {name: found.cameras[name] for name in lost if name in found.cameras and found.cameras[name].component == 0}
    unsolved = {n: f"moved, and not solved: {found.unsolved.get(n, 'its pairs do not connect it with the others')}" for n in lost}
    return replace(
        held,
        cameras={**held.cameras, **solved},
        unsolved=others | {name: why for name, why in unsolved.items() if name not in solved},
        pair_checks={**theirs, **{name: check for name, check in found.pair_checks.items() if set(name.split("--")) & set(lost)}},
        components=((*components[0], *solved), *components[1:]),
        sources={**held.sources, **dict.fromkeys(solved, "solved")},
        source="mixed",
        points=found.points,
        reprojection_px=found.reprojection_px,
    )


def _motion(health: CameraHealth) -> tuple[Float64s, Float64s]:
    """Homography from old to new pixels, and rotation from old to new axes; identities if the camera has not turned."""
    if not health.corrected or health.homography is None or health.turn is None:
        return _ITSELF, _ITSELF
    return health.homography, health.turn


def _turned(camera: Camera, health: CameraHealth | None) -> Camera:
    return camera if health is None or not health.corrected or health.turn is None else replace(camera, R=health.turn @ camera.R)


def _lost(health: CameraHealth) -> bool:
    return health.state == "moved" and not health.corrected


def _moved(points: Float64s, H: Float64s, view: View) -> tuple[Float64s, Bools]:
    """Points (n, 2) mapped by a homography, and whether they are still in the picture."""
    if H is _ITSELF:
        return points, np.ones(len(points), dtype=bool)
    at = np.column_stack([points, np.ones(len(points))]) @ H.T
    at = at[:, :2] / at[:, 2:]
    return at, np.asarray((at >= -0.5).all(axis=1) & (at < [view.width - 0.5, view.height - 0.5]).all(axis=1))

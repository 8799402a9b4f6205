"""Where the cameras are: taken from the calibration, solved from the pairs' geometries, or both at once.

Solved: rotations of all pairs are compared and contradictions dropped; what is left is grown into models view by view, with
bundle adjustment; each model is put into the world by whatever is known of it.  Known poses then stay where they are, unless the
images contradict them (`known_poses`): a wrong one is named, with how far it seems off, and solved like an unknown one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .core.cameras import camera_of
from .core.rotations import angle_between_deg
from .reasons import Reason, Rejected
from .sfm.pose_check import PAIR_PX, TURNED_DEG, check_cameras, contradicted, epipolar_error_px, evidence_on, turned_deg
from .types import Camera, Geometry, Pair, PairCheck, Placement, PoseCheck, Poses, Survey, View

MOST_NAMES = 6
"""A sentence lists so many cameras at most."""


def solve_poses(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    geometries: Mapping[Pair, Geometry],
    survey: Survey | None = None,
    *,
    max_rotation_error_deg: float = 4.0,
    max_epipolar_px: float = 2.0,
) -> Poses | Rejected:
    """Put the cameras into one world.

    Parameters
    ----------
    views
        The pinhole of each camera's frame, at working resolution.
    placements
        R and C as the site states them, where it does.
    geometries
        Two-view geometry of the pairs.  Where all poses and intrinsics are stated, they check these.
    survey
        Known distances and control points.
    max_rotation_error_deg
        A pair whose relative rotation is farther than this from what the other pairs agree on is dropped, in degrees.
    max_epipolar_px
        So is a pair whose inliers lie farther than this from the epipolar lines of the solved cameras (median), in pixels.

    Returns
    -------
    Poses, or Rejected where not even two cameras can be placed.
    """
    if len(views) < 2:
        return Rejected(Reason.ONE_CAMERA, {"cameras": len(views)})
    survey = survey or Survey()
    stated = stated_cameras(views, placements)
    exact = {name: camera for name, camera in stated.items() if placements[name].sigma_m == 0}
    if not geometries:
        return _as_stated(views, placements, stated, survey)
    seen = {pair: geometry for pair, geometry in geometries.items() if set(pair) <= set(exact)}
    wrong, unclear = _check(exact, seen)
    checks = check_cameras({name: camera for name, camera in exact.items() if name not in wrong}, seen)
    notes = (_doubt(unclear, exact, seen),) if unclear else ()
    if len(exact) == len(views) and not wrong:
        found = _as_stated(views, placements, stated, survey)
        if isinstance(found, Rejected):
            return found
        return replace(found, verdicts=_fit(found.cameras, seen), checks=checks, notes=notes)
    # here, so that a night whose poses are all known and right does not wait for what solves poses
    from .sfm.solve import solve_from_pairs

    believed = {name: placement for name, placement in placements.items() if name not in wrong}
    trusted = {name: camera for name, camera in stated.items() if name not in wrong}
    found = solve_from_pairs(views, believed, geometries, survey, trusted, max_rotation_error_deg, max_epipolar_px)
    if isinstance(found, Rejected) and len(trusted) >= 2:
        found = _as_stated(views, believed, trusted, survey)
    if isinstance(found, Rejected):
        return found
    moved = {name: _moved(exact[name], found.cameras.get(name), name, seen) for name in wrong}
    suspects = {name: _suspicion(name, check, found.metric) for name, check in moved.items()}
    return replace(
        found,
        checks=checks | moved,
        suspects={**suspects, **found.suspects},
        notes=(*suspects.values(), *(() if set(unclear) & set(found.suspects) else notes), *found.notes),
    )


def _check(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> tuple[list[str], list[str]]:
    """Cameras whose known poses are wrong, and those among which there is another wrong one."""
    wrong, unclear = contradicted(evidence_on(cameras, geometries))
    if 2 * len(wrong + unclear) >= len(cameras):  # no single camera has moved: the calibration as a whole does not fit
        return [], wrong + unclear
    return wrong, unclear


def _fit(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> dict[str, PairCheck]:
    """How known poses fit each pair; whether it can be used, rectification decides."""
    found = {}
    for pair, geometry in geometries.items():
        error = epipolar_error_px(cameras, pair, geometry)
        reason = f"the known poses leave an epipolar error of {error:.2f} px" if error > PAIR_PX else ""
        turned = turned_deg(cameras, pair, geometry)
        found["--".join(pair)] = PairCheck(True, reason, "", geometry.epipolar_px, error, turned, bool(reason))
    return found


def _moved(stated: Camera, solved: Camera | None, name: str, geometries: Mapping[Pair, Geometry]) -> PoseCheck:
    """A camera that is not where it is said to be, and by how much."""
    mine = {pair: geometry for pair, geometry in geometries.items() if name in pair}
    inliers = sum(geometry.inliers for geometry in mine.values())
    if solved is None or solved.component != 0:
        return PoseCheck(len(mine), inliers, float("nan"), True)
    length = float(np.linalg.norm(solved.C - stated.C))
    return PoseCheck(len(mine), inliers, float("nan"), True, length, angle_between_deg(solved.R, stated.R))


def _suspicion(name: str, check: PoseCheck, metric: bool) -> str:
    what = f"the known pose of {name} contradicts the images"
    if np.isnan(check.off_m):
        return f"{what}; by how much cannot be told: it is left out. Has it been moved?"
    length = f"{check.off_m:.3f} {'m' if metric else 'units'}"
    return f"{what}: it seems off by {length} and {check.off_deg:.2f} degrees; solved anew from the others. Has it been moved?"


def _doubt(names: list[str], cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> str:
    """What is known of poses of which some are wrong, and what would tell which."""
    pairs = {pair: geometry for pair, geometry in geometries.items() if set(pair) <= set(names)}
    most = max((turned_deg(cameras, pair, geometry) for pair, geometry in pairs.items()), default=float("nan"))
    by = f" by {most:.1f} degrees" if most > TURNED_DEG else ""
    what = f"the known poses of {_listed(names)} contradict each other{by}: which is wrong cannot be told."
    if len(names) == len(cameras) > 2:
        return f"{what} Is this the calibration of these captures?"
    return f"{what} Leave out the pose of the camera that was moved, and it is solved; or add a camera that sees what both see."


def _listed(names: list[str]) -> str:
    if len(names) > MOST_NAMES:
        names = [*names[: MOST_NAMES - 1], f"{len(names) - MOST_NAMES + 1} more"]
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


def stated_cameras(views: Mapping[str, View], placements: Mapping[str, Placement]) -> dict[str, Camera]:
    """The cameras whose intrinsics and pose are both known."""
    found = {}
    for name, view in views.items():
        stated = placements.get(name, Placement())
        if view.K is not None and view.focal_known and stated.R is not None and stated.C is not None:
            found[name] = camera_of(view, view.K, stated.R, stated.C)
    return found


def _as_stated(
    views: Mapping[str, View], placements: Mapping[str, Placement], stated: dict[str, Camera], survey: Survey
) -> Poses | Rejected:
    """No image has a say."""
    unsolved = {}
    for name, view in views.items():
        if name not in stated:
            lacks_lens = view.K is None or not view.focal_known
            unsolved[name] = ("no intrinsics" if lacks_lens else "no pose") + " given, and no pair to solve it from"
    if not stated:
        return Rejected(Reason.NO_POSED_CAMERA, {"cameras": len(views)})
    metric = all(placements[name].metric for name in stated)
    scale = "calibration" if metric else "calibration, not metric"
    return Poses(stated, unsolved, {}, metric, "calibration", components=(tuple(stated),), scale=scale, crs=survey.crs)

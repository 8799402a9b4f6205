"""Where the cameras are: taken from the calibration, solved from the pairs' geometries, or both at once.

To solve poses, rotations of all pairs are compared and contradictory pairs dropped; the others grow into models view by view,
with bundle adjustment; each model is placed in the world by whatever is known of it.  A known pose is evidence with a standard
deviation: it is kept, or adjusted within that, or within usual survey errors if none is stated.  A pose is wrong only if
several partners agree on another one (`orientation.moved_cameras`): a finding then names the camera and its apparent
displacement, and it is solved like an unknown one.  If only one pair contradicts a pose, it stays in use, unverified.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from .core.cameras import camera_of
from .core.luminance import grey_levels
from .core.rotations import angle_between_deg
from .orientation.calibration_check import check_calibration
from .orientation.moved_cameras import NewPose, find_moved_cameras
from .orientation.pose_check import (
    PAIR_PX,
    TURNED_DEG,
    Evidence,
    PoseConstraints,
    Sigma,
    check_cameras,
    confirmed,
    epipolar_error_px,
    turned_deg,
    without_baseline,
)
from .orientation.pose_prior_adjustment import AdjustedPoses, adjust_within_priors
from .orientation.survey_check import check_survey
from .orientation.usual_errors import correct_usual_errors
from .reasons import Reason, Rejected
from .rectification.predicted import predict
from .sfm.rigs import posed_by_sibling
from .types import (
    CalibrationCheck,
    Camera,
    Frame,
    Geometry,
    Pair,
    PairCheck,
    Placement,
    PoseCheck,
    PoseIssue,
    Poses,
    Survey,
    View,
)

MOST_NAMES = 6
"""Most cameras that a message lists."""
MOST_ROW_SIGMA_PX = 1.0
"""Largest standard deviation of the rows in pixels: dense matching tolerates partners up to about a pixel off the row."""


def solve_poses(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    geometries: Mapping[Pair, Geometry],
    survey: Survey | None = None,
    frames_if_rough: Mapping[str, Frame] | None = None,
    *,
    max_rotation_error_deg: float = 4.0,
    max_epipolar_px: float = 2.0,
    min_angle_deg: float = 0.7,
) -> Poses | Rejected:
    """Put the cameras into one world.

    Returns `Rejected` if not even two cameras can be placed.

    Parameters
    ----------
    views : the pinhole of each camera's frame, at working resolution.
    placements : R and C as the site states them, if it does.  If none has standard deviations, they are kept if the matches
        fit them, and otherwise adjusted within usual survey errors.
    geometries : two-view geometries of the pairs.  If all poses and intrinsics are stated, they check these.
    survey : known distances and control points.
    frames_if_rough : the frames, used if keypoints determine poses no better than their stated standard deviations.
    max_rotation_error_deg : drop a pair if its relative rotation is off by more than this from what the others agree on, degrees.
    max_epipolar_px : drop a pair if its inliers are off the solved cameras' epipolar lines by more than this, pixels (median).
    min_angle_deg : reject if the rays of the matches converge by less than this (median) in all pairs, in degrees: cameras at
        one place, seen from the scene, give no depth.
    """
    if len(views) < 2:
        return Rejected(Reason.ONE_CAMERA, {"cameras": len(views)})
    survey = survey or Survey()
    stated = stated_cameras(views, placements)
    if not geometries:
        return _as_stated(views, placements, stated, survey)
    sigmas = {name: Sigma(placements[name].sigma_m, placements[name].sigma_deg) for name in stated}
    known = {name: camera for name, camera in stated.items() if sigmas[name].exact or sigmas[name].degrees > 0}
    known_pairs = {pair: geometry for pair, geometry in geometries.items() if set(pair) <= set(known)}
    exact = all(sigmas[name].exact for name in known)
    corrected, calibration = correct_usual_errors(known, geometries) if exact else (known, None)
    adjusted, moved = _adjusted_and_moved(corrected, sigmas, known_pairs, frames_if_rough or {})
    cameras = adjusted.cameras
    if rejected := without_baseline(views, cameras, geometries, min_angle_deg, all(placements[n].metric for n in cameras)):
        return rejected
    evidence = PoseConstraints.of(tuple(cameras), known_pairs).evidence(cameras)
    held_placements = {name: replace(placements[name], R=c.R, C=c.C, sigma_m=0.0, sigma_deg=0.0) for name, c in cameras.items()}
    accepted = {name: placement for name, placement in placements.items() if name not in moved} | held_placements
    trusted = {name: camera for name, camera in stated.items() if name not in moved} | cameras
    if moved or not exact:
        calibration = stated_calibration(corrected, cameras, set(moved), geometries)
    geometries = {**geometries, **{pair: confirmed(geometries[pair]) for new in moved.values() for pair in new.pairs}}
    if len(trusted) == len(views) and all(accepted[name].sigma_m == 0 for name in trusted):
        poses = _as_stated(views, accepted, trusted, survey)
    else:  # imported here, so that a night whose poses are all known and right does not wait for the solver
        from .orientation.solve import solve_from_pairs

        poses = solve_from_pairs(views, accepted, geometries, survey, trusted, max_rotation_error_deg, max_epipolar_px)
        if isinstance(poses, Rejected) and len(trusted) >= 2:
            poses = _as_stated(views, accepted, trusted, survey, poses.reason)
    if isinstance(poses, Rejected):
        return poses
    uncertain = (PoseIssue("uncertain", name, row_px=px) for name, px in _uncertain(adjusted, geometries).items())
    poses = replace(poses, issues=(*poses.issues, *uncertain), calibration=calibration)
    poses = check_survey(poses, views, placements, survey)
    return _checked(poses, (known, cameras, trusted), moved, known_pairs, evidence, max_epipolar_px)


def stated_calibration(
    known: Mapping[str, Camera],
    cameras: Mapping[str, Camera],
    moved: set[str],
    geometries: Mapping[Pair, Geometry],
) -> CalibrationCheck | None:
    """Check the stated calibration as a whole; a contradiction that moved cameras explain is not blamed on the others.

    Parameters
    ----------
    known, cameras : cameras as stated, and as adjusted within their standard deviations, without those that were moved.
    moved : ids of the cameras that were moved.
    geometries : of all pairs.
    """
    check = check_calibration({**known, **cameras}, geometries)
    if moved and check is not None and check.contradicted and check.cause in ("", "turned", "moved", "poses"):
        return check_calibration(cameras, geometries)
    return check


def _checked(
    poses: Poses,
    camera_sets: tuple[Mapping[str, Camera], Mapping[str, Camera], Mapping[str, Camera]],
    moved: Mapping[str, NewPose],
    pairs: Mapping[Pair, Geometry],
    evidence: list[Evidence],
    max_epipolar_px: float,
) -> Poses:
    """The poses found, with the checks of known poses against the images.

    camera_sets: known cameras as stated; those that have not moved, as adjusted; and these plus cameras that nothing checks.
    pairs, evidence: the pairs of known cameras, and their evidence about the adjusted ones.
    """
    known, cameras, trusted = camera_sets
    checks = check_cameras(cameras, pairs, evidence)
    contradicting = [e.cameras for e in evidence if e.contradicts]
    unclear = [name for name in cameras if any(name in group for group in contradicting) and not checks[name].verified]
    common = [name for name in unclear if all(name in group for group in contradicting)]
    in_triplets = {name for group in contradicting if len(group) == 3 for name in group}
    if min(len(unclear), len(contradicting)) < 2 or len(common) > 1:  # no camera that all contradictions share
        common = []
    contradiction = _contradiction(unclear, cameras, pairs, evidence) if unclear else ""
    moved_checks = {name: _moved_check(known[name], poses.cameras.get(name), name, pairs) for name in moved}
    messages = {name: _moved_message(name, check, poses.metric) for name, check in moved_checks.items()}
    fits = _pair_fit(cameras, pairs, max_epipolar_px)  # replaces the solver's checks, except of pairs that it keeps
    kept_checks = {pair: poses.pair_checks[pair] for pair, check in fits.items() if check.kept and pair in poses.pair_checks}
    pair_checks = {**poses.pair_checks, **fits, **{pair: replace(check, known="stated") for pair, check in kept_checks.items()}}
    return replace(
        poses,
        dropped={pair: check.reason for pair, check in pair_checks.items() if not check.kept},
        pair_checks=pair_checks,
        pose_checks=checks | moved_checks,
        source="mixed" if moved else poses.source,
        sources={name: _source(name, known, trusted, poses) for name in poses.cameras},
        issues=(
            *(PoseIssue("moved", name, text) for name, text in messages.items()),
            *poses.issues,
            *(PoseIssue("unverified", name, _unverified(name, cameras, pairs, evidence), name in in_triplets) for name in common),
            *(PoseIssue("contradicted", name, contradiction, name in in_triplets) for name in (unclear if not common else ())),
        ),
    )


def _adjusted_and_moved(
    known: Mapping[str, Camera], sigmas: Mapping[str, Sigma], geometries: Mapping[Pair, Geometry], frames: Mapping[str, Frame]
) -> tuple[AdjustedPoses, dict[str, NewPose]]:
    """Known cameras, adjusted to the images within their standard deviations, and those that have moved."""
    adjusted = adjust_within_priors(known, sigmas, geometries)
    if frames and _uncertain(adjusted, geometries):
        from .orientation.ground_adjustment import adjust_to_ground  # imported here: other nights need none of its kernels

        grey = {name: grey_levels(frame.image).astype(np.float32) for name, frame in frames.items()}
        adjusted = adjust_to_ground(grey, known, sigmas, geometries) or adjusted
    cameras = adjusted.cameras
    moved = _with_other_views(cameras, find_moved_cameras(cameras, PoseConstraints.of(tuple(cameras), geometries)))
    if moved:
        adjusted = adjust_within_priors({name: camera for name, camera in known.items() if name not in moved}, sigmas, geometries)
    return adjusted, moved


def _uncertain(adjusted: AdjustedPoses, pairs: Iterable[Pair]) -> dict[str, float]:
    """Cameras without any pair whose rows are exact enough to match along, with the least standard deviation of their rows."""
    least_sigma: dict[str, float] = {}
    for pair in pairs:
        if not set(pair) <= set(adjusted.cameras):
            continue
        expected = predict(adjusted.cameras[pair[0]], adjusted.cameras[pair[1]])
        if expected is None:
            continue
        sigma = float(np.median(adjusted.row_sigmas_px(pair, expected.x1, expected.x2)))
        for name in pair:
            least_sigma[name] = min(sigma, least_sigma.get(name, np.inf))
    return {name: sigma for name, sigma in least_sigma.items() if sigma > MOST_ROW_SIGMA_PX}


def _with_other_views(cameras: Mapping[str, Camera], moved: Mapping[str, NewPose]) -> dict[str, NewPose]:
    """The moved cameras, with the other views of the same cameras."""
    new_poses = dict(moved)
    for name, camera in cameras.items():
        for new_pose in moved.values() if name not in moved else ():
            if (placed_view := posed_by_sibling(camera, {0: new_pose.camera})) is not None:
                new_poses[name] = replace(new_pose, camera=placed_view, pairs=())
    return new_poses


def _source(name: str, known: Mapping[str, Camera], trusted: Mapping[str, Camera], poses: Poses) -> str:
    camera = poses.cameras[name]
    if name not in trusted or not (np.array_equal(camera.R, trusted[name].R) and np.array_equal(camera.C, trusted[name].C)):
        return "solved"
    is_stated = name not in known or (np.array_equal(camera.R, known[name].R) and np.array_equal(camera.C, known[name].C))
    return "stated" if is_stated else "refined"


def _pair_fit(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry], max_epipolar_px: float) -> dict[str, PairCheck]:
    """How the matches of each pair fit known poses: a pair whose matches don't is not kept, though its cameras are known."""
    checks = {}
    for pair, geometry in geometries.items():
        if not set(pair) <= set(cameras):
            continue
        error, rotation_deg = epipolar_error_px(cameras, pair, geometry), turned_deg(cameras, pair, geometry)
        reason, code = f"the known poses leave an epipolar error of {error:.2f} px" if error > PAIR_PX else "", ""
        if not (kept := error <= max_epipolar_px):
            rejection = Rejected(Reason.MATCHES_CONTRADICT_CAMERAS, {"epipolar_px": error})
            reason, code = rejection.reason, rejection.code
        figures = geometry.epipolar_px, error, rotation_deg, not error <= PAIR_PX, "stated"
        checks["--".join(pair)] = PairCheck(kept, reason, code, *figures)
    return checks


def _moved_check(stated: Camera, solved: Camera | None, name: str, geometries: Mapping[Pair, Geometry]) -> PoseCheck:
    """The check of a camera that is not at its stated pose, with its displacement."""
    own_pairs = {pair: geometry for pair, geometry in geometries.items() if name in pair}
    inliers = sum(geometry.inliers for geometry in own_pairs.values())
    if solved is None or solved.component != 0:
        return PoseCheck(len(own_pairs), inliers, float("nan"), True)
    length = float(np.linalg.norm(solved.C - stated.C))
    return PoseCheck(len(own_pairs), inliers, float("nan"), True, length, angle_between_deg(solved.R, stated.R))


def _moved_message(name: str, check: PoseCheck, metric: bool) -> str:
    text = f"the known pose of {name} contradicts the images"
    if np.isnan(check.off_m):
        return f"{text}; by how much is unknown: it is left out. Has it been moved?"
    length = f"{check.off_m:.3f} {'m' if metric else 'units'}"
    return f"{text}: it seems off by {length} and {check.off_deg:.2f} degrees; solved anew from the others. Has it been moved?"


def _unverified(name: str, cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry], evidence: list[Evidence]) -> str:
    """The message for a camera whose pairs contradict its known pose."""
    own = {pair: geometry for pair, geometry in geometries.items() if name in pair}
    against = [pair for pair in own if any(e.cameras == pair and e.contradicts for e in evidence)]
    worst_px = max((epipolar_error_px(cameras, pair, own[pair]) for pair in against), default=float("nan"))
    by = f" by up to {worst_px:.1f} px" if against else ""
    most_deg = _most_turned_deg(cameras, {pair: own[pair] for pair in against})
    turned = f" and {most_deg:.1f} degrees" if by and most_deg > TURNED_DEG else ""
    text = f"{len(against)} of its {len(own)} pairs contradict its known pose{by}{turned}; no two others contradict each other"
    return f"{text}. It stays in use, unverified: has it been moved?"


def _most_turned_deg(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> float:
    return max((turned_deg(cameras, pair, geometry) for pair, geometry in geometries.items()), default=float("nan"))


def _contradiction(
    names: list[str], cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry], evidence: list[Evidence]
) -> str:
    """The message for known poses that contradict each other, with what would decide which is wrong."""
    contradicting = {e.cameras for e in evidence if e.contradicts}
    pairs = {pair: geometry for pair, geometry in geometries.items() if set(pair) <= set(names)}
    most_deg = _most_turned_deg(cameras, {pair: g for pair, g in pairs.items() if pair in contradicting} or pairs)
    by = f" by {most_deg:.1f} degrees" if most_deg > TURNED_DEG else ""
    if len(names) == 1:
        return f"the known pose of {names[0]} is unverified: as many of its pairs contradict it{by} as agree. It stays in use."
    text = f"the known poses of {_join_names(names)} contradict each other{by}: which of them is wrong is unknown."
    text += " They stay in use, unverified: the matches may be look-alikes."
    if len(names) == len(cameras) > 2:
        return f"{text} Is this the calibration of these captures?"
    return f"{text} If one was moved, leave out its pose to have it solved; or add a camera that sees what both see."


def _join_names(names: list[str]) -> str:
    if len(names) > MOST_NAMES:
        names = [*names[: MOST_NAMES - 1], f"{len(names) - MOST_NAMES + 1} more"]
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


def stated_cameras(views: Mapping[str, View], placements: Mapping[str, Placement]) -> dict[str, Camera]:
    """The cameras whose intrinsics and pose are both known."""
    cameras = {}
    for name, view in views.items():
        placement = placements.get(name, Placement())
        if view.K is not None and view.focal_known and placement.R is not None and placement.C is not None:
            cameras[name] = camera_of(view, view.K, placement.R, placement.C)
    return cameras


def _as_stated(
    views: Mapping[str, View], placements: Mapping[str, Placement], stated: dict[str, Camera], survey: Survey,
    why: str = "it has no pair from which to solve it",
) -> Poses | Rejected:  # fmt: skip
    """The stated cameras as poses, without solving any; `why` completes the reason given for each other camera."""
    unsolved = {}
    for name, view in views.items():
        if name not in stated:
            lacks_lens = view.K is None or not view.focal_known
            unsolved[name] = f"{'no intrinsics' if lacks_lens else 'no pose'} given, and {why}"
    if not stated:
        return Rejected(Reason.NO_POSED_CAMERA, {"cameras": len(views)})
    metric = all(placements[name].metric for name in stated)
    scale = "calibration" if metric else "calibration, not metric"
    poses = Poses(stated, unsolved, {}, metric, "calibration", components=(tuple(stated),), scale=scale, crs=survey.crs)
    return check_survey(poses, views, placements, survey)

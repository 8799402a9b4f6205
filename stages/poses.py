"""Where the cameras are: taken from the calibration, solved from the pairs' geometries, or both at once.

To solve poses, rotations of all pairs are compared and contradictory pairs dropped; the others grow into models view by view,
with bundle adjustment; each model is placed in the world by whatever is known of it.  A known pose is evidence with a standard
deviation: it is kept, or adjusted within that, or within typical survey errors if none is stated.  A pose is wrong only if
several partners agree on another one (`orientation.moved_cameras`): a finding then names the camera and its apparent
displacement, and it is solved like an unknown one.  If only one pair contradicts a pose, it stays in use, unverified.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from .contracts.defaults import EPIPOLAR_ERROR_PX, RAY_ANGLE_DEG, ROTATION_ERROR_DEG
from .contracts.reasons import Reason, Rejected
from .contracts.unknown import known_or_none
from .core.cameras import camera_of
from .core.luminance import grey_levels
from .core.rotations import angle_between_deg
from .orientation.calibration_check import check_calibration, check_solved_lens
from .orientation.moved_cameras import NewPose, find_moved_cameras
from .orientation.observed_placements import with_observed
from .orientation.pose_check import (
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
from .orientation.typical_errors import correct_typical_errors
from .rectification.predicted import predict
from .sfm.rigs import posed_by_sibling
from .types import (
    CalibrationCheck,
    Camera,
    Frame,
    Geometry,
    ObservedPoses,
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
"""Most cameras that a message lists; of more, it gives the number."""
MOST_ROW_SIGMA_PX = 1.0
"""Largest standard deviation of a camera's rows in pixels: dense matching tolerates partners up to about a pixel off the row."""
_CAUSES_OF_POSES = ("", "turned", "moved")
"""Causes of a contradicted calibration that moved cameras explain; "" is a contradiction without any cause found."""


def solve_poses(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    geometries: Mapping[Pair, Geometry],
    survey: Survey | None = None,
    frames_if_rough: Mapping[str, Frame] | None = None,
    observed: ObservedPoses | None = None,
    *,
    max_rotation_error_deg: float = ROTATION_ERROR_DEG,
    max_epipolar_px: float = EPIPOLAR_ERROR_PX,
    min_angle_deg: float = RAY_ANGLE_DEG,
) -> Poses | Rejected:
    """Put the cameras into one world.

    Returns `Rejected` if not even two cameras can be placed.

    Parameters
    ----------
    views : the pinhole of each camera's frame, at working resolution.
    placements : R and C as the site states them, if it does.  If none has standard deviations, they are kept if the matches
        fit them, and otherwise adjusted within typical survey errors.
    geometries : two-view geometries of the pairs.  If all poses and intrinsics are stated, they check these.
    survey : known distances and control points.
    frames_if_rough : the frames, used if keypoints determine poses no better than their stated standard deviations.
    observed : poses from observations of things, if there are any: evidence like stated ones.
    max_rotation_error_deg : drop a pair if its relative rotation is off by more than this from what the others agree on, degrees.
    max_epipolar_px : drop a pair if its inliers are off the solved cameras' epipolar lines by more than this, pixels (median).
    min_angle_deg : reject if the rays of the matches converge by less than this (median) in all pairs, in degrees: cameras at
        one place, seen from the scene, give no depth.
    """
    if len(views) < 2:
        return Rejected(Reason.ONE_CAMERA, {"cameras": len(views)})
    survey = survey or Survey()
    places = with_observed(views, placements, observed)
    views = places.views
    placements = places.placements
    stated = stated_cameras(views, placements)
    if not geometries:
        if not stated:
            return Rejected(Reason.NO_POSED_CAMERA, {"cameras": len(views)})
        return places.with_sources(check_survey(_as_stated(views, placements, stated, survey), views, placements, survey))

    # 1. Compare the stated poses with the images.
    known = _compared_with_images(stated, placements, places.credible(geometries), frames_if_rough or {})
    is_metric = all(placements[name].metric for name in known.cameras)
    rejected = without_baseline(views, known.cameras, geometries, min_angle_deg, is_metric)
    if rejected is not None:
        return rejected

    # 2. Trust the cameras that have not moved; those that the images could adjust now count as exact.
    trusted = {name: camera for name, camera in stated.items() if name not in known.moved}
    accepted = {name: placement for name, placement in placements.items() if name not in known.moved}
    for name, camera in known.cameras.items():
        trusted[name] = camera
        accepted[name] = replace(placements[name], R=camera.R, C=camera.C, sigma_m=0.0, sigma_deg=0.0)

    # 3. Solve the others; and also trusted ones whose position the images could not adjust yet.
    if len(trusted) == len(views) and all(accepted[name].sigma_m == 0 for name in trusted):
        poses: Poses | Rejected = _as_stated(views, accepted, trusted, survey)
    else:
        # imported here, so that a night whose poses are all known and right does not wait for the solver
        from .orientation.solve import solve_from_pairs

        pairs = _with_confirmed(geometries, known.moved)
        poses = solve_from_pairs(views, accepted, pairs, survey, trusted, max_rotation_error_deg, max_epipolar_px)
        if isinstance(poses, Rejected) and len(trusted) >= 2:
            poses = _as_stated(views, accepted, trusted, survey, poses.reason)
    if isinstance(poses, Rejected):
        return poses

    # 4. Note where each pose comes from, and check the result.
    sources = {name: _source(camera, stated.get(name), trusted.get(name)) for name, camera in poses.cameras.items()}
    calibration = _with_solved_lenses(known.calibration, poses, sources, geometries)
    poses = replace(poses, sources=sources, calibration=calibration)
    poses = _checked(check_survey(poses, views, placements, survey), known, max_epipolar_px)
    return places.with_sources(poses)


@dataclass(frozen=True)
class _KnownPoses:
    """The poses that the images can check, compared with them."""

    stated: Mapping[str, Camera]
    """As the site states them, by id."""
    moved: Mapping[str, NewPose]
    """Those that the images contradict."""
    adjusted: AdjustedPoses
    """The others, adjusted to the images within their standard deviations."""
    pairs: Mapping[Pair, Geometry]
    """The pairs of stated cameras."""
    evidence: list[Evidence]
    """Evidence of these pairs about the adjusted cameras."""
    calibration: CalibrationCheck | None

    @property
    def cameras(self) -> dict[str, Camera]:
        """The cameras that have not moved, as adjusted."""
        return self.adjusted.cameras


def _compared_with_images(
    stated: Mapping[str, Camera],
    placements: Mapping[str, Placement],
    geometries: Mapping[Pair, Geometry],
    frames: Mapping[str, Frame],
) -> _KnownPoses:
    """Compare stated poses with the images, except those of which only the position is uncertain: the solver adjusts these."""
    sigmas = {name: Sigma(placements[name].sigma_m, placements[name].sigma_deg) for name in stated}
    known = {name: camera for name, camera in stated.items() if sigmas[name].exact or sigmas[name].degrees > 0}
    pairs = _pairs_among(known, geometries)

    # 1. Poses without standard deviations are first corrected within the errors of a typical survey.
    are_exact = all(sigmas[name].exact for name in known)
    calibration: CalibrationCheck | None = None
    corrected = known
    if are_exact:
        corrected, calibration = correct_typical_errors(known, geometries)

    # 2. All are adjusted within their standard deviations: by keypoints, or where these are too few, by the ground.
    adjusted = adjust_within_priors(corrected, sigmas, pairs)
    if frames and _uncertain_px(adjusted, pairs):
        # imported here: other nights need none of its kernels
        from .orientation.ground_adjustment import adjust_to_ground

        grey = {name: grey_levels(frame.image).astype(np.float32) for name, frame in frames.items()}
        adjusted = adjust_to_ground(grey, corrected, sigmas, pairs) or adjusted

    # 3. Cameras that contradict several partners in the same way have moved: the others are adjusted again without them.
    constraints = PoseConstraints.of(tuple(adjusted.cameras), pairs)
    moved = _with_other_views(adjusted.cameras, find_moved_cameras(adjusted.cameras, constraints))
    if moved:
        unmoved = {name: camera for name, camera in corrected.items() if name not in moved}
        adjusted = adjust_within_priors(unmoved, sigmas, pairs)

    # 4. Check what has changed since the check within the survey's errors, or was not checked then.
    if moved or not are_exact:
        calibration = stated_calibration(corrected, adjusted.cameras, geometries)
    evidence = PoseConstraints.of(tuple(adjusted.cameras), pairs).evidence(adjusted.cameras)
    return _KnownPoses(known, moved, adjusted, pairs, evidence, calibration)


def _uncertain_px(adjusted: AdjustedPoses, pairs: Iterable[Pair]) -> dict[str, float]:
    """Cameras without any pair whose rows are exact enough to match along, with the least standard deviation of their rows."""
    least_sigma: dict[str, float] = {}
    for pair in pairs:
        left = adjusted.cameras.get(pair[0])
        right = adjusted.cameras.get(pair[1])
        if left is None or right is None:
            continue
        expected = predict(left, right)
        if expected is None:
            continue
        sigma = float(np.median(adjusted.row_sigmas_px(pair, expected.x1, expected.x2)))
        for name in pair:
            least_sigma[name] = min(sigma, least_sigma.get(name, np.inf))
    return {name: sigma for name, sigma in least_sigma.items() if sigma > MOST_ROW_SIGMA_PX}


def _with_other_views(cameras: Mapping[str, Camera], moved: Mapping[str, NewPose]) -> dict[str, NewPose]:
    """The moved cameras, with the other views of the same cameras: all views of a camera move together."""
    new_poses = dict(moved)
    for name, camera in cameras.items():
        if name in moved:
            continue
        for new_pose in moved.values():
            placed_view = posed_by_sibling(camera, {0: new_pose.camera})
            if placed_view is not None:
                new_poses[name] = replace(new_pose, camera=placed_view, pairs=())
    return new_poses


def stated_calibration(
    known: Mapping[str, Camera], unmoved: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]
) -> CalibrationCheck | None:
    """Check the stated calibration as a whole; a contradiction that moved cameras explain is not blamed on the others.

    Parameters
    ----------
    known, unmoved : all cameras as stated, and those that were not moved, as adjusted within their standard deviations.
    geometries : of all pairs.
    """
    check = check_calibration({**known, **unmoved}, geometries)
    has_moved = len(unmoved) < len(known)
    if has_moved and check is not None and check.contradicted and check.cause in _CAUSES_OF_POSES:
        return check_calibration(unmoved, geometries)
    return check


def _with_confirmed(geometries: Mapping[Pair, Geometry], moved: Mapping[str, NewPose]) -> dict[Pair, Geometry]:
    """The pairs, of which those that agree on the new pose of a moved camera count as confirmed."""
    pairs = dict(geometries)
    for new_pose in moved.values():
        for pair in new_pose.pairs:
            pairs[pair] = confirmed(geometries[pair])
    return pairs


def _source(camera: Camera, stated: Camera | None, trusted: Camera | None) -> str:
    """Source of a camera's pose; trusted: the camera with its pose as stated or adjusted, None if there is none or it moved."""
    if trusted is None or not _same_pose(camera, trusted):
        return "solved"
    if stated is not None and _same_pose(camera, stated):
        return "stated"
    return "refined"


def _same_pose(camera: Camera, other: Camera) -> bool:
    return np.array_equal(camera.R, other.R) and np.array_equal(camera.C, other.C)


def _with_solved_lenses(
    check: CalibrationCheck | None, poses: Poses, sources: Mapping[str, str], geometries: Mapping[Pair, Geometry]
) -> CalibrationCheck | None:
    """The check of the stated cameras; if nothing contradicts these, but the lens of a solved one, the clearest such check."""
    if check is not None and check.contradicted:
        return check
    cameras = poses.main_cameras()
    stated = {name: camera for name, camera in cameras.items() if sources[name] != "solved"}
    clearest: CalibrationCheck | None = None
    for name in sorted(cameras):
        if name in stated or name in poses.focals:  # a focal length that was solved states nothing to check
            continue
        lens_check = check_solved_lens(name, {**stated, name: cameras[name]}, geometries)
        if lens_check is not None and (clearest is None or lens_check.better > clearest.better):
            clearest = lens_check
    return clearest or check


def _checked(poses: Poses, known: _KnownPoses, max_epipolar_px: float) -> Poses:
    """The poses found, with the checks of known poses against the images."""
    checks = check_cameras(known.cameras, known.pairs, known.evidence)
    moved_checks = {name: _moved_check(name, known, poses.cameras.get(name)) for name in known.moved}
    pair_checks = _with_known_pairs(poses.pair_checks, known, max_epipolar_px)
    issues = [PoseIssue("moved", name, _moved_message(name, check, poses.metric)) for name, check in moved_checks.items()]
    issues.extend(poses.issues)
    for name, row_px in _uncertain_px(known.adjusted, known.pairs).items():
        issues.append(PoseIssue("uncertain", name, row_px=row_px))
    issues.extend(_contradictions(known, checks))
    return replace(
        poses,
        dropped={pair: check.reason for pair, check in pair_checks.items() if not check.kept},
        pair_checks=pair_checks,
        pose_checks=checks | moved_checks,
        source="mixed" if known.moved else poses.source,
        issues=tuple(issues),
    )


def _with_known_pairs(solved: Mapping[str, PairCheck], known: _KnownPoses, max_epipolar_px: float) -> dict[str, PairCheck]:
    """The checks of the solved pairs, and of the pairs whose cameras are both known."""
    pair_checks = dict(solved)
    for pair, geometry in _pairs_among(known.cameras, known.pairs).items():
        name = "--".join(pair)
        fit = _pair_fit(known.cameras, pair, geometry, max_epipolar_px)
        if fit.kept and name in pair_checks:
            pair_checks[name] = replace(pair_checks[name], known="stated")
        else:
            pair_checks[name] = fit
    return pair_checks


def _pair_fit(cameras: Mapping[str, Camera], pair: Pair, geometry: Geometry, max_epipolar_px: float) -> PairCheck:
    """How the matches of a pair fit known poses: a pair whose matches don't is not kept, though its cameras are known."""
    error_px = epipolar_error_px(cameras, pair, geometry)
    rotation_deg = turned_deg(cameras, pair, geometry)
    if error_px <= max_epipolar_px:
        return PairCheck(True, "", "", geometry.epipolar_px, known_or_none(error_px), known_or_none(rotation_deg), "stated")
    rejection = Rejected(Reason.MATCHES_CONTRADICT_CAMERAS, {"epipolar_px": error_px})
    return PairCheck(
        kept=False,
        reason=rejection.reason,
        code=rejection.code,
        estimated_px=geometry.epipolar_px,
        adjusted_px=known_or_none(error_px),
        rotation_off_deg=known_or_none(rotation_deg),
        known="stated",
    )


def _moved_check(name: str, known: _KnownPoses, solved: Camera | None) -> PoseCheck:
    """The check of a camera that is not at its stated pose, with its displacement."""
    own_pairs = _pairs_of(name, known.pairs)
    inliers = sum(geometry.inliers for geometry in own_pairs.values())
    check = PoseCheck(len(own_pairs), inliers, moved=True)
    if solved is None or solved.component != 0:  # outside the main model there is no common world to measure in
        return check
    stated = known.stated[name]
    off_m = float(np.linalg.norm(solved.C - stated.C))
    return replace(check, off_m=off_m, off_deg=angle_between_deg(solved.R, stated.R))


def _moved_message(name: str, check: PoseCheck, metric: bool) -> str:
    """The message for a camera that is not at its stated pose; metric: whether lengths are in metres."""
    text = f"the known pose of {name} contradicts the images"
    if check.off_m is None:
        return f"{text}; by how much is unknown: it is left out. Has it been moved?"
    unit = "m" if metric else "units"
    displacement = f"{check.off_m:.3f} {unit} and {check.off_deg:.2f} degrees"
    return f"{text}: it seems off by {displacement}; solved anew from the others. Has it been moved?"


def _contradictions(known: _KnownPoses, checks: Mapping[str, PoseCheck]) -> list[PoseIssue]:
    """The doubts about poses that contradict each other: about one of them, if all contradictions involve it."""
    # 1. The groups of cameras, pairs and triplets, in which something contradicts the poses.
    contradicting = [evidence.cameras for evidence in known.evidence if evidence.contradicts]
    involved: set[str] = set()
    in_triplets: set[str] = set()
    for group in contradicting:
        involved.update(group)
        if len(group) == 3:
            in_triplets.update(group)
    unclear = [name for name in known.cameras if name in involved and not checks[name].verified]
    if not unclear:
        return []

    # 2. One camera is part of all of them: it is the doubtful one.  Of a single group, any camera could be.
    common = [name for name in unclear if all(name in group for group in contradicting)]
    if len(common) == 1 and len(unclear) >= 2 and len(contradicting) >= 2:
        name = common[0]
        return [PoseIssue("unverified", name, _unverified(name, known), name in in_triplets)]
    message = _contradiction(unclear, known)
    return [PoseIssue("contradicted", name, message, name in in_triplets) for name in unclear]


def _unverified(name: str, known: _KnownPoses) -> str:
    """The message for a camera whose pairs contradict its known pose."""
    own = _pairs_of(name, known.pairs)
    against = _contradicting(own, known.evidence)
    by = ""
    if against:
        most_px = max(epipolar_error_px(known.cameras, pair, geometry) for pair, geometry in against.items())
        by = f" by up to {most_px:.1f} px"
        most_deg = _most_turned_deg(known.cameras, against)
        if most_deg > TURNED_DEG:
            by += f" and {most_deg:.1f} degrees"
    text = f"{len(against)} of its {len(own)} pairs contradict its known pose{by}; no two others contradict each other"
    return f"{text}. It stays in use, unverified: has it been moved?"


def _contradiction(names: list[str], known: _KnownPoses) -> str:
    """The message for known poses that contradict each other, with what would decide which is wrong."""
    pairs = _pairs_among(names, known.pairs)
    # only triplets may contradict the poses; the rotations of all pairs among the cameras are the best figure then
    most_deg = _most_turned_deg(known.cameras, _contradicting(pairs, known.evidence) or pairs)
    by = f" by {most_deg:.1f} degrees" if most_deg > TURNED_DEG else ""
    if len(names) == 1:
        return f"the known pose of {names[0]} is unverified: as many of its pairs contradict it{by} as agree. It stays in use."
    text = f"the known poses of {_join_names(names)} contradict each other{by}: which of them is wrong is unknown."
    text += " They stay in use, unverified: the matches may be look-alikes."
    if len(names) == len(known.cameras) > 2:
        return f"{text} Is this the calibration of these captures?"
    return f"{text} If one was moved, leave out its pose to have it solved; or add a camera that sees what both see."


def _most_turned_deg(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> float:
    """Largest angle in degrees between the rotation of a pair's cameras and that of its matches; nan without pairs."""
    return max((turned_deg(cameras, pair, geometry) for pair, geometry in geometries.items()), default=float("nan"))


def _join_names(names: list[str]) -> str:
    """The names as words; after the first few, only the number of the others."""
    if len(names) > MOST_NAMES:
        shown = names[: MOST_NAMES - 1]
        names = [*shown, f"{len(names) - len(shown)} more"]
    if len(names) == 1:
        return names[0]
    return " and ".join([", ".join(names[:-1]), names[-1]])


def _pairs_among(names: Iterable[str], geometries: Mapping[Pair, Geometry]) -> dict[Pair, Geometry]:
    """The pairs whose cameras are both among the named ones."""
    wanted = set(names)
    return {pair: geometry for pair, geometry in geometries.items() if wanted.issuperset(pair)}


def _pairs_of(name: str, geometries: Mapping[Pair, Geometry]) -> dict[Pair, Geometry]:
    """The pairs of one camera."""
    return {pair: geometry for pair, geometry in geometries.items() if name in pair}


def _contradicting(pairs: Mapping[Pair, Geometry], evidence: Iterable[Evidence]) -> dict[Pair, Geometry]:
    """The pairs that contradict the poses."""
    contradicting = {item.cameras for item in evidence if item.contradicts}
    return {pair: geometry for pair, geometry in pairs.items() if pair in contradicting}


def stated_cameras(views: Mapping[str, View], placements: Mapping[str, Placement]) -> dict[str, Camera]:
    """The cameras whose intrinsics and pose are both known."""
    cameras = {}
    for name, view in views.items():
        placement = placements.get(name, Placement())  # one that says nothing
        if view.K is not None and view.focal_known and placement.R is not None and placement.C is not None:
            cameras[name] = camera_of(view, view.K, placement.R, placement.C)
    return cameras


def _as_stated(
    views: Mapping[str, View], placements: Mapping[str, Placement], stated: dict[str, Camera], survey: Survey,
    why: str = "it has no pair from which to solve it",
) -> Poses:  # fmt: skip
    """The stated cameras as poses, without solving any; `why` completes the reason given for each other camera."""
    unsolved = {}
    for name, view in views.items():
        if name in stated:
            continue
        has_lens = view.K is not None and view.focal_known
        missing = "no pose" if has_lens else "no intrinsics"
        unsolved[name] = f"{missing} given, and {why}"
    metric = all(placements[name].metric for name in stated)
    scale = "calibration" if metric else "calibration, not metric"
    return Poses(
        stated,
        unsolved=unsolved,
        metric=metric,
        source="calibration",
        components=(tuple(stated),),
        scale=scale,
        crs=survey.crs,
    )

"""Stated poses compared with the images: has a camera been knocked, turned or moved since it was measured?

A stated pose is evidence with a standard deviation.  Two kinds of evidence check it.  A pair: the distance of its inliers (only
those that third cameras confirm, if there are enough) from the epipolar lines of the stated poses.  Three cameras: keypoints that
all three pairs among them chain to the same point; this also reveals motion along the epipolar lines.  Either may consist of
look-alikes, which no number of inliers exposes: so a pose is replaced only if several partners agree on one new pose
(`moved_cameras`), and is unverified otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, replace

import numpy as np

from ..contracts.reasons import Reason, Rejected
from ..core.cameras import backproject, camera_id, project, ray_angles, rays, relative_pose
from ..core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance, triangulate_depth
from ..core.rotations import angle_between_deg
from ..sfm.consistent_matches import consistent_matches
from ..sfm.loops import triangles_of
from ..sfm.tracks import same_places
from ..twoview.pair_score import hardly_converging, probability
from ..types import Camera, Float64s, Geometry, Int32s, Int64s, Pair, PoseCheck

MIN_SHARED = 20
"""Fewest matches of a pair, or points of three cameras, that count as evidence."""
PAIR_PX = 1.0
"""Larger median errors of a pair contradict exact poses, pixels."""
TRIPLET_PX = 4.0
"""Larger median errors of three cameras contradict exact poses, pixels: there, errors of points and matches add up."""
CLOSED_PX = 1.5
"""Largest distance between the two ends of a chain of matches around three cameras that closes, pixels."""
DEVIATIONS = 3.0
"""Tolerance of poses with standard deviations, as a multiple of these."""
TURNED_DEG = 0.5
"""If a pair's stated relative rotation and that of its matches differ by more than this, one of the cameras was turned."""
LEAST_PROBABILITY = 0.5
"""Smallest probability of pairs that may check poses."""
CONFIRMED_LOG_ODDS = 4.0
"""Smallest log odds of a pair that stated poses confirm."""
MIN_ANGLE = np.radians(3.0)
"""Smallest angle between the rays of a triangulated point, radians."""


@dataclass(frozen=True)
class Sigma:
    """Standard deviations of a stated pose; zeros if it is exact."""

    metres: float = 0.0
    degrees: float = 0.0

    @property
    def exact(self) -> bool:
        """Is there nothing to refine?"""
        return self.metres == 0 and self.degrees == 0

    def pixels(self, camera: Camera, distance: float) -> float:
        """Standard deviation of the pixels of points at a distance (metres) from the camera."""
        # small angles: a rotation moves all points alike, a shift the nearer ones more
        sigma_px: float = camera.K[0, 0] * (np.radians(self.degrees) + self.metres / distance)
        return sigma_px


@dataclass(frozen=True)
class Evidence:
    """How well the matches of two or three cameras agree with their poses."""

    cameras: tuple[str, ...]
    """Ids."""
    error_px: float
    """Median error."""
    tolerated_px: float
    """Largest error that right poses may leave."""

    @property
    def excess(self) -> float:
        """The error as a multiple of the tolerated one."""
        return self.error_px / self.tolerated_px

    @property
    def contradicts(self) -> bool:
        """Whether the poses and the matches cannot both be right."""
        return not self.excess <= 1  # "not": an error that is nan contradicts, too


@dataclass(frozen=True)
class Triplet:
    """Three cameras, and in each the pixels (n, 2) of points that all three pairs among them agree on."""

    cameras: tuple[str, str, str]
    x: tuple[Float64s, Float64s, Float64s]


@dataclass(frozen=True)
class PoseConstraints:
    """Evidence about poses: probable pairs with enough matches, and the triplets among them."""

    pairs: Mapping[Pair, Geometry]
    triplets: tuple[Triplet, ...]

    @classmethod
    def of(cls, names: tuple[str, ...], geometries: Mapping[Pair, Geometry]) -> PoseConstraints:
        """Constraints among the named cameras; pairs have only the matches that third cameras confirm, if these are enough."""
        known_names = set(names)
        pairs = {}
        for pair, geometry in geometries.items():
            is_probable = geometry.good_probability >= LEAST_PROBABILITY
            if set(pair) <= known_names and is_probable and len(geometry.x1) >= MIN_SHARED:
                pairs[pair] = geometry
        triplets = []
        for triangle in triangles_of(pairs):
            triplet = _triplet(triangle, pairs)
            if triplet is not None:
                triplets.append(triplet)
        return cls(consistent_matches(pairs, MIN_SHARED), tuple(triplets))

    def without(self, names: set[str]) -> PoseConstraints:
        """The constraints that involve none of some cameras."""
        pairs = {pair: geometry for pair, geometry in self.pairs.items() if names.isdisjoint(pair)}
        triplets = [triplet for triplet in self.triplets if names.isdisjoint(triplet.cameras)]
        return PoseConstraints(pairs, tuple(triplets))

    def evidence(self, cameras: Mapping[str, Camera], camera: str = "") -> list[Evidence]:
        """Evidence from all constraints, or from those that involve `camera`."""
        collected = []
        for pair, geometry in self.pairs.items():
            if not camera or camera in pair:
                collected.append(Evidence(pair, epipolar_error_px(cameras, pair, geometry), PAIR_PX))
        for triplet in self.triplets:
            if camera and camera not in triplet.cameras:
                continue
            error = triplet_error_px(cameras, triplet)
            if error is not None:
                collected.append(Evidence(triplet.cameras, error, TRIPLET_PX))
        return collected


def slack_px(cameras: Mapping[str, Camera], sigmas: Mapping[str, Sigma], pair: Pair, geometry: Geometry) -> float:
    """Tolerance in pixels for a pair's epipolar lines from the uncertainty of its cameras: `DEVIATIONS` standard deviations.

    Parameters
    ----------
    cameras, sigmas : by id, and standard deviations of their stated poses.
    pair, geometry : ids of its two cameras, and its matches, whose distance the tolerance depends on.
    """
    if all(sigmas.get(name, Sigma()).exact for name in pair):
        return 0.0
    X = _intersections(cameras[pair[0]], cameras[pair[1]], geometry.x1, geometry.x2)
    X = X[np.isfinite(X[:, 0])]
    # The errors of both cameras are independent: their variances add up.
    variance = 0.0
    for name in pair:
        camera = cameras[name]
        sigma = sigmas.get(name, Sigma())
        # Without points, the baseline stands for their distance.
        distance = float(np.linalg.norm(cameras[pair[0]].C - cameras[pair[1]].C))
        if len(X):
            distance = float(np.median(np.linalg.norm(X - camera.C, axis=1)))
        variance += sigma.pixels(camera, distance) ** 2
    return DEVIATIONS * float(np.sqrt(variance))


def check_cameras(
    cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry], evidence: list[Evidence]
) -> dict[str, PoseCheck]:
    """The check of each camera that has a probable pair with another one."""
    checks: dict[str, PoseCheck] = {}
    ids = {name: camera_id(name, camera) for name, camera in cameras.items()}
    for name in cameras:
        errors = []
        inliers = 0
        for pair, geometry in geometries.items():
            is_probable = geometry.good_probability >= LEAST_PROBABILITY
            if name in pair and set(pair) <= set(cameras) and is_probable:
                errors.append(epipolar_error_px(cameras, pair, geometry))
                inliers += geometry.inliers
        if errors:
            views = {view for view in cameras if ids[view] == ids[name]}
            is_verified = verified(views, evidence)
            checks[name] = PoseCheck(len(errors), inliers, float(np.median(errors)), verified=is_verified)
    return checks


def verified(views: Set[str], evidence: list[Evidence]) -> bool:
    """Do as many of a camera's pairs, and of its triplets, agree with the poses as contradict them?

    All views of a camera count, since they move together.

    Look-alikes contradict poses that are right.  Two pairs do not agree with a wrong pose; a single pair may, if the camera was
    moved along its epipolar lines.
    """
    own_evidence = [e for e in evidence if not views.isdisjoint(e.cameras)]
    pairs = [e for e in own_evidence if len(e.cameras) == 2]
    triplets = [e for e in own_evidence if len(e.cameras) == 3]
    contradicting_pairs = sum(e.contradicts for e in pairs)
    agreeing_pairs = len(pairs) - contradicting_pairs
    contradicting_triplets = sum(e.contradicts for e in triplets)
    # A tie of one against one says nothing; two that agree are not by accident.
    pairs_agree = agreeing_pairs > contradicting_pairs or agreeing_pairs == contradicting_pairs >= 2
    return pairs_agree and 2 * contradicting_triplets <= len(triplets)


def confirmed(geometry: Geometry) -> Geometry:
    """A pair that stated poses, or several pairs with a common new pose, confirm: its score is at least `CONFIRMED_LOG_ODDS`."""
    score = max(geometry.score, CONFIRMED_LOG_ODDS)
    return replace(geometry, score=score, good_probability=probability(score))


def epipolar_error_px(cameras: Mapping[str, Camera], pair: Pair, geometry: Geometry) -> float:
    """Median distance of a pair's inliers to the epipolar lines of its cameras, pixels."""
    F = fundamental_from_cameras(cameras[pair[0]], cameras[pair[1]])
    return float(np.median(symmetric_epipolar_distance(F, geometry.x1, geometry.x2)))


def turned_deg(cameras: Mapping[str, Camera], pair: Pair, geometry: Geometry) -> float:
    """Angle in degrees between the relative rotation of a pair's cameras and that of its matches; nan if these have none."""
    if geometry.cam2_R_cam1 is None:
        return float("nan")
    return angle_between_deg(geometry.cam2_R_cam1, relative_pose(cameras[pair[0]], cameras[pair[1]])[0])


def triplet_error_px(cameras: Mapping[str, Camera], triplet: Triplet) -> float | None:
    """Median distance from points of the two views at the widest angle to their pixels in the third; None if there are few."""
    # Each view in turn is the one whose pixels are predicted from the other two.
    found: list[tuple[float, float]] = []
    for third in reversed(triplet.cameras):
        x, X = seen_points(cameras, triplet, third)
        if len(x) < MIN_SHARED:
            continue
        first, second = (name for name in triplet.cameras if name != third)
        angle = float(np.median(ray_angles(X - cameras[first].C, X - cameras[second].C)))
        projected, _ = project(cameras[third], X)
        error_px = float(np.median(np.linalg.norm(projected - x, axis=1)))
        found.append((angle, error_px))
    if not found:
        return None
    _, error_at_widest = max(found, key=lambda angle_and_error: angle_and_error[0])
    return error_at_widest


def seen_points(cameras: Mapping[str, Camera], triplet: Triplet, name: str) -> tuple[Float64s, Float64s]:
    """(n, 2) pixels of one camera of a triplet, and (n, 3) the points triangulated from the other two."""
    k = triplet.cameras.index(name)
    i, j = sorted({0, 1, 2} - {k})
    X = _intersections(cameras[triplet.cameras[i]], cameras[triplet.cameras[j]], triplet.x[i], triplet.x[j])
    good = np.isfinite(X[:, 0])
    return triplet.x[k][good], X[good]


def _triplet(names: tuple[str, str, str], pairs: Mapping[Pair, Geometry]) -> Triplet | None:
    """Points whose matches close around the triangle: a wrong match passes only with consistent errors in both other pairs."""
    a, b, c = names
    ab = pairs[a, b]
    bc = pairs[b, c]
    ac = pairs[a, c]
    # Rows of a--b and of b--c that share a keypoint of b; then those of them that share one of a with a--c.
    ab_rows, bc_rows = _common_rows(ab.i2, ab.x2, bc.i1, bc.x1)
    a_keypoints = None if ab.i1 is None else ab.i1[ab_rows]
    ac_rows, kept_rows = _common_rows(ac.i1, ac.x1, a_keypoints, ab.x1[ab_rows])
    ab_rows = ab_rows[kept_rows]
    bc_rows = bc_rows[kept_rows]
    # Both ways lead to c: from a directly, and by way of b.
    closed = np.linalg.norm(ac.x2[ac_rows] - bc.x2[bc_rows], axis=1) < CLOSED_PX
    if closed.sum() < MIN_SHARED:
        return None
    return Triplet(names, (ab.x1[ab_rows[closed]], ab.x2[ab_rows[closed]], bc.x2[bc_rows[closed]]))


def _common_rows(i: Int32s | None, x: Float64s, j: Int32s | None, y: Float64s) -> tuple[Int64s, Int64s]:
    """Rows of two lists of points of one view that are the same keypoint, or at the same place if there are no keypoints."""
    if i is None or j is None:
        return same_places(x, y)
    _, rows, other_rows = np.intersect1d(i, j, return_indices=True)
    return rows, other_rows


def _intersections(left: Camera, right: Camera, x1: Float64s, x2: Float64s) -> Float64s:
    """(n, 3) world points of matches, nan if the rays are too parallel."""
    X = backproject(left, x1, triangulate_depth(left, right, x1, x2)[0])
    # "not greater": the angle of points that could not be triangulated is nan.
    X[~(ray_angles(X - left.C, X - right.C) > MIN_ANGLE)] = np.nan
    return X


def without_baseline(
    names: Mapping[str, object],
    known: Mapping[str, Camera],
    geometries: Mapping[Pair, Geometry],
    min_angle_deg: float,
    metric: bool,
) -> Rejected | None:
    """Why a site with all cameras (almost) at one place yields no cloud; None if some pair has a baseline.

    Parameters
    ----------
    names : all cameras.
    known : the cameras whose poses are known.
    geometries : of the pairs.  Unless each camera is in a pair of known angle whose matches agree, None is returned.
    min_angle_deg : smallest median angle between the rays of a pair's matches that counts as a baseline, in degrees.
    metric : whether known positions are in metres.
    """
    angles = {}
    for pair, geometry in geometries.items():
        # Pairs without a baseline are improbable, since nothing but their rotation is determined; they count as matched, too.
        is_matched = geometry.good_probability >= LEAST_PROBABILITY or hardly_converging(geometry.angle_deg, geometry.agreement)
        if not is_matched or len(geometry.x1) < MIN_SHARED:
            continue
        angle = geometry.angle_deg
        if set(pair) <= set(known):
            rays1 = rays(known[pair[0]], geometry.x1).T
            rays2 = rays(known[pair[1]], geometry.x2).T
            angle = float(np.degrees(np.median(ray_angles(rays1, rays2))))
        if np.isfinite(angle):
            angles[pair] = angle
    covered: set[str] = set()
    for pair in angles:
        covered.update(pair)
    if covered != set(names) or max(angles.values()) >= min_angle_deg:
        return None
    # For small angles, the distance of the scene in baselines is the inverse of the angle.
    widest = max(angles, key=angles.__getitem__)
    figures = {
        "angle_deg": angles[widest],
        "needed_deg": min_angle_deg,
        "baselines": float(1 / np.radians(max(angles[widest], 1e-3))),
    }
    if not metric or not set(widest) <= set(known):
        return Rejected(Reason.NO_USABLE_BASELINE, figures)
    # In metres: only the part of the baseline across the mean direction of view makes rays converge.
    left = known[widest[0]]
    right = known[widest[1]]
    left_rays = rays(left, geometries[widest].x1)
    direction = (left_rays / np.linalg.norm(left_rays, axis=0)).mean(axis=1)
    across = np.cross(right.C - left.C, direction / np.linalg.norm(direction))
    figures["baseline_m"] = float(np.linalg.norm(right.C - left.C))
    figures["distance_m"] = float(np.linalg.norm(across)) * figures["baselines"]
    return Rejected(Reason.NO_USABLE_BASELINE_M, figures)

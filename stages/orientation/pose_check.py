"""Known poses compared with the images: has a camera been knocked, turned or moved since it was measured?

A stated pose is evidence with a standard deviation.  Two kinds of evidence speak about it.  A pair: how far its inliers, or those
that third cameras confirm where these are enough, lie from the epipolar lines of the stated poses.  Three cameras: keypoints that
all three pairs among them chain to the same point; this also tells what moves along the epipolar lines.  Either may be a
look-alike, which no count of inliers tells from the truth: so a pose is replaced only where several partners agree on one new
pose (`moved_cameras`), and is unverified otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, replace

import numpy as np

from ..core.cameras import backproject, camera_id, project, ray_angles, rays, relative_pose
from ..core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance, triangulate_depth
from ..core.rotations import angle_between_deg
from ..reasons import Reason, Rejected
from ..sfm.consistent_matches import consistent_matches
from ..sfm.loops import triangles_of
from ..sfm.tracks import same_places
from ..twoview.pair_score import hardly_converging, probability
from ..types import Camera, Float64s, Geometry, Int32s, Int64s, Pair, PoseCheck

MIN_SHARED = 20
"""Matches or points that a piece of evidence needs at least."""
PAIR_PX, TRIPLET_PX = 1.0, 4.0
"""Larger median errors contradict exact poses: of a pair, and of three cameras, where the error of a point adds to that of the
matches."""
DEVIATIONS = 3.0
"""Poses with standard deviations may be off by so many."""
TURNED_DEG = 0.5
"""The relative rotation of a pair's poses and that of its matches differ by more than this if one of the cameras was turned."""
BELIEVED = 0.5
"""Pairs that are less probable than this check no pose."""
SURE = 4.0
"""Log odds of a pair that is confirmed by known poses."""
MIN_ANGLE = np.radians(3.0)
"""Points are made of rays that meet at more than this, radians."""


@dataclass(frozen=True)
class Sigma:
    """How well a stated pose is known; zeros: exactly."""

    metres: float = 0.0
    degrees: float = 0.0

    @property
    def exact(self) -> bool:
        """Is there nothing to refine?"""
        return self.metres == 0 and self.degrees == 0


@dataclass(frozen=True)
class Evidence:
    """What two or three cameras say of each other."""

    cameras: tuple[str, ...]
    """Ids."""
    error_px: float
    """Median."""
    tolerated_px: float
    """What right poses may leave."""

    @property
    def excess(self) -> float:
        """The error as a share of what is tolerated."""
        return self.error_px / self.tolerated_px

    @property
    def contradicts(self) -> bool:
        """Are the poses and the matches not both right?"""
        return not self.excess <= 1


@dataclass(frozen=True)
class Triplet:
    """Three cameras and (n, 2) pixels in each of points that all three pairs among them agree on."""

    cameras: tuple[str, str, str]
    x: tuple[Float64s, Float64s, Float64s]


@dataclass(frozen=True)
class PoseConstraints:
    """What may speak about poses: believed pairs with enough matches, and the triplets among them."""

    pairs: Mapping[Pair, Geometry]
    triplets: tuple[Triplet, ...]

    @classmethod
    def of(cls, names: tuple[str, ...], geometries: Mapping[Pair, Geometry]) -> PoseConstraints:
        """Those among the cameras of these names, each pair with the matches that third cameras confirm, if these are enough."""
        known = set(names)
        pairs = {p: g for p, g in geometries.items() if set(p) <= known and g.good_probability >= BELIEVED}
        pairs = {p: g for p, g in pairs.items() if len(g.x1) >= MIN_SHARED}
        triplets = [triplet for three in triangles_of(pairs) if (triplet := _triplet(three, pairs)) is not None]
        return cls(consistent_matches(pairs, MIN_SHARED), tuple(triplets))

    def without(self, names: set[str]) -> PoseConstraints:
        """Those that say nothing of some cameras."""
        pairs = {pair: g for pair, g in self.pairs.items() if not set(pair) & names}
        return PoseConstraints(pairs, tuple(t for t in self.triplets if not set(t.cameras) & names))

    def evidence(self, cameras: Mapping[str, Camera], about: str = "") -> list[Evidence]:
        """What all say; or those that know the camera `about`."""
        pairs = {pair: geometry for pair, geometry in self.pairs.items() if not about or about in pair}
        found = [Evidence(pair, epipolar_error_px(cameras, pair, geometry), PAIR_PX) for pair, geometry in pairs.items()]
        for triplet in self.triplets:
            if (not about or about in triplet.cameras) and (error := triplet_error_px(cameras, triplet)) is not None:
                found.append(Evidence(triplet.cameras, error, TRIPLET_PX))
        return found


def slack_px(cameras: Mapping[str, Camera], sigmas: Mapping[str, Sigma], pair: Pair, geometry: Geometry) -> float:
    """How far off a pair's epipolar lines may be for what is uncertain of its cameras: `DEVIATIONS` of it.

    Parameters
    ----------
    cameras, sigmas : by id, and standard deviations of their stated poses.
    pair, geometry : ids of its two cameras; its matches say where the slack is asked for.
    """
    if all(sigmas.get(name, Sigma()).exact for name in pair):
        return 0.0
    X = _meet(cameras[pair[0]], cameras[pair[1]], geometry.x1, geometry.x2)
    X = X[np.isfinite(X[:, 0])]
    square = 0.0
    for name in pair:
        camera, sigma = cameras[name], sigmas.get(name, Sigma())
        away = float(np.linalg.norm(cameras[pair[0]].C - cameras[pair[1]].C))
        if len(X):
            away = float(np.median(np.linalg.norm(X - camera.C, axis=1)))
        square += (camera.K[0, 0] * (np.radians(sigma.degrees) + sigma.metres / away)) ** 2
    return DEVIATIONS * float(np.sqrt(square))


def check_cameras(
    cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry], evidence: list[Evidence]
) -> dict[str, PoseCheck]:
    """The figures of each camera that some pair with another of them can check."""
    found: dict[str, PoseCheck] = {}
    ids = {name: camera_id(name, camera) for name, camera in cameras.items()}
    for name in cameras:
        mine = {pair: g for pair, g in geometries.items() if name in pair and set(pair) <= set(cameras)}
        mine = {pair: g for pair, g in mine.items() if g.good_probability >= BELIEVED}
        if mine:
            errors = [epipolar_error_px(cameras, pair, g) for pair, g in mine.items()]
            inliers = sum(g.inliers for g in mine.values())
            sure = verified({view for view in cameras if ids[view] == ids[name]}, evidence)
            found[name] = PoseCheck(len(mine), inliers, float(np.median(errors)), verified=sure)
    return found


def verified(views: Set[str], evidence: list[Evidence]) -> bool:
    """Do as many of a camera's pairs, and of its triplets, agree with the poses as contradict them?  All its views have a say:
    they move as one.

    Look-alikes contradict poses that are right.  Two pairs do not agree with a wrong pose; a single pair may, along whose
    epipolar lines the camera was moved.
    """
    mine = [e for e in evidence if not views.isdisjoint(e.cameras)]
    agree, contradict = (sum(e.contradicts == no for e in mine if len(e.cameras) == 2) for no in (False, True))
    votes = sum(-1 if e.contradicts else 1 for e in mine if len(e.cameras) == 3)
    return (agree > contradict or agree == contradict >= 2) and votes >= 0


def confirmed(geometry: Geometry) -> Geometry:
    """A pair that agrees with known poses, or with several others on a new one."""
    score = max(geometry.score, SURE)
    return replace(geometry, score=score, good_probability=probability(score))


def epipolar_error_px(cameras: Mapping[str, Camera], pair: Pair, geometry: Geometry) -> float:
    """Median distance of a pair's inliers to the epipolar lines of its cameras."""
    F = fundamental_from_cameras(cameras[pair[0]], cameras[pair[1]])
    return float(np.median(symmetric_epipolar_distance(F, geometry.x1, geometry.x2)))


def turned_deg(cameras: Mapping[str, Camera], pair: Pair, geometry: Geometry) -> float:
    """Angle between a pair's relative rotation and that of its matches; nan where these have none."""
    if geometry.cam2_R_cam1 is None:
        return float("nan")
    return angle_between_deg(geometry.cam2_R_cam1, relative_pose(cameras[pair[0]], cameras[pair[1]])[0])


def triplet_error_px(cameras: Mapping[str, Camera], triplet: Triplet) -> float | None:
    """Median distance of the points that the two widest views give to their pixels in the third; None where these are few."""
    best: tuple[float, float] | None = None
    for third in reversed(triplet.cameras):
        x, X = seen_points(cameras, triplet, third)
        if len(x) < MIN_SHARED:
            continue
        one, two = (X - cameras[name].C for name in triplet.cameras if name != third)
        width = float(np.median(ray_angles(one, two)))
        if best is None or width > best[0]:
            best = width, float(np.median(np.linalg.norm(project(cameras[third], X)[0] - x, axis=1)))
    return best and best[1]


def seen_points(cameras: Mapping[str, Camera], triplet: Triplet, name: str) -> tuple[Float64s, Float64s]:
    """(n, 2) pixels of one camera of a triplet, and (n, 3) the points that the other two make of them."""
    k = triplet.cameras.index(name)
    i, j = (n for n in range(3) if n != k)
    X = _meet(cameras[triplet.cameras[i]], cameras[triplet.cameras[j]], triplet.x[i], triplet.x[j])
    good = np.isfinite(X[:, 0])
    return triplet.x[k][good], X[good]


def _triplet(three: tuple[str, str, str], pairs: Mapping[Pair, Geometry]) -> Triplet | None:
    """The points whose matches close: what a wrong pair says, the two others would have to say, too."""
    a, b, c = three
    ab, bc, ac = pairs[a, b], pairs[b, c], pairs[a, c]
    first, second = _joined(ab.i2, ab.x2, bc.i1, bc.x1)  # rows of a--b and of b--c that share a keypoint of b
    third, row = _joined(ac.i1, ac.x1, None if ab.i1 is None else ab.i1[first], ab.x1[first])
    first, second = first[row], second[row]
    closes = np.linalg.norm(ac.x2[third] - bc.x2[second], axis=1) < 1.5
    if closes.sum() < MIN_SHARED:
        return None
    return Triplet(three, (ab.x1[first[closes]], ab.x2[first[closes]], bc.x2[second[closes]]))


def _joined(i: Int32s | None, x: Float64s, j: Int32s | None, y: Float64s) -> tuple[Int64s, Int64s]:
    """Rows of two lists of points of one view that are the same keypoint, or at the same place where there are no keypoints."""
    if i is None or j is None:
        return same_places(x, y)
    _, rows, others = np.intersect1d(i, j, return_indices=True)
    return rows, others


def _meet(left: Camera, right: Camera, x1: Float64s, x2: Float64s) -> Float64s:
    """(n, 3) world points of matches, nan where the rays are too parallel."""
    X = backproject(left, x1, triangulate_depth(left, right, x1, x2)[0])
    X[~(ray_angles(X - left.C, X - right.C) > MIN_ANGLE)] = np.nan
    return X


def without_baseline(
    names: Mapping[str, object],
    known: Mapping[str, Camera],
    geometries: Mapping[Pair, Geometry],
    min_angle_deg: float,
    metric: bool,
) -> Rejected | None:
    """Why a site whose cameras are all (almost) at one place makes no cloud; None where some pair has a baseline.

    Parameters
    ----------
    names : all cameras.
    known : those whose poses are known.
    geometries : of the pairs.  As long as a camera is in no pair of matches that agree and whose angle is known, nothing is said.
    min_angle_deg : a pair has a baseline if the rays of its matches meet at this or more (median), in degrees.
    metric : known positions are in metres.
    """
    angles = {}
    for pair, geometry in geometries.items():
        matched = geometry.good_probability >= BELIEVED or hardly_converging(geometry.angle_deg, geometry.agreement)
        if matched and len(geometry.x1) >= MIN_SHARED:
            both = set(pair) <= set(known)
            angle = _angle_deg(known[pair[0]], known[pair[1]], geometry) if both else geometry.angle_deg
            if np.isfinite(angle):
                angles[pair] = angle
    if {name for pair in angles for name in pair} != set(names) or max(angles.values()) >= min_angle_deg:
        return None
    widest = max(angles, key=angles.__getitem__)
    figures = {
        "angle_deg": angles[widest],
        "needed_deg": min_angle_deg,
        "baselines": float(1 / np.radians(max(angles[widest], 1e-3))),
    }
    if not metric or not set(widest) <= set(known):
        return Rejected(Reason.NO_USABLE_BASELINE, figures)
    left, right = (known[name] for name in widest)
    seen = rays(left, geometries[widest].x1)
    ahead = (seen / np.linalg.norm(seen, axis=0)).mean(axis=1)
    across = np.cross(right.C - left.C, ahead / np.linalg.norm(ahead))
    figures["baseline_m"] = float(np.linalg.norm(right.C - left.C))
    figures["distance_m"] = float(np.linalg.norm(across)) * figures["baselines"]
    return Rejected(Reason.NO_USABLE_BASELINE_M, figures)


def _angle_deg(left: Camera, right: Camera, geometry: Geometry) -> float:
    return float(np.degrees(np.median(ray_angles(rays(left, geometry.x1).T, rays(right, geometry.x2).T))))

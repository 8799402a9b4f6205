"""Find cameras that have moved: several partners agree on one pose that is not the stated one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..core.cameras import project
from ..core.epipolar import fundamental_from_cameras, sampson_distance
from ..core.rotations import angle_between_deg, rotation_matrix
from ..types import Camera, Float64s, Geometry, Pair
from .pose_check import PAIR_PX, TRIPLET_PX, PoseConstraints, seen_points

AGREE_DEG = 1.5
"""Largest difference between the rotations that two pairs give a camera for one pose to be fitted to both."""
CLEARER_RATIO = 2.0
"""A constraint supports a new pose if its error there is this many times smaller than under the stated pose."""
MIN_CELLS = 8
"""Fewest grid cells of the image (of 96) that the distinctive matches of a constraint must cover."""
SAMPLE = 150
"""Constraints with more matches are thinned to about this number for the fit."""
PARALLEL = 0.03
"""Two directions to a camera that differ by less than this (radians) do not determine its distance."""
MOST_EVALUATIONS = 60
"""Largest number of evaluations of the fit of a pose."""


@dataclass(frozen=True)
class NewPose:
    """A camera at the pose on which its partners agree."""

    camera: Camera
    support: int
    """Number of constraints that contradict the stated pose and support this one."""
    contradictions: int
    """Number of contradictions that remain with it among all cameras."""
    pairs: tuple[Pair, ...]
    """Pairs that support it."""


def find_moved_cameras(cameras: Mapping[str, Camera], constraints: PoseConstraints) -> dict[str, NewPose]:
    """The cameras whose stated poses are wrong, with their new poses.

    A camera has moved if at least two pairs with different partners, or three cameras whose matches close, contradict
    its pose and agree on another one; if their distinctive matches are spread over the image; and if they outnumber the
    constraints against the new pose.  If either of two cameras may have moved, neither counts as moved; if half of all cameras
    or more would count, none does.
    """
    moved: dict[str, NewPose] = {}
    ambiguous: set[str] = set()
    while True:
        # 1. Which of the other cameras may have moved, now that constraints with those that did no longer count?
        remaining = constraints.without(set(moved))
        candidates = {}
        for name in cameras:
            if name in moved or name in ambiguous:
                continue
            new_pose = _agreed_pose(name, cameras, remaining)
            if new_pose is not None:
                candidates[name] = new_pose
        if not candidates:
            if 2 * len(moved) >= len(cameras):
                return {}
            return moved

        # 2. The one whose new pose leaves the fewest contradictions.
        name = min(candidates, key=lambda other: (candidates[other].contradictions, -candidates[other].support))

        # 3. A rival explains as much.  If it has no case without this camera, either of both may have moved.
        without_it = remaining.without({name})
        rivals = []
        for other, new_pose in candidates.items():
            if other != name and new_pose.contradictions <= candidates[name].contradictions:
                if _agreed_pose(other, cameras, without_it) is None:
                    rivals.append(other)
        if rivals:
            ambiguous |= {name, *rivals}
        else:
            moved[name] = candidates[name]


def _agreed_pose(name: str, cameras: Mapping[str, Camera], constraints: PoseConstraints) -> NewPose | None:
    """The pose of a camera that its partners agree on against the stated one; None if there is none."""
    stated = {evidence.cameras: evidence for evidence in constraints.evidence(cameras, name)}
    contradicting = [key for key, evidence in stated.items() if evidence.contradicts]
    against = _distinctive(constraints, contradicting)
    if len(against.pairs) < 2 and not against.triplets:
        return None
    contradictions_elsewhere = sum(e.contradicts for e in constraints.evidence(cameras)) - len(contradicting)
    agreed: list[NewPose] = []
    for start, determining in _initial_poses(name, cameras, against):
        # Fit the pose to the few constraints that suggest it, then ask all others.
        camera = _fitted(name, start, cameras, determining)
        revised = {evidence.cameras: evidence for evidence in constraints.evidence({**cameras, name: camera}, name)}
        remaining = sum(evidence.contradicts for evidence in revised.values())
        supporters = []
        for key in contradicting:
            resolved = key in revised and not revised[key].contradicts
            if resolved and CLEARER_RATIO * revised[key].excess <= stated[key].excess:
                supporters.append(key)
        partners: set[str] = set()
        has_triplet = False
        for key in supporters:
            if len(key) == 2:
                partners |= set(key) - {name}
            else:
                has_triplet = True
        if (len(partners) < 2 and not has_triplet) or len(supporters) <= remaining:
            continue
        supporting_pairs = tuple(pair for pair in against.pairs if pair in supporters)
        new_pose = NewPose(camera, len(supporters), contradictions_elsewhere + remaining, supporting_pairs)
        if remaining == 0:
            return new_pose
        agreed.append(new_pose)
    return min(agreed, key=lambda pose: (pose.contradictions, -pose.support), default=None)


def _distinctive(constraints: PoseConstraints, keys: list[tuple[str, ...]]) -> PoseConstraints:
    """Of the constraints between some cameras (`keys`), those whose pairs all have distinctive matches in enough cells."""
    indistinct = [pair for pair, geometry in constraints.pairs.items() if geometry.distinct_cells < MIN_CELLS]
    distinctive = {key for key in keys if not any(set(pair) <= set(key) for pair in indistinct)}
    pairs = {pair: geometry for pair, geometry in constraints.pairs.items() if pair in distinctive}
    triplets = tuple(triplet for triplet in constraints.triplets if triplet.cameras in distinctive)
    return PoseConstraints(pairs, triplets)


def _initial_poses(
    name: str, cameras: Mapping[str, Camera], against: PoseConstraints
) -> Iterator[tuple[Camera, PoseConstraints]]:
    """Yield initial poses, each with the constraints that determine it."""
    # Two pairs that agree on the rotation: the camera is where the directions from both partners meet.
    pair_poses = {}
    for pair, geometry in against.pairs.items():
        pose = _pose(name, cameras, pair, geometry)
        if pose is not None:
            pair_poses[pair] = pose
    for a, b in combinations(pair_poses, 2):
        R_a, from_a, direction_a = pair_poses[a]
        R_b, from_b, direction_b = pair_poses[b]
        if angle_between_deg(R_a, R_b) > AGREE_DEG:
            continue
        C = _crossing(cameras[name], from_a, direction_a, from_b, direction_b)
        if C is None:
            continue
        shared_triplets = tuple(triplet for triplet in against.triplets if {*a, *b} == set(triplet.cameras))
        both = {pair: against.pairs[pair] for pair in (a, b)}
        yield replace(cameras[name], R=R_a, C=C), PoseConstraints(both, shared_triplets)

    # Three cameras determine a pose by themselves; the stated one is the start.
    for triplet in against.triplets:
        within = {pair: geometry for pair, geometry in against.pairs.items() if set(pair) <= set(triplet.cameras)}
        yield cameras[name], PoseConstraints(within, (triplet,))


def _pose(name: str, cameras: Mapping[str, Camera], pair: Pair, geometry: Geometry) -> tuple[Float64s, Float64s, Float64s] | None:
    """R of a camera according to a pair, the partner's centre, and the direction (3,) from there to the camera."""
    R = geometry.cam2_R_cam1
    t = geometry.cam2_t_cam1
    if R is None or t is None:
        return None
    if pair[1] == name:
        partner = cameras[pair[0]]
        own_R = R @ partner.R
        return own_R, partner.C, -own_R.T @ t
    partner = cameras[pair[1]]
    return R.T @ partner.R, partner.C, partner.R.T @ t


def _crossing(camera: Camera, A: Float64s, a: Float64s, B: Float64s, b: Float64s) -> Float64s | None:
    """(3,) where the direction a from A and the direction b from B meet; None if that is behind one of them."""
    if np.linalg.norm(np.cross(a, b)) < PARALLEL:
        # The partners are in line with the camera: keep its stated distance.
        return np.asarray(A + a * np.linalg.norm(camera.C - A), dtype=np.float64)
    # A + s a = B + t b, which lines in space fulfil only nearly: the middle of their shortest connection.
    (s, t), *_ = np.linalg.lstsq(np.column_stack([a, -b]), B - A, rcond=None)
    if min(s, t) <= 0:
        return None
    return np.asarray(0.5 * (A + s * a + B + t * b), dtype=np.float64)


def _fitted(name: str, start: Camera, cameras: Mapping[str, Camera], constraints: PoseConstraints) -> Camera:
    """Return the pose that best satisfies some constraints, with the other cameras at their stated poses."""
    from scipy.optimize import least_squares  # imported here, since nights with right poses do not need it

    # Shifts are in units of the distance to the nearest camera, so that all unknowns are of similar size.
    distances = [float(np.linalg.norm(start.C - camera.C)) for other, camera in cameras.items() if other != name]
    scale = min(distances) or 1.0
    matches = []
    for pair, geometry in constraints.pairs.items():
        x1, x2 = _thinned(geometry.x1, geometry.x2)
        matches.append((pair, x1, x2))
    points = [_thinned(*seen_points(cameras, triplet, name)) for triplet in constraints.triplets]

    def pose_after(step: Float64s) -> Camera:
        """step: rotation vector (3) in the camera's axes, and shift (3) in units of `scale`."""
        return replace(start, R=rotation_matrix(step[:3]) @ start.R, C=start.C + scale * step[3:])

    def errors(step: Float64s) -> Float64s:
        trial = {**cameras, name: pose_after(step)}
        parts = []
        for (left, right), x1, x2 in matches:
            F = fundamental_from_cameras(trial[left], trial[right])
            parts.append(sampson_distance(F, x1, x2) / PAIR_PX)
        for x, X in points:
            projected, _ = project(trial[name], X)
            parts.append(np.nan_to_num((projected - x) / TRIPLET_PX).ravel())
        return np.concatenate([*parts, np.zeros(6)])  # never fewer errors than unknowns

    return pose_after(least_squares(errors, np.zeros(6), loss="cauchy", max_nfev=MOST_EVALUATIONS).x)


def _thinned(x: Float64s, y: Float64s) -> tuple[Float64s, Float64s]:
    """About every so many rows that `SAMPLE` remain, of both arrays."""
    step = max(1, len(x) // SAMPLE)
    return x[::step], y[::step]

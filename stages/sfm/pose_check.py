"""Known poses compared with the images: has a camera been knocked, turned or moved since it was measured?

Two kinds of evidence, each for a few cameras at once.  A pair: how far its inliers lie from the epipolar lines of the stated
poses.  Three cameras: points that two of them see, projected into the third; this also tells what moves along the epipolar lines.
A wrong camera is the one whose removal leaves agreement among the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..core.cameras import backproject, project, ray_angles, relative_pose
from ..core.rotations import angle_between_deg
from ..twoview.epipolar import fundamental_from_cameras, symmetric_epipolar_distance, triangulate_depth
from ..types import Camera, Float64s, Geometry, Pair, PoseCheck
from .tracks import same_places

MIN_SHARED = 20
"""Matches or points that a piece of evidence needs at least."""
PAIR_PX, TRIO_PX = 1.0, 4.0
"""Larger median errors contradict the poses: of a pair, and of three cameras, where the error of a point adds to that of the
matches."""
CLEARER = 2.0
"""One camera is named if without it the others agree so many times better than without any other..."""
AGREEMENT = 0.3
"""...where errors below this share of what is tolerated are as good as none."""
TURNED_DEG = 0.5
"""The relative rotation of a pair's poses and that of its matches differ by more than this if one of the cameras was turned."""
BELIEVED = 0.5
"""Pairs that are less probable than this are no witnesses."""
MIN_ANGLE = np.radians(3.0)
"""Points are made of rays that meet at more than this, radians."""


@dataclass(frozen=True)
class Evidence:
    """What two or three cameras (ids) say of each other: median error in pixels; of a pair also the angle between its relative
    rotation and that of its matches, in degrees (nan: unknown)."""

    cameras: tuple[str, ...]
    error_px: float
    turned_deg: float = float("nan")

    @property
    def excess(self) -> float:
        """The error as a share of what is tolerated."""
        return self.error_px / (PAIR_PX if len(self.cameras) == 2 else TRIO_PX)


def evidence_on(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> list[Evidence]:
    """All that the believed pairs of these cameras say about their poses."""
    pairs = {pair: g for pair, g in geometries.items() if set(pair) <= set(cameras) and g.good_probability >= BELIEVED}
    witnesses = {pair: g for pair, g in pairs.items() if len(g.x1) >= MIN_SHARED}
    found = [Evidence(p, epipolar_error_px(cameras, p, g), turned_deg(cameras, p, g)) for p, g in witnesses.items()]
    points = {pair: _points(cameras, pair, geometry) for pair, geometry in pairs.items()}
    best: dict[tuple[str, ...], tuple[int, float]] = {}
    for a, b in pairs:
        for hinge in (a, b):
            for third in cameras:
                if third in (a, b) or _either(hinge, third, pairs) is None:
                    continue
                x, X = _seen_by(third, hinge, (a, b), points, pairs)
                trio = tuple(sorted((a, b, third), key=list(cameras).index))
                if len(x) >= max(MIN_SHARED, best.get(trio, (0, 0.0))[0] + 1):
                    best[trio] = len(x), float(np.median(np.linalg.norm(project(cameras[third], X)[0] - x, axis=1)))
    return found + [Evidence(trio, error) for trio, (_, error) in best.items()]


def check_cameras(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> dict[str, PoseCheck]:
    """The figures of each camera that some pair with another of them can check."""
    found: dict[str, PoseCheck] = {}
    for name in cameras:
        mine = {pair: g for pair, g in geometries.items() if name in pair and set(pair) <= set(cameras)}
        mine = {pair: g for pair, g in mine.items() if g.good_probability >= BELIEVED}
        if mine:
            errors = [epipolar_error_px(cameras, pair, g) for pair, g in mine.items()]
            found[name] = PoseCheck(len(mine), sum(g.inliers for g in mine.values()), float(np.median(errors)))
    return found


def epipolar_error_px(cameras: Mapping[str, Camera], pair: Pair, geometry: Geometry) -> float:
    """Median distance of a pair's inliers to the epipolar lines of its cameras."""
    F = fundamental_from_cameras(cameras[pair[0]], cameras[pair[1]])
    return float(np.median(symmetric_epipolar_distance(F, geometry.x1, geometry.x2)))


def turned_deg(cameras: Mapping[str, Camera], pair: Pair, geometry: Geometry) -> float:
    """Angle between a pair's relative rotation and that of its matches; nan where these have none."""
    if geometry.cam2_R_cam1 is None:
        return float("nan")
    return angle_between_deg(geometry.cam2_R_cam1, relative_pose(cameras[pair[0]], cameras[pair[1]])[0])


def contradicted(evidence: list[Evidence]) -> tuple[list[str], list[str]]:
    """Cameras without which the others agree; and, where it could be several, those among which a wrong one is.

    In turn the camera that leaves the least contradiction among the others.  At least half of its pairs or of its trios must
    speak against it, so that one wrong pair accuses nobody.
    """
    wrong: list[str] = []
    while True:
        left = [e for e in evidence if not set(e.cameras) & set(wrong)]
        rank = {}
        for name in dict.fromkeys(name for e in left if e.excess > 1 for name in e.cameras):
            if max(_share_against(name, left, 2), _share_against(name, left, 3)) >= 0.5:
                without = [e.excess for e in left if name not in e.cameras]
                rank[name] = sum(e > 1 for e in without), max(without, default=0.0)
        if not rank:
            return wrong, []
        fewest, least = min(rank.values())
        first = [name for name, (bad, excess) in rank.items() if bad == fewest and excess <= CLEARER * max(least, AGREEMENT)]
        if len(first) > 1:
            first = _turned(first, left) or first
        if len(first) > 1:
            return wrong, first
        wrong += first


def _turned(cameras: list[str], evidence: list[Evidence]) -> list[str]:
    """Those of the cameras that must have been turned: all their pairs say so, and those of the others don't all.

    At the end of a chain: the camera before it is where it is said to be for all that the one before that can tell.
    """
    pairs = [e for e in evidence if len(e.cameras) == 2]
    return [c for c in cameras if all(e.turned_deg > TURNED_DEG and e.excess > 1 for e in pairs if c in e.cameras)]


def _share_against(camera: str, evidence: list[Evidence], cameras: int) -> float:
    mine = [e.excess > 1 for e in evidence if camera in e.cameras and len(e.cameras) == cameras]
    return sum(mine) / len(mine) if mine else 0.0


def _either(a: str, b: str, pairs: Mapping[Pair, Geometry]) -> Pair | None:
    return (a, b) if (a, b) in pairs else (b, a) if (b, a) in pairs else None


def _points(cameras: Mapping[str, Camera], pair: Pair, geometry: Geometry) -> Float64s:
    """(n, 3) world points of a pair's inliers, nan where the rays are too parallel."""
    left, right = (cameras[name] for name in pair)
    depth, _ = triangulate_depth(left, right, geometry.x1, geometry.x2)
    X = backproject(left, geometry.x1, depth)
    X[~(ray_angles(X - left.C, X - right.C) > MIN_ANGLE)] = np.nan
    return X


def _seen_by(
    camera: str, hinge: str, pair: Pair, points: Mapping[Pair, Float64s], pairs: Mapping[Pair, Geometry]
) -> tuple[Float64s, Float64s]:
    """Pixels of `camera` and points of `pair`, which both share the keypoints of `hinge`."""
    link = _either(hinge, camera, pairs)
    assert link is not None
    this, other = pairs[pair], pairs[link]
    mine, at = (this.i1, this.x1) if pair[0] == hinge else (this.i2, this.x2)
    theirs, there, x = (other.i1, other.x1, other.x2) if link[0] == hinge else (other.i2, other.x2, other.x1)
    if mine is None or theirs is None:
        a, b = same_places(at, there)
    else:
        _, a, b = np.intersect1d(mine, theirs, return_indices=True)
    X = points[pair][a]
    good = np.isfinite(X[:, 0])
    return x[b][good], X[good]

"""Cameras around a cloud of points, with the pair geometries that perfect (or noisy, or wrong) matching would give."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from wbflow_stages.core.cameras import project, relative_pose
from wbflow_stages.core.epipolar import fundamental_from_cameras, homogeneous, symmetric_epipolar_distance
from wbflow_stages.twoview.robust import estimate_essential, estimate_fundamental, pose_of_fundamental
from wbflow_stages.types import Camera, Float64s, Geometry, Pair, Poses, View

WIDTH, HEIGHT = 800, 600


@dataclass(frozen=True)
class PairSite:
    """cameras: ground truth; views: what is known of them; geometries: of all pairs up to 60 degrees apart; X: the points."""

    cameras: dict[str, Camera]
    views: dict[str, View]
    geometries: dict[Pair, Geometry]
    X: np.ndarray


def make_pair_site(
    count: int = 6,
    *,
    seed: int = 0,
    noise_px: float = 0.0,
    points: int = 300,
    degrees: float = 15.0,
    focal: float = 800.0,
    radius: float = 8.0,
    know: str = "K",
) -> PairSite:
    """Cameras on an arc, `degrees` apart.  know: "K", "hfov" (focal length 10 % too long) or "nothing"."""
    rng = np.random.default_rng(seed)
    X = rng.uniform([-2.5, -1.5, -1.5], [2.5, 1.5, 1.5], (points, 3))
    K = np.array([[focal, 0, (WIDTH - 1) / 2], [0, focal, (HEIGHT - 1) / 2], [0, 0, 1]])
    cameras, pixels = {}, {}
    for k in range(count):
        angle = np.radians(degrees) * (k - (count - 1) / 2)
        C = radius * np.array([np.sin(angle), -np.cos(angle), 0.0]) + rng.uniform(-0.3, 0.3, 3) + [0, 0, 0.5 * (k % 2)]
        cameras[f"c{k}"] = camera = look(K, C, rng.uniform(-0.2, 0.2, 3))
        pixels[f"c{k}"] = project(camera, X)[0] + noise_px * rng.normal(size=(points, 2))
    guess = {"K": (K, True), "hfov": (K * [[1.1, 1, 1], [1, 1.1, 1], [1, 1, 1]], False), "nothing": (None, False)}[know]
    views = {name: View(WIDTH, HEIGHT, *guess) for name in cameras}
    geometries = {}
    names = list(cameras)
    for i, left in enumerate(names):
        for right in names[i + 1 :]:
            if degrees * (names.index(right) - i) <= 60:
                geometries[left, right] = pair_geometry(cameras, views, pixels, (left, right), noise_px)
    return PairSite(cameras, views, geometries, X)


def look(K: np.ndarray, C: np.ndarray, target: np.ndarray) -> Camera:
    """An upright camera at C that looks at the target."""
    forward = (target - C) / np.linalg.norm(target - C)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    return Camera(K, np.array([right, np.cross(forward, right), forward]), C, WIDTH, HEIGHT)


def pair_geometry(
    cameras: dict[str, Camera], views: dict[str, View], pixels: dict[str, np.ndarray], pair: Pair, noise_px: float
) -> Geometry:
    """What the geometry stage would find for a pair; keypoints have the same numbers as the points."""
    left, right = (cameras[name] for name in pair)
    view1, view2 = (views[name] for name in pair)
    inside = np.ones(len(pixels[pair[0]]), bool)
    for name in pair:
        x = pixels[name]
        inside &= (x > 0).all(axis=1) & (x[:, 0] < WIDTH) & (x[:, 1] < HEIGHT)
    seen = np.flatnonzero(inside)
    x1, x2 = pixels[pair[0]][seen], pixels[pair[1]][seen]
    F = fundamental_from_cameras(left, right)
    R: Float64s | None
    t: Float64s | None
    R, t = relative_pose(left, right)
    if noise_px > 0:
        known = view1.K is not None and view1.focal_known
        found = estimate_essential(x1, x2, view1, view2, 1.0, 0, 1000) if known else estimate_fundamental(x1, x2, 1.0, 0)
        assert found is not None
        F, R, t = found.F, found.R, found.t
    if not view1.focal_known:
        R, t = pose_of_fundamental(F, x1, x2, view1, view2) or (None, None)
    t = None if t is None else t / np.linalg.norm(t)
    return geometry_of(F, x1, x2, seen, view1, view2, R, t)


def geometry_of(
    F: Float64s,
    x1: Float64s,
    x2: Float64s,
    rows: npt.NDArray[np.integer],
    view1: View,
    view2: View,
    R: Float64s | None,
    t: Float64s | None,
) -> Geometry:
    """A geometry with figures that pass every check of single pairs."""
    n = len(x1)
    return Geometry(
        F=F,
        x1=x1,
        x2=x2,
        i1=rows.astype(np.int32),
        i2=rows.astype(np.int32),
        probability=np.ones(n, np.float32),
        view1=view1,
        view2=view2,
        cam2_R_cam1=R,
        cam2_t_cam1=t,
        matches=n,
        inliers=n,
        model="F" if R is None else "E",
        epipolar_px=float(np.median(symmetric_epipolar_distance(F, x1, x2))),
        angle_deg=float("nan"),
        homography_share=0.1,
        score=3.0,
        good_probability=0.95,
        distinct_cells=40,
        distinct_share=1.0,
    )


def turned_wrong(site: PairSite, pair: Pair, seed: int) -> Geometry:
    """A geometry of the pair with a wrong, random relative pose, and matches that fit this pose perfectly."""
    rng = np.random.default_rng(seed)
    view1, view2 = site.views[pair[0]], site.views[pair[1]]
    K = site.cameras[pair[0]].K
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    while True:
        t = rng.normal(size=3)
        t /= np.linalg.norm(t)
        angle = rng.uniform(np.radians(10), np.radians(40))
        W = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        turn = np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W
        R = turn @ relative_pose(site.cameras[pair[0]], site.cameras[pair[1]])[0]
        left = Camera(K, np.eye(3), np.zeros(3), WIDTH, HEIGHT)
        right = Camera(K, R, -R.T @ t, WIDTH, HEIGHT)
        x1 = rng.uniform([0, 0], [WIDTH, HEIGHT], (4000, 2))
        X = (homogeneous(x1) @ np.linalg.inv(K).T) * rng.uniform(1, 30, (4000, 1))
        x2, depth = project(right, X)
        seen = np.flatnonzero((depth > 0) & (x2 > 0).all(axis=1) & (x2[:, 0] < WIDTH) & (x2[:, 1] < HEIGHT))[:150]
        if len(seen) >= 60:
            rows = rng.permutation(len(site.X))[: len(seen)]
            F = fundamental_from_cameras(left, right)
            return geometry_of(F, x1[seen], x2[seen], rows, view1, view2, R, t)


def aligned_errors(poses: Poses, truth: dict[str, Camera]) -> tuple[float, float]:
    """Largest errors after similarity alignment: of the centres, relative to their extent, and of the rotations, radians."""
    names = list(poses.cameras)
    a = np.array([poses.cameras[name].C for name in names])
    b = np.array([truth[name].C for name in names])
    turned = np.mean([truth[name].R.T @ poses.cameras[name].R for name in names], axis=0)
    U, _, Vt = np.linalg.svd(turned)
    S = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    a, b = (a - a.mean(axis=0)) @ S.T, b - b.mean(axis=0)
    scale = (a * b).sum() / (a * a).sum()
    centre = np.linalg.norm(scale * a - b, axis=1).max() / np.linalg.norm(b, axis=1).max()
    rotation = max(np.linalg.norm(poses.cameras[name].R @ S.T - truth[name].R) / np.sqrt(2) for name in names)
    return float(centre), float(rotation)


def only(site: PairSite, *names: str) -> PairSite:
    """The site, reduced to these cameras."""
    kept = {pair: geometry for pair, geometry in site.geometries.items() if set(pair) <= set(names)}
    views = {name: view for name, view in site.views.items() if name in names}
    return replace(site, views=views, geometries=kept)


def about_vertical(camera: Camera, degrees: float) -> Camera:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return replace(camera, R=camera.R @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))


def with_look_alikes(site: PairSite, pair: Pair, degrees: float, seed: int) -> Geometry:
    """A pair's geometry, re-estimated after 70 % of the matches are moved to where its second camera would see them if turned."""
    geometry, rng = site.geometries[pair], np.random.default_rng(seed)
    assert geometry.i1 is not None and geometry.i2 is not None
    rows = rng.permutation(len(geometry.x1))[: int(0.7 * len(geometry.x1))]
    x2, i2 = geometry.x2.copy(), geometry.i2.copy()
    x2[rows] = project(about_vertical(site.cameras[pair[1]], degrees), site.X[geometry.i1[rows]])[0]
    x2[rows] += 0.2 * rng.normal(size=(len(rows), 2))
    i2[rows] += len(site.X)  # not the keypoints of these points
    left, right = (site.views[name] for name in pair)
    found = estimate_essential(geometry.x1, x2, left, right, 1.0, 0, 1000)
    assert found is not None and found.R is not None and found.t is not None
    keep = found.inliers
    posed = replace(geometry, F=found.F, cam2_R_cam1=found.R, cam2_t_cam1=found.t / np.linalg.norm(found.t))
    i1, probability = geometry.i1[keep], geometry.probability[keep]
    return replace(posed, x1=geometry.x1[keep], x2=x2[keep], i1=i1, i2=i2[keep], probability=probability)


def control_points(X: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    """Points (n, 3) as the control points of a survey."""
    return tuple((x, y, z) for x, y, z in X.tolist())


def sightings(site: PairSite, count: int) -> tuple[tuple[int, int, float, float], ...]:
    """The observations of a survey: the first `count` scene points in all cameras."""
    rows = []
    for point in range(count):
        for number, camera in enumerate(site.cameras.values()):
            x, y = project(camera, site.X[point : point + 1])[0][0].tolist()
            rows.append((point, number, x, y))
    return tuple(rows)

"""Two cameras, a scene of points and their exact projections, for tests of rectification."""

from __future__ import annotations

import numpy as np

from wbflow_stages.core.cameras import project
from wbflow_stages.core.epipolar import fundamental_from_cameras
from wbflow_stages.types import Camera, Geometry, View

WIDTH, HEIGHT, FOCAL = 640, 480, 560.0
K = np.array([[FOCAL, 0.0, (WIDTH - 1) / 2], [0.0, FOCAL, (HEIGHT - 1) / 2], [0.0, 0.0, 1.0]])


def looking(centre: np.ndarray, target: np.ndarray) -> Camera:
    """A camera at `centre` with `target` in the middle of its image; the world's y axis points down."""
    forward = target - centre
    forward = forward / np.linalg.norm(forward)
    right = np.cross(np.array([0.0, 1.0, 0.0]), forward)
    right = right / np.linalg.norm(right)
    return Camera(K, np.stack([right, np.cross(forward, right), forward]), centre, WIDTH, HEIGHT)


def scene(seed: int = 0, n: int = 1500, depth: tuple[float, float] = (6.0, 12.0)) -> np.ndarray:
    """Points (n, 3) on a wavy wall and on objects in front of it, seen by a camera at the origin that looks along z."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(-0.5, 0.5, (2, n))
    near, far = depth
    wall = far - 0.15 * (far - near) * (1 + np.sin(9 * u + 1) * np.cos(7 * v))
    thing = (np.hypot(u + 0.15, v - 0.1) < 0.15) | (np.hypot(u - 0.3, v + 0.2) < 0.1)
    z = np.where(thing, near + 0.2 * (far - near) * (u + 0.5), wall)
    return np.column_stack([u * WIDTH / FOCAL * z, v * HEIGHT / FOCAL * z, z])


def geometry_of(x1: np.ndarray, x2: np.ndarray, F: np.ndarray, *, angle_deg: float = float("nan")) -> Geometry:
    """The two-view geometry whose inliers are x1, x2."""
    n = len(x1)
    rows = np.arange(n, dtype=np.int32)
    view = View(WIDTH, HEIGHT, K)
    return Geometry(
        F=F, x1=x1, x2=x2, i1=rows, i2=rows, probability=np.ones(n, dtype=np.float32), view1=view, view2=view,
        cam2_R_cam1=None, cam2_t_cam1=None, matches=n, inliers=n, model="F", epipolar_px=0.0, angle_deg=angle_deg,
        homography_share=0.0, score=1.0, good_probability=1.0,
    )  # fmt: skip


def seen_by_both(camera1: Camera, camera2: Camera, X: np.ndarray, noise_px: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Projections (n, 2), (n, 2) of the points that lie inside both images, with Gaussian noise in both."""
    x1, z1 = project(camera1, X)
    x2, z2 = project(camera2, X)
    size = np.array([WIDTH - 1, HEIGHT - 1])
    both = (z1 > 0.1) & (z2 > 0.1) & (x1 >= 0).all(axis=1) & (x1 <= size).all(axis=1)
    both &= (x2 >= 0).all(axis=1) & (x2 <= size).all(axis=1)
    rng = np.random.default_rng(7)
    x1, x2 = x1[both], x2[both]
    return x1 + rng.normal(0, noise_px, x1.shape), x2 + rng.normal(0, noise_px, x2.shape)


def two_views(
    baseline: np.ndarray, *, target: float = 9.0, n: int = 1500, noise_px: float = 0.0
) -> tuple[Geometry, Camera, Camera]:
    """Geometry and cameras of two views: from the origin and from `baseline`; both look at the point (0, 0, target)."""
    aim = np.array([0.0, 0.0, target])
    camera1, camera2 = looking(np.zeros(3), aim), looking(baseline, aim)
    x1, x2 = seen_by_both(camera1, camera2, scene(n=n), noise_px)
    return geometry_of(x1, x2, fundamental_from_cameras(camera1, camera2)), camera1, camera2

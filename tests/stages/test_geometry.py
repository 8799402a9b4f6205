"""Two-view geometry of exact cameras: the pose is recovered, and each degenerate case is named."""

import numpy as np
import pytest

from wbflow_stages.core.cameras import project, relative_pose
from wbflow_stages.core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.types import Camera, Features, Geometry, Matches, Rejected, View

K = np.array([[800.0, 0, 500], [0, 800, 333], [0, 0, 1]])


def looking(position: tuple[float, float, float], turn_deg: float) -> Camera:
    a = np.radians(turn_deg)
    R = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return Camera(K, R, np.array(position), 1000, 667)


LEFT, RIGHT = looking((0, 0, 0), 0), looking((3, 0.3, 0.4), 15)


def world(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    X = np.column_stack([rng.uniform(-4, 6, n), rng.uniform(-3, 3, n), rng.uniform(8, 16, n)])
    if kind == "wall":
        X[:, 2] = 12 + 0.2 * X[:, 0]
    return X


def observed(
    X: np.ndarray, right: Camera = RIGHT, noise: float = 0.3, outliers: int = 0, known: bool = True, seed: int = 0
) -> tuple[Matches, Features, Features]:
    rng = np.random.default_rng(seed)
    x1, x2 = project(LEFT, X)[0], project(right, X)[0]
    inside = ((x1 > 0) & (x1 < [999, 666]) & (x2 > 0) & (x2 < [999, 666])).all(axis=1)
    x1 = np.r_[x1[inside] + rng.normal(0, noise, (inside.sum(), 2)), rng.uniform(0, [999, 666], (outliers, 2))]
    x2 = np.r_[x2[inside] + rng.normal(0, noise, (inside.sum(), 2)), rng.uniform(0, [999, 666], (outliers, 2))]
    view = View(1000, 667, K if known else None)
    n = len(x1)
    i, frames = np.arange(n, dtype=np.int32), np.repeat(np.eye(2)[None], n, axis=0)
    d = rng.random((n, 128)).astype(np.float32)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    ones = np.ones(n, np.float32)
    left, rightf = (Features(x, frames, d, ones, np.zeros(n, np.uint8), view) for x in (x1, x2))
    return Matches(x1, x2, i, i, np.ones(n, np.float32), frames, view, view), left, rightf


def degrees_between(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


@pytest.mark.parametrize("known", [True, False])
def test_epipolar_lines_of_a_solid_scene_pass_through_the_true_points(known: bool) -> None:
    X = world("solid", 400, np.random.default_rng(1))
    found = estimate_geometry(*observed(X, outliers=150, known=known))
    assert isinstance(found, Geometry)
    truth, *_ = observed(X, noise=0)
    assert symmetric_epipolar_distance(found.F, truth.x1, truth.x2).mean() < 0.3
    assert found.model == ("E" if known else "F") and found.inliers == len(found.x1) < found.matches
    np.testing.assert_allclose(np.linalg.norm(found.F), 1)


def test_relative_pose_and_ray_angle_are_found_with_known_lenses() -> None:
    X = world("solid", 400, np.random.default_rng(2))
    found = estimate_geometry(*observed(X, outliers=100))
    assert isinstance(found, Geometry) and found.cam2_R_cam1 is not None and found.cam2_t_cam1 is not None
    R, t = relative_pose(LEFT, RIGHT)
    assert np.degrees(np.linalg.norm(R.T @ found.cam2_R_cam1 - np.eye(3)) / np.sqrt(2)) < 0.1
    assert degrees_between(t, found.cam2_t_cam1) < 0.5
    matches, *_ = observed(X, noise=0)
    angles = [degrees_between(x - LEFT.C, x - RIGHT.C) for x in X]
    assert abs(found.angle_deg - np.median(angles)) < 1.5 and len(matches.x1) > 100


def test_wrong_intrinsics_leave_only_f_and_give_a_warning() -> None:
    matches, left, right = observed(world("solid", 400, np.random.default_rng(3)), noise=0.1)
    wrong = View(1000, 667, np.array([[1500.0, 0, 300], [0, 700, 333], [0, 0, 1]]))
    found = estimate_geometry(Matches(**{**vars(matches), "view1": wrong}), left, right)
    assert isinstance(found, Geometry) and found.model == "F"
    assert any("intrinsics" in w for w in found.warnings)


def test_a_wall_is_rejected_without_known_lenses_and_gives_a_warning_with_them() -> None:
    X = world("wall", 400, np.random.default_rng(4))
    bare = estimate_geometry(*observed(X, known=False))
    assert isinstance(bare, Rejected) and "planar" in bare.reason
    known = estimate_geometry(*observed(X))
    assert isinstance(known, Geometry) and any("planar" in w for w in known.warnings)


def test_a_camera_that_only_turned_is_rejected_as_a_rotation() -> None:
    found = estimate_geometry(*observed(world("solid", 500, np.random.default_rng(5)), right=looking((0, 0, 0), 12)))
    assert isinstance(found, Rejected) and "rotation" in found.reason and found.figures["rotation_share"] > 0.95


def test_two_cameras_at_almost_one_place_are_accepted() -> None:
    X = world("solid", 800, np.random.default_rng(9)) * [10, 10, 10]
    found = estimate_geometry(*observed(X, right=looking((0.8, 0, 0.2), 2), noise=0.05))
    assert isinstance(found, Geometry) and found.angle_deg < 0.7


def test_too_few_and_too_clustered_matches_are_rejected_with_figures() -> None:
    few = estimate_geometry(*observed(world("solid", 16, np.random.default_rng(6))))
    assert isinstance(few, Rejected) and few.reason.startswith("too few") and few.figures["matches"] <= 16
    spot = np.array([1, 0, 12]) + np.random.default_rng(7).uniform(-0.2, 0.2, (200, 3))
    clustered = estimate_geometry(*observed(spot, noise=0.05))
    assert isinstance(clustered, Rejected) and clustered.reason.startswith("too clustered")


def test_outliers_alone_are_rejected() -> None:
    assert isinstance(estimate_geometry(*observed(np.zeros((0, 3)), outliers=60)), Rejected)


def test_the_same_matches_give_the_same_geometry_bytes() -> None:
    a, b = (estimate_geometry(*observed(world("solid", 300, np.random.default_rng(8)), outliers=200)) for _ in range(2))
    assert isinstance(a, Geometry) and isinstance(b, Geometry)
    assert a.F.tobytes() == b.F.tobytes() and a.x1.tobytes() == b.x1.tobytes()
    assert fundamental_from_cameras(LEFT, RIGHT).shape == (3, 3)

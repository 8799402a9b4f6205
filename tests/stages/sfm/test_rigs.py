"""Several views of one camera are solved as one: at one position, with the rotations that its lens defines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_pairs import PairSite, aligned_errors, control_points, make_pair_site, pair_geometry, turned_wrong
from wbflow_stages.core.cameras import project
from wbflow_stages.core.lenses import lens_pixels
from wbflow_stages.core.rotations import rotation_matrix
from wbflow_stages.io.cameras import calibration
from wbflow_stages.poses import solve_poses
from wbflow_stages.types import Float64s, Lens, Placement, Poses, Survey

WIDE = ("c1", "c3")
TURNS = (-18.0, 18.0)


def turned(degrees: float) -> Float64s:
    """Rotation from a camera's axes to those of its view that looks `degrees` to the right."""
    return rotation_matrix(np.radians([0.0, -degrees, 0.0]))


def with_wide_cameras(noise_px: float = 0.0) -> PairSite:
    """A site in which two of five cameras have two views each."""
    site = make_pair_site(5, points=500, focal=500.0)
    rng = np.random.default_rng(3)
    cameras, views = {}, {}
    for name, camera in site.cameras.items():
        for k, degrees in enumerate(TURNS if name in WIDE else ()):
            turn = turned(degrees)
            lens = Lens(camera.K, model="fisheye", camera=name, turn=turn)
            cameras[f"{name}@{k + 1}"] = replace(camera, R=turn @ camera.R, lens=lens)
            views[f"{name}@{k + 1}"] = replace(site.views[name], lens=lens)
        if name not in WIDE:
            cameras[name], views[name] = camera, site.views[name]
    pixels = {name: project(c, site.X)[0] + noise_px * rng.normal(size=(len(site.X), 2)) for name, c in cameras.items()}
    pairs = [(a, b) for i, a in enumerate(cameras) for b in list(cameras)[i + 1 :] if a[:2] != b[:2]]
    return PairSite(cameras, views, {p: pair_geometry(cameras, views, pixels, p, noise_px) for p in pairs}, site.X)


def assert_views_hang_together(poses: Poses) -> None:
    for name in WIDE:
        one, other = (poses.cameras[f"{name}@{k}"] for k in (1, 2))
        np.testing.assert_allclose(other.C, one.C, atol=1e-9)
        np.testing.assert_allclose(other.R, turned(TURNS[1]) @ turned(TURNS[0]).T @ one.R, atol=1e-9)


def solve(site: PairSite, placements: dict[str, Placement]) -> Poses:
    poses = solve_poses(site.views, placements, site.geometries)
    assert isinstance(poses, Poses)
    return poses


def relative_errors(site: PairSite, rotations: dict[str, Float64s]) -> float:
    """Mean error of the rotations relative to that of the first camera, since images do not determine a common rotation."""
    first = rotations["c0"] @ site.cameras["c0"].R.T
    return float(np.mean([np.linalg.norm(R - first @ site.cameras[n].R) for n, R in rotations.items()]))


@pytest.mark.parametrize("noise_px", [0.0, 0.4])
def test_views_of_one_camera_are_solved_together(noise_px: float) -> None:
    site = with_wide_cameras(noise_px)
    poses = solve(site, {})
    assert set(poses.cameras) == set(site.cameras)
    assert_views_hang_together(poses)
    centre, rotation = aligned_errors(poses, site.cameras)
    assert centre < (1e-6 if noise_px == 0 else 0.01)
    assert rotation < (1e-6 if noise_px == 0 else 0.005)


def test_a_look_alike_in_one_view_is_outvoted_by_other_views_of_its_camera() -> None:
    site = with_wide_cameras()
    remaining = {pair: g for pair, g in site.geometries.items() if "c3@2" not in pair and "c0" not in pair}
    wrong = {("c0", "c3@2"): turned_wrong(site, ("c0", "c3@2"), seed=1)}
    other = {("c0", name): site.geometries["c0", name] for name in ("c1@1", "c2", "c4")}
    placements = {name: Placement(R=camera.R, C=camera.C, metric=True) for name, camera in site.cameras.items()}
    poses = solve(replace(site, geometries={**other, **remaining, **wrong}), placements)
    assert not poses.issues and all(check.verified for check in poses.pose_checks.values())
    alone = {pair: g for pair, g in remaining.items() if "c3@1" not in pair}
    poses = solve(replace(site, geometries={**other, **alone, **wrong}), placements)
    assert not poses.pose_checks["c3@2"].verified, "nothing else of this camera says anything"


def test_a_view_without_matches_is_placed_with_its_camera() -> None:
    site = with_wide_cameras()
    without_matches = replace(site, geometries={pair: g for pair, g in site.geometries.items() if "c3@2" not in pair})
    poses = solve(without_matches, {})
    assert set(poses.cameras) == set(site.cameras)
    assert_views_hang_together(poses)


def test_known_poses_of_cameras_and_views_define_the_world() -> None:
    site = with_wide_cameras()
    known = {n: Placement(c.R, c.C) for n, c in site.cameras.items() if n[:2] in {"c0", "c1"}}
    poses = solve(site, known)
    for name, camera in site.cameras.items():
        np.testing.assert_allclose(poses.cameras[name].C, camera.C, atol=1e-5)
        np.testing.assert_allclose(poses.cameras[name].R, camera.R, atol=1e-5)


def test_distances_and_control_points_can_refer_to_cameras_with_several_views() -> None:
    site = with_wide_cameras()
    truth = make_pair_site(5, points=500, focal=500.0).cameras
    ids = tuple(truth)
    distance = float(np.linalg.norm(truth["c1"].C - truth["c3"].C))
    found = solve_poses(site.views, {}, site.geometries, Survey(ids, ((1, 3, distance),)))
    assert isinstance(found, Poses) and found.metric
    assert np.linalg.norm(found.cameras["c0"].C - found.cameras["c4"].C) == pytest.approx(
        np.linalg.norm(truth["c0"].C - truth["c4"].C), rel=1e-5
    )
    rows: list[tuple[int, int, float, float]] = []
    for name in WIDE:
        lens = Lens(truth[name].K, model="fisheye")
        pixels = lens_pixels(lens, (site.X[:6] - truth[name].C) @ truth[name].R.T)
        rows += [(point, ids.index(name), *pixels[point].tolist()) for point in range(6)]
    survey = Survey(ids, points=control_points(site.X[:6]), observations=tuple(rows))
    found = solve_poses(site.views, {}, site.geometries, survey)
    assert isinstance(found, Poses)
    for name, camera in site.cameras.items():
        np.testing.assert_allclose(found.cameras[name].C, camera.C, atol=1e-4)


def test_the_pose_of_a_single_wide_camera_gives_no_scale() -> None:
    site = with_wide_cameras()
    poses = solve(site, {n: Placement(c.R, c.C) for n, c in site.cameras.items() if n.startswith("c1")})
    assert not poses.metric
    assert_views_hang_together(poses)


def test_uncertain_poses_are_corrected_for_all_views_of_a_camera_together() -> None:
    site = with_wide_cameras(0.2)
    rng = np.random.default_rng(1)
    off = {name: (rng.normal(size=3) * 0.004, rng.normal(size=3) * 0.03) for name in ("c0", "c1", "c2", "c3", "c4")}
    stated = {}
    for name, camera in site.cameras.items():
        turn, shift = off[name[:2]]
        own = camera.lens.turn if camera.lens and camera.lens.turn is not None else np.eye(3)
        stated[name] = Placement(own @ rotation_matrix(turn) @ own.T @ camera.R, camera.C + shift, 0.05, 0.4)
    poses = solve(site, stated)
    assert_views_hang_together(poses)
    before = relative_errors(site, {n: p.R for n, p in stated.items() if p.R is not None})
    assert relative_errors(site, {n: camera.R for n, camera in poses.cameras.items()}) < 0.3 * before


def test_the_calibration_lists_a_camera_with_several_views_once() -> None:
    site = with_wide_cameras()
    found = calibration(solve(site, {n: Placement(c.R, c.C) for n, c in site.cameras.items()}))
    assert list(found) == ["c0", "c1", "c2", "c3", "c4"]
    truth = make_pair_site(5, points=500, focal=500.0).cameras
    for name, entry in found.items():
        np.testing.assert_allclose(entry["R"], truth[name].R, atol=1e-9)

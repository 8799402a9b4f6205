"""Stated poses with the small errors that surveys usually leave are corrected, which hides no other error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_pairs import PairSite, make_pair_site, turned_wrong
from wbflow_stages.core.rotations import angle_between_deg, rotation_matrix
from wbflow_stages.orientation.pose_check import epipolar_error_px
from wbflow_stages.poses import solve_poses
from wbflow_stages.types import Camera, Placement, Poses


def off_by(site: PairSite, degrees: float, metres: float, seed: int = 0) -> dict[str, Camera]:
    """All cameras, each off by these amounts in a direction of its own."""
    rng = np.random.default_rng(seed)

    def moved(camera: Camera) -> Camera:
        turn, shift = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        return replace(camera, R=rotation_matrix(np.radians(degrees) * turn) @ camera.R, C=camera.C + metres * shift)

    return {name: moved(camera) for name, camera in site.cameras.items()}


def solve(site: PairSite, stated: dict[str, Camera]) -> Poses:
    poses = solve_poses(site.views, {name: Placement(camera.R, camera.C) for name, camera in stated.items()}, site.geometries)
    assert isinstance(poses, Poses), poses
    return poses


def errors_px(site: PairSite, cameras: Mapping[str, Camera]) -> float:
    return max(epipolar_error_px(cameras, pair, geometry) for pair, geometry in site.geometries.items())


@pytest.mark.parametrize(("degrees", "metres"), [(0.03, 0.0), (0.0, 0.006), (0.05, 0.01)])
def test_small_errors_of_all_poses_are_corrected_without_reporting_an_issue(degrees: float, metres: float) -> None:
    site = make_pair_site(5, noise_px=0.2)
    stated = off_by(site, degrees, metres)
    poses = solve(site, stated)
    assert errors_px(site, poses.cameras) < 1.15 * errors_px(site, site.cameras) < 0.8 * errors_px(site, stated)
    assert set(poses.sources.values()) == {"refined"} and not poses.issues
    assert poses.calibration is not None and not poses.calibration.contradicted
    for name, camera in poses.cameras.items():  # the stated poses still define the position of the site
        assert angle_between_deg(camera.R, stated[name].R) < 0.15 and np.linalg.norm(camera.C - stated[name].C) < 0.03


@pytest.mark.parametrize("noise_px", [0.1, 0.3, 0.6])
def test_right_poses_are_returned_unchanged(noise_px: float) -> None:
    site = make_pair_site(5, noise_px=noise_px)
    poses = solve(site, site.cameras)
    assert set(poses.sources.values()) == {"stated"}
    for name, camera in poses.cameras.items():
        assert np.array_equal(camera.R, site.cameras[name].R) and np.array_equal(camera.C, site.cameras[name].C)


def test_a_pair_of_look_alikes_moves_no_camera() -> None:
    site = make_pair_site(5, noise_px=0.2)
    wrong = replace(site, geometries=site.geometries | {("c0", "c1"): turned_wrong(site, ("c0", "c1"), seed=1)})
    poses = solve(wrong, site.cameras)
    assert set(poses.sources.values()) == {"stated"}


@pytest.mark.parametrize("degrees", [0.5, 2.0])
def test_larger_pose_errors_are_reported_instead_of_corrected(degrees: float) -> None:
    site = make_pair_site(5, noise_px=0.2)
    poses = solve(site, off_by(site, degrees, 0.0))
    assert "refined" not in poses.sources.values()
    assert poses.issues or (poses.calibration is not None and poses.calibration.contradicted)


@pytest.mark.parametrize(
    ("degrees", "noise_px", "longer"), [(15.0, 0.2, 1.015), (6.0, 0.2, 1.015), (6.0, 0.2, 1.008), (6.0, 0.1, 1.005)]
)
def test_wrong_focal_lengths_are_not_hidden_by_adjusted_poses(degrees: float, noise_px: float, longer: float) -> None:
    site = make_pair_site(5, noise_px=noise_px, degrees=degrees)
    long = {
        name: replace(view, K=np.array(view.K) * [[longer, 1, 1], [1, longer, 1], [1, 1, 1]]) for name, view in site.views.items()
    }
    poses = solve(replace(site, views=long), site.cameras)
    assert set(poses.sources.values()) == {"stated"}

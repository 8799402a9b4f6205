"""Known poses compared with the images of the night: cameras that have been moved are named, with how far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_pairs import PairSite, make_pair_site, only, turned_wrong
from wbflow_stages.core.rotations import rotation_matrix
from wbflow_stages.poses import solve_poses
from wbflow_stages.types import Placement, Poses


def placements(site: PairSite, **wrong: Placement) -> dict[str, Placement]:
    return {name: Placement(camera.R, camera.C) for name, camera in site.cameras.items()} | wrong


def moved(site: PairSite, name: str, degrees: tuple[float, float, float], metres: tuple[float, float, float]) -> Placement:
    camera = site.cameras[name]
    return Placement(rotation_matrix(np.radians(degrees)) @ camera.R, camera.C + np.array(metres))


def solve(site: PairSite, known: dict[str, Placement]) -> Poses:
    poses = solve_poses(site.views, known, site.geometries)
    assert isinstance(poses, Poses), poses
    return poses


def test_right_poses_are_taken_as_they_are_and_their_figures_kept() -> None:
    site = make_pair_site(5, noise_px=0.3)
    poses = solve(site, placements(site))
    assert poses.source == "calibration" and not poses.suspects and not poses.notes
    assert set(poses.checks) == set(site.cameras)
    for name, check in poses.checks.items():
        assert check.pairs == sum(name in pair for pair in site.geometries) and check.inliers > 100
        assert 0.05 < check.epipolar_px < 0.5 and not check.moved
    assert all(verdict.adjusted_px < 0.5 and verdict.rotation_off_deg < 0.5 for verdict in poses.verdicts.values())


@pytest.mark.parametrize(
    ("name", "degrees", "metres"),
    [
        ("c2", (0.0, 0.0, 0.0), (0.6, 0.0, 0.8)),
        ("c0", (3.0, 4.0, 0.0), (0.0, 0.0, 0.0)),
        ("c4", (0.0, 0.5, 0.0), (0.0, 0.0, 0.0)),
        ("c1", (0.0, 0.0, 0.5), (0.0, 0.0, 0.0)),
    ],
)
def test_the_one_wrong_pose_is_named_with_how_far_it_is_off_and_bends_no_other(
    name: str, degrees: tuple[float, float, float], metres: tuple[float, float, float]
) -> None:
    site = make_pair_site(5, noise_px=0.2)
    known = placements(site, **{name: moved(site, name, degrees, metres)})
    poses = solve(site, known)
    assert list(poses.suspects) == [name]
    check = poses.checks[name]
    assert check.moved
    assert check.off_m == pytest.approx(np.linalg.norm(metres), abs=0.02)
    assert check.off_deg == pytest.approx(np.linalg.norm(degrees), abs=0.1)
    assert f"{check.off_m:.3f} m and {check.off_deg:.2f} degrees" in poses.suspects[name]
    for other in set(site.cameras) - {name}:
        C, R = known[other].C, known[other].R
        assert C is not None and R is not None
        assert np.array_equal(poses.cameras[other].C, C)
        assert np.array_equal(poses.cameras[other].R, R)
    assert np.linalg.norm(poses.cameras[name].C - site.cameras[name].C) < 0.02


def test_two_wrong_poses_are_both_named() -> None:
    site = make_pair_site(7, noise_px=0.2)
    wrong = {"c1": moved(site, "c1", (0, 5, 0), (0, 0, 0)), "c4": moved(site, "c4", (0, 0, 0), (1, 0, 0))}
    assert set(solve(site, placements(site, **wrong)).suspects) == {"c1", "c4"}


def test_one_wrong_pair_accuses_no_camera() -> None:
    site = make_pair_site(6, noise_px=0.2)
    pair = next(iter(site.geometries))
    poses = solve(replace(site, geometries=site.geometries | {pair: turned_wrong(site, pair, 0)}), placements(site))
    assert poses.source == "calibration" and not poses.suspects
    assert poses.verdicts["--".join(pair)].flagged


def test_of_two_cameras_it_cannot_be_told_which_is_wrong() -> None:
    site = only(make_pair_site(3, noise_px=0.2), "c0", "c1")
    known = {name: p for name, p in placements(site, c1=moved(site, "c1", (5, 0, 0), (0, 0, 0))).items() if name in site.views}
    poses = solve(site, known)
    assert not poses.suspects
    (note,) = poses.notes
    assert note.startswith("the known poses of c0 and c1 contradict each other by 5.0 degrees: which is wrong cannot be told")
    assert "Leave out the pose of the camera that was moved" in note


def test_a_camera_turned_at_the_end_of_a_chain_is_named() -> None:
    site = make_pair_site(3, noise_px=0.2)
    chain = replace(site, geometries={pair: g for pair, g in site.geometries.items() if pair != ("c0", "c2")})
    poses = solve(chain, placements(chain, c2=moved(chain, "c2", (0, 3, 0), (0, 0, 0))))
    assert list(poses.suspects) == ["c2"]
    assert poses.checks["c2"].off_deg == pytest.approx(3.0, abs=0.1)


def test_who_was_shifted_in_a_chain_cannot_be_told_from_who_was_not() -> None:
    site = make_pair_site(3, noise_px=0.2)
    chain = replace(site, geometries={pair: g for pair, g in site.geometries.items() if pair != ("c0", "c2")})
    poses = solve(chain, placements(chain, c2=moved(chain, "c2", (0, 0, 0), (0.5, 0.5, 0.5))))
    assert not poses.suspects
    assert "contradict each other: which is wrong cannot be told" in poses.notes[0]


def test_a_calibration_that_fits_nowhere_accuses_no_single_camera() -> None:
    site = make_pair_site(5, noise_px=0.2)
    rng = np.random.default_rng(0)
    known = {name: moved(site, name, tuple(rng.uniform(-5, 5, 3)), (0, 0, 0)) for name in site.cameras}
    poses = solve(site, known)
    assert not poses.suspects and "contradict each other" in poses.notes[0]

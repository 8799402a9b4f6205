"""Known poses are compared with the images of the night: cameras that were moved are named, with how far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.exact_pairs import PairSite, aligned_errors, make_pair_site, only, turned_wrong, with_look_alikes
from tests.helpers.measured import measured
from wbflow_stages.core.rotations import rotation_matrix
from wbflow_stages.orientation.pose_check import PAIR_PX, Evidence, epipolar_error_px, verified
from wbflow_stages.poses import solve_poses, stated_cameras
from wbflow_stages.types import Placement, Poses


def placements(site: PairSite, **wrong: Placement) -> dict[str, Placement]:
    return {name: Placement(camera.R, camera.C) for name, camera in site.cameras.items()} | wrong


def moved_placement(
    site: PairSite, name: str, degrees: tuple[float, float, float], metres: tuple[float, float, float]
) -> Placement:
    camera = site.cameras[name]
    return Placement(rotation_matrix(np.radians(degrees)) @ camera.R, camera.C + np.array(metres))


def solve(site: PairSite, known: dict[str, Placement]) -> Poses:
    poses = solve_poses(site.views, known, site.geometries)
    assert isinstance(poses, Poses), poses
    return poses


def test_right_poses_are_kept_and_their_checks_reported() -> None:
    site = make_pair_site(5, noise_px=0.3)
    poses = solve(site, placements(site))
    assert poses.source == "calibration" and not poses.issues_of("moved") and not poses.notes
    assert set(poses.pose_checks) == set(site.cameras)
    for name, check in poses.pose_checks.items():
        assert check.pairs == sum(name in pair for pair in site.geometries) and check.inliers > 100
        assert 0.05 < measured(check.epipolar_px) < 0.5 and not check.moved
    assert all(
        measured(check.adjusted_px) < 0.5 and measured(check.rotation_off_deg) < 0.5 for check in poses.pair_checks.values()
    )


@pytest.mark.parametrize(
    ("name", "degrees", "metres"),
    [
        ("c2", (0.0, 0.0, 0.0), (0.6, 0.0, 0.8)),
        ("c0", (3.0, 4.0, 0.0), (0.0, 0.0, 0.0)),
        ("c4", (0.0, 0.5, 0.0), (0.0, 0.0, 0.0)),
        ("c1", (0.0, 0.0, 0.5), (0.0, 0.0, 0.0)),
    ],
)
def test_a_single_wrong_pose_is_named_with_its_error_and_moves_no_other(
    name: str, degrees: tuple[float, float, float], metres: tuple[float, float, float]
) -> None:
    site = make_pair_site(5, noise_px=0.2)
    known = placements(site, **{name: moved_placement(site, name, degrees, metres)})
    poses = solve(site, known)
    assert list(poses.issues_of("moved")) == [name]
    check = poses.pose_checks[name]
    assert check.moved
    assert check.off_m == pytest.approx(np.linalg.norm(metres), abs=0.02)
    assert check.off_deg == pytest.approx(np.linalg.norm(degrees), abs=0.1)
    assert f"{check.off_m:.3f} m and {check.off_deg:.2f} degrees" in poses.issues_of("moved")[name].text
    for other in set(site.cameras) - {name}:
        C, R = known[other].C, known[other].R
        assert C is not None and R is not None
        assert np.array_equal(poses.cameras[other].C, C)
        assert np.array_equal(poses.cameras[other].R, R)
    assert np.linalg.norm(poses.cameras[name].C - site.cameras[name].C) < 0.02


def test_two_wrong_poses_are_both_named() -> None:
    site = make_pair_site(7, noise_px=0.2)
    wrong = {"c1": moved_placement(site, "c1", (0, 5, 0), (0, 0, 0)), "c4": moved_placement(site, "c4", (0, 0, 0), (1, 0, 0))}
    assert set(solve(site, placements(site, **wrong)).issues_of("moved")) == {"c1", "c4"}


def test_one_wrong_pair_does_not_make_a_camera_count_as_moved() -> None:
    site = make_pair_site(6, noise_px=0.2)
    pair = next(iter(site.geometries))
    poses = solve(replace(site, geometries=site.geometries | {pair: turned_wrong(site, pair, 0)}), placements(site))
    assert poses.source == "calibration" and not poses.issues_of("moved")
    check = poses.pair_checks["--".join(pair)]
    assert not check.kept and check.code == "matches-contradict-cameras"
    assert all(check.verified for check in poses.pose_checks.values())


@settings(max_examples=12, deadline=None, derandomize=True)
@given(count=st.integers(2, 6), seed=st.integers(0, 1000), which=st.integers(0, 100), with_right_pairs=st.booleans())
def test_a_single_wrong_pair_never_removes_or_moves_a_stated_camera(
    count: int, seed: int, which: int, with_right_pairs: bool
) -> None:
    site = make_pair_site(count, seed=seed, noise_px=0.2)
    pair = list(site.geometries)[which % len(site.geometries)]
    wrong = turned_wrong(site, pair, seed)
    site = replace(site, geometries=site.geometries | {pair: wrong} if with_right_pairs else {pair: wrong})
    known = placements(site)
    poses = solve(site, known)
    assert not poses.issues_of("moved") and not any(check.moved for check in poses.pose_checks.values())
    assert all(np.array_equal(poses.cameras[name].C, camera.C) for name, camera in site.cameras.items())
    assert all(np.array_equal(poses.cameras[name].R, camera.R) for name, camera in site.cameras.items())


def test_two_look_alike_pairs_with_different_poses_move_no_camera() -> None:
    site = make_pair_site(4, noise_px=0.2)
    wrong = {pair: turned_wrong(site, pair, k) for k, pair in enumerate(site.geometries) if "c1" in pair}
    poses = solve(replace(site, geometries=site.geometries | wrong), placements(site))
    assert not poses.issues_of("moved") and np.array_equal(poses.cameras["c1"].C, site.cameras["c1"].C)
    assert not poses.pose_checks["c1"].verified and poses.pose_checks["c3"].verified


def test_a_new_pose_without_distinctive_matches_is_not_used() -> None:
    site = make_pair_site(5, noise_px=0.2)
    repeated = {pair: replace(geometry, distinct_cells=3) for pair, geometry in site.geometries.items()}
    known = placements(site, c2=moved_placement(site, "c2", (0, 3, 0), (0.5, 0, 0)))
    assert not solve(replace(site, geometries=repeated), known).issues_of("moved")
    assert list(solve(site, known).issues_of("moved")) == ["c2"]


def rough_placements(
    site: PairSite, seed: int, metres: float, degrees: float, exact: tuple[str, ...] = ()
) -> dict[str, Placement]:
    """Poses with normally distributed errors and the standard deviations of these; those of `exact` are right."""
    rng = np.random.default_rng(seed)
    known = {}
    for name, camera in site.cameras.items():
        R = rotation_matrix(np.radians(degrees) * rng.normal(size=3)) @ camera.R
        known[name] = Placement(R, camera.C + metres * rng.normal(size=3), metres, degrees)
    return known | {name: Placement(site.cameras[name].R, site.cameras[name].C) for name in exact}


@pytest.mark.parametrize("count", [3, 6])
def test_poses_with_standard_deviations_are_refined_to_nearly_exact_ones(count: int) -> None:
    site = make_pair_site(count, noise_px=0.3)
    known = rough_placements(site, 0, 0.05, 0.3)
    poses = solve(site, known)
    assert not poses.issues_of("moved") and not poses.notes and set(poses.sources.values()) == {"refined"}
    stated = stated_cameras(site.views, known)
    before, after = (aligned_errors(replace(poses, cameras=c), site.cameras) for c in (stated, poses.cameras))
    assert after[0] < before[0] / 8 and after[1] < before[1] / 8
    assert all(check.kept and measured(check.adjusted_px) < 0.5 for check in poses.pair_checks.values())
    for name, camera in poses.cameras.items():
        assert np.linalg.norm(camera.C - stated[name].C) < 3 * 0.05 * np.sqrt(3)


def test_rough_poses_that_a_single_pair_cannot_improve_are_uncertain() -> None:
    three = make_pair_site(3, noise_px=0.3)
    two = only(three, "c0", "c1")
    known = rough_placements(three, 0, 0.05, 0.3)
    alone = solve(two, {name: known[name] for name in two.views})
    uncertain = alone.issues_of("uncertain")
    assert set(uncertain) == {"c0", "c1"} and all(1 < measured(issue.row_px) < 8 for issue in uncertain.values())
    assert not solve(three, known).issues_of("uncertain")
    exact = solve(two, {name: placement for name, placement in placements(three).items() if name in two.views})
    assert not exact.issues_of("uncertain")


def test_exact_poses_are_kept_and_rough_ones_are_refined_towards_them() -> None:
    site = make_pair_site(5, noise_px=0.3)
    poses = solve(site, rough_placements(site, 1, 0.05, 0.3, exact=("c0", "c4")))
    assert poses.sources == {"c0": "stated", "c1": "refined", "c2": "refined", "c3": "refined", "c4": "stated"}
    for name, camera in poses.cameras.items():
        assert np.linalg.norm(camera.C - site.cameras[name].C) < 0.005
    assert np.array_equal(poses.cameras["c4"].R, site.cameras["c4"].R)


def test_a_wrong_pair_does_not_affect_rough_poses() -> None:
    site = make_pair_site(5, noise_px=0.3)
    pair = ("c1", "c3")
    known = rough_placements(site, 0, 0.05, 0.3)
    wrong = solve(replace(site, geometries=site.geometries | {pair: turned_wrong(site, pair, 3)}), known)
    assert aligned_errors(wrong, site.cameras)[0] < 2e-3 and not wrong.pair_checks["c1--c3"].kept


def test_a_rough_pose_that_is_wrong_beyond_its_standard_deviation_is_named() -> None:
    site = make_pair_site(5, noise_px=0.3)
    known = rough_placements(site, 0, 0.05, 0.3)
    poses = solve(site, known | {"c2": replace(moved_placement(site, "c2", (0, 3, 0), (0.5, 0, 0)), sigma_m=0.05, sigma_deg=0.3)})
    assert list(poses.issues_of("moved")) == ["c2"] and poses.sources["c2"] == "solved"
    assert poses.pose_checks["c2"].off_deg == pytest.approx(3, abs=0.6)


def test_two_cameras_that_contradict_each_other_are_both_reported() -> None:
    site = only(make_pair_site(3, noise_px=0.2), "c0", "c1")
    known = {
        name: p
        for name, p in placements(site, c1=moved_placement(site, "c1", (5, 0, 0), (0, 0, 0))).items()
        if name in site.views
    }
    poses = solve(site, known)
    assert not poses.issues_of("moved")
    assert list(poses.issues_of("contradicted")) == ["c0", "c1"]
    note = poses.issues_of("contradicted")["c0"].text
    assert note.startswith("the known poses of c0 and c1 contradict each other by 5.0 degrees: which of them is wrong is unknown")
    assert "unverified" in note and "If one was moved, leave out its pose" in note
    assert set(poses.cameras) == {"c0", "c1"} and set(poses.sources.values()) == {"stated"}


def test_a_camera_turned_at_the_end_of_a_chain_is_unverified() -> None:
    """Only one pair contains this camera, and the matches of one pair may be look-alikes, however many there are."""
    site = make_pair_site(3, noise_px=0.2)
    chain = replace(site, geometries={pair: g for pair, g in site.geometries.items() if pair != ("c0", "c2")})
    poses = solve(chain, placements(chain, c2=moved_placement(chain, "c2", (0, 3, 0), (0, 0, 0))))
    assert not poses.issues_of("moved") and poses.sources["c2"] == "stated"
    assert not poses.pose_checks["c2"].verified and poses.pose_checks["c0"].verified
    note = poses.issues_of("contradicted")["c2"].text
    assert "contradict each other by 2.9 degrees" in note and "unverified" in note
    check = poses.pair_checks["c1--c2"]
    assert (check.kept, check.code, check.known) == (False, "matches-contradict-cameras", "stated")


def test_a_shifted_camera_in_a_chain_is_reported_as_contradicted_not_moved() -> None:
    site = make_pair_site(3, noise_px=0.2)
    chain = replace(site, geometries={pair: g for pair, g in site.geometries.items() if pair != ("c0", "c2")})
    poses = solve(chain, placements(chain, c2=moved_placement(chain, "c2", (0, 0, 0), (0.5, 0.5, 0.5))))
    assert not poses.issues_of("moved") and not poses.issues_of("unverified")
    assert "contradict each other: which of them is wrong is unknown" in poses.issues_of("contradicted")["c2"].text


def test_the_common_camera_of_all_contradictions_is_reported_as_unverified() -> None:
    site = make_pair_site(3, noise_px=0.2)
    pairs = {("c0", "c1"): site.geometries["c0", "c1"], ("c1", "c2"): turned_wrong(site, ("c1", "c2"), 8)}
    chain = replace(site, geometries=pairs)
    poses = solve(chain, placements(chain, c1=moved_placement(chain, "c1", (0, 3, 0), (0.5, 0, 0))))
    assert not poses.issues_of("moved") and poses.sources["c1"] == "stated"
    assert list(poses.issues_of("unverified")) == ["c1"] and not poses.issues_of("contradicted")
    assert poses.issues_of("unverified")["c1"].text.startswith("2 of its 2 pairs contradict its known pose by up to ")


def test_poses_that_are_all_wrong_are_contradicted_but_none_counts_as_moved() -> None:
    site = make_pair_site(5, noise_px=0.2)
    rng = np.random.default_rng(0)
    known = {name: moved_placement(site, name, tuple(rng.uniform(-5, 5, 3)), (0, 0, 0)) for name in site.cameras}
    poses = solve(site, known)
    assert not poses.issues_of("moved") and "contradict each other" in poses.issues_of("contradicted")["c0"].text


@pytest.mark.parametrize(
    ("agreeing", "contradicting", "sure"), [(1, 0, True), (2, 1, True), (1, 1, False), (2, 2, True), (2, 3, False), (0, 2, False)]
)
def test_two_agreeing_pairs_outweigh_as_many_contradicting_ones_one_does_not(
    agreeing: int, contradicting: int, sure: bool
) -> None:
    pairs = [Evidence(("gate", f"c{k}"), 0.3 if k < agreeing else 1.7, 1.0) for k in range(agreeing + contradicting)]
    assert verified({"gate"}, pairs) == sure


@pytest.mark.parametrize("seed", range(3))
def test_look_alikes_without_a_third_camera_do_not_contradict_right_poses(seed: int) -> None:
    """In two pairs of c1, seven of ten matches fit a second camera that is turned by 0.7 degrees."""
    site = make_pair_site(4, seed=seed, noise_px=0.2)
    misled = {pair: with_look_alikes(site, pair, 0.7, seed) for pair in (("c0", "c1"), ("c1", "c2"))}
    assert all(epipolar_error_px(site.cameras, pair, geometry) > PAIR_PX for pair, geometry in misled.items())
    poses = solve(replace(site, geometries=site.geometries | misled), placements(site))
    assert not poses.issues and all(check.verified for check in poses.pose_checks.values())

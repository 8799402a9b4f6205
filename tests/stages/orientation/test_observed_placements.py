"""Poses from observations are evidence beside the stated ones: for overlap, and for the poses of the night."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wbflow_stages.contracts.observation_figures import ObservedCamera
from wbflow_stages.orientation.observed_placements import with_observed
from wbflow_stages.overlap import estimate_overlap
from wbflow_stages.poses import solve_poses
from wbflow_stages.types import Geometry, Lens, ObservedPoses, Placement, Poses, Rejected, View

K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
VIEW = View(640, 480, K)
DOWN = np.array([[1.0, 0, 0], [0, -0.5, -(0.75**0.5)], [0, 0.75**0.5, -0.5]])
"""World axes to the axes of a camera that looks along +y and 30 degrees down."""


def placement(x: float, sigma_m: float = 0.02) -> Placement:
    return Placement(DOWN, np.array([x, 0.0, 5.0]), sigma_m, sigma_m / 2)


def observed(**xs: float) -> ObservedPoses:
    return ObservedPoses({name: placement(x) for name, x in xs.items()}, metric=True, scale="the survey of the drone")


def views(*names: str) -> dict[str, View]:
    return dict.fromkeys(names, VIEW)


def test_observed_poses_place_cameras_that_share_no_matches() -> None:
    poses = solve_poses(views("gate", "roof", "mast"), {}, {}, observed=observed(gate=0, roof=3, mast=6))
    assert isinstance(poses, Poses)
    assert [camera.C[0] for camera in poses.cameras.values()] == [0, 3, 6]
    assert set(poses.sources.values()) == {"observed"} and poses.metric and poses.scale == "the survey of the drone"


def test_observed_poses_tell_the_overlap() -> None:
    overlap = estimate_overlap(views("gate", "roof"), {}, {}, observed(gate=0, roof=3))
    assert overlap.source == "poses" and len(overlap.pairs) == 1


def test_an_exact_stated_pose_is_kept_and_a_rough_one_replaced() -> None:
    stated = {"gate": placement(100, 0.0), "roof": placement(200, 0.5), "mast": Placement(C=np.array([300.0, 0, 5]))}
    known = with_observed(views(*stated), stated, observed(gate=0, roof=3, mast=6))
    placed = {name: found.C[0] for name, found in known.placements.items() if found.C is not None}
    assert placed == {"gate": 100, "roof": 3, "mast": 6}
    assert known.observed == {"roof", "mast"}


def test_a_camera_that_was_not_placed_says_what_its_observations_lack() -> None:
    found = replace(observed(gate=0, roof=3), cameras={"mast": ObservedCamera(7, reason="it saw the lamp when no other did")})
    poses = solve_poses(views("gate", "roof", "mast"), {}, {}, observed=found)
    assert isinstance(poses, Poses)
    assert poses.unsolved["mast"].startswith("it saw the lamp when no other did; no pose given")


def test_views_of_a_wide_camera_are_placed_with_it() -> None:
    turn = np.array([[0.8, 0, -0.6], [0, 1, 0], [0.6, 0, 0.8]])
    view = replace(VIEW, lens=Lens(K=K, camera="dome", turn=turn))
    known = with_observed({"dome@1": view}, {}, observed(dome=2))
    R = known.placements["dome@1"].R
    assert R is not None and np.allclose(R, turn @ DOWN)


def test_a_lens_that_was_solved_with_the_poses_is_known() -> None:
    guessed = replace(VIEW, focal_known=False)
    found = replace(observed(gate=0, roof=3), focal_scales={"gate": 1.1})
    known = with_observed({"gate": guessed, "roof": guessed}, {}, found)
    gate = known.views["gate"]
    assert gate.focal_known and gate.K is not None and gate.K[0].tolist() == [pytest.approx(550), 0, 320]
    assert not known.views["roof"].focal_known


def test_without_observations_nothing_changes() -> None:
    assert isinstance(solve_poses(views("gate", "roof"), {}, {}), Rejected)


def contradicting(probability: float) -> Geometry:
    """Forty matches on rows that the observed poses contradict, with a probability of being right."""
    rng = np.random.default_rng(1)
    x1 = rng.uniform([0, 0], [640, 480], (40, 2))
    x2 = x1 + np.array([0, 25.0])
    F = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    rows = np.arange(40, dtype=np.int32)
    certain = np.ones(40, np.float32)
    along = np.array([1.0, 0, 0])
    score = float(np.log(probability / (1 - probability)))
    return Geometry(F, x1, x2, rows, rows, certain, VIEW, VIEW, np.eye(3), along, 40, 40, "E", 0.2, 20.0, 0.1, score, probability)


@pytest.mark.parametrize(("probability", "is_doubted"), [(0.8, False), (0.999, True)])
def test_only_a_very_probable_pair_contradicts_two_observed_poses(probability: float, is_doubted: bool) -> None:
    pair = contradicting(probability)
    poses = solve_poses(views("gate", "roof"), {}, {("gate", "roof"): pair}, observed=observed(gate=0, roof=3))
    assert isinstance(poses, Poses)
    assert bool(poses.issues) == is_doubted
    # the pair itself is left out in both cases
    assert not poses.pair_checks["gate--roof"].kept


def test_improbable_pairs_do_not_move_observed_cameras() -> None:
    pair = contradicting(0.8)
    poses = solve_poses(views("gate", "roof"), {}, {("gate", "roof"): pair}, observed=observed(gate=0, roof=3))
    assert isinstance(poses, Poses)
    assert [camera.C.tolist() for camera in poses.cameras.values()] == [[0, 0, 5], [3, 0, 5]]

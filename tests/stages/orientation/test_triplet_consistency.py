"""Solved cameras are reported if the matches that a third camera confirms place them elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scores import turn_errors_deg

from tests.helpers.exact_pairs import PairSite, about_vertical, make_pair_site, with_look_alikes
from wbflow_stages.orientation.triplet_consistency import MOST_INCONSISTENCY, inconsistency
from wbflow_stages.poses import solve_poses
from wbflow_stages.sfm.consistent_matches import consistent_matches
from wbflow_stages.sfm.incremental import Model, refine, replace_cameras
from wbflow_stages.sfm.tracks import Edge
from wbflow_stages.sfm.view_graph import ViewGraph
from wbflow_stages.types import Geometry, Placement, Poses


def solved(site: PairSite) -> tuple[Model, dict[Edge, Geometry]]:
    graph = ViewGraph.of(site.views, site.geometries)
    (model,) = graph.models(graph.geometries, {})
    return refine(model, rounds=3), dict(graph.geometries)


def turned(model: Model, view: int, degrees: float) -> Model:
    """The model with one camera turned."""
    return replace_cameras(model, {**model.cameras, view: about_vertical(model.cameras[view], degrees)})


def shifted(geometry: Geometry, rows: np.ndarray) -> Geometry:
    """The matches in `rows` end at the next point of the other image, as with cars in a row."""
    x2 = geometry.x2.copy()
    x2[rows] = np.roll(x2[rows], 1, axis=0)
    return replace(geometry, x2=x2)


def shorter(geometry: Geometry, count: int) -> Geometry:
    assert geometry.i1 is not None and geometry.i2 is not None
    i1, i2, probability = geometry.i1[:count], geometry.i2[:count], geometry.probability[:count]
    return replace(geometry, x1=geometry.x1[:count], x2=geometry.x2[:count], i1=i1, i2=i2, probability=probability)


@pytest.mark.parametrize("know", ["K", "hfov"])
@pytest.mark.parametrize("noise_px", [0.0, 0.2, 0.5])
def test_cameras_that_agree_with_all_matches_are_consistent(know: str, noise_px: float) -> None:
    site = make_pair_site(5, know=know, noise_px=noise_px)
    assert inconsistency(*solved(site)) < 3
    poses = solve_poses(site.views, {}, site.geometries)
    assert isinstance(poses, Poses) and not poses.issues_of("inconsistent")


@pytest.mark.parametrize("degrees", [0.1, 0.5])
def test_a_camera_turned_by_a_tenth_of_a_degree_is_inconsistent(degrees: float) -> None:
    model, geometries = solved(make_pair_site(5, noise_px=0.2))
    assert inconsistency(turned(model, 2, degrees), geometries) > MOST_INCONSISTENCY


@pytest.mark.parametrize("points", [400, 3000])
def test_small_lens_errors_are_no_inconsistency_whatever_the_number_of_matches(points: int) -> None:
    model, geometries = solved(make_pair_site(3, noise_px=0.1, points=points))
    assert inconsistency(turned(model, 2, 0.005), geometries) < 3


def test_matches_that_a_third_camera_contradicts_are_not_confirmed() -> None:
    _, geometries = solved(make_pair_site(4, noise_px=0.2))
    edge = next(iter(geometries))
    wrong = np.arange(0, len(geometries[edge].x1), 3)
    found = consistent_matches({**geometries, edge: shifted(geometries[edge], wrong)})
    kept = {tuple(x) for x in found[edge].x1}
    assert not kept & {tuple(x) for x in geometries[edge].x1[wrong]}
    assert len(kept) > 0.5 * len(geometries[edge].x1)


def test_a_triplet_with_an_empty_pair_confirms_no_matches() -> None:
    _, geometries = solved(make_pair_site(3, noise_px=0.2))
    edge = next(iter(geometries))
    found = consistent_matches({**geometries, edge: shorter(geometries[edge], 0)})
    assert all(len(geometry.x1) == 0 for geometry in found.values())
    assert sum(len(geometry.x1) for geometry in consistent_matches(geometries).values()) > 0


def test_inconsistency_is_unknown_with_only_two_cameras() -> None:
    assert np.isnan(inconsistency(*solved(make_pair_site(2, noise_px=0.2))))


@pytest.mark.parametrize("seed", range(3))
def test_cameras_stay_right_if_most_matches_of_neighbours_are_look_alikes(seed: int) -> None:
    """Seven of ten fit a next camera that is turned by 0.3 degrees: cameras solved from them are all 0.2 degrees off."""
    site = make_pair_site(5, noise_px=0.2, points=400, seed=seed)
    next_ones = [pair for pair in site.geometries if int(pair[1][1]) - int(pair[0][1]) == 1]
    misled = {pair: with_look_alikes(site, pair, 0.3, seed) for pair in next_ones}
    poses = solve_poses(site.views, {}, {**site.geometries, **misled})
    assert isinstance(poses, Poses) and set(poses.issues_of("inconsistent")) == set(site.cameras)
    assert turn_errors_deg(poses.cameras, site.cameras).max() < 0.05


@pytest.mark.parametrize("turns", [(), (1.0, 0.0, -1.0, 0.0)])
def test_a_new_camera_whose_pairs_with_known_ones_contradict_each_other_is_inconsistent(turns: tuple[float, ...]) -> None:
    site = make_pair_site(5, noise_px=0.2, points=400)
    pairs = [pair for pair in site.geometries if "c4" in pair]
    misled = {pair: with_look_alikes(site, pair, turn, 0) for pair, turn in zip(pairs, turns, strict=False)}
    known = {name: Placement(camera.R, camera.C) for name, camera in site.cameras.items() if name != "c4"}
    poses = solve_poses(site.views, known, {**site.geometries, **misled})
    assert isinstance(poses, Poses) and "c4" in poses.cameras
    assert set(poses.issues_of("inconsistent")) == ({"c4"} if turns else set())

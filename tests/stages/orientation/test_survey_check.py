"""Distances, control points and units that the cameras contradict are reported with both figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_pairs import PairSite, control_points, make_pair_site, sightings
from wbflow_stages.poses import solve_poses
from wbflow_stages.types import Placement, Poses, Survey


def solve(site: PairSite, placements: dict[str, Placement], survey: Survey) -> Poses:
    poses = solve_poses(site.views, placements, site.geometries, survey)
    assert isinstance(poses, Poses), poses
    return poses


def stated(site: PairSite, scale: float = 1.0) -> dict[str, Placement]:
    return {name: Placement(camera.R, scale * camera.C) for name, camera in site.cameras.items()}


def distance(site: PairSite, a: str, b: str) -> float:
    return float(np.linalg.norm(site.cameras[a].C - site.cameras[b].C))


@pytest.mark.parametrize("posed", [True, False])
def test_a_distance_that_contradicts_poses_or_other_distances_is_named(posed: bool) -> None:
    site = make_pair_site(5)
    names, known = tuple(site.cameras), stated(site) if posed else {}
    right = (0, 4, distance(site, "c0", "c4")), (1, 3, distance(site, "c1", "c3"))
    assert not solve(site, known, Survey(names, right)).distances_off
    wrong = (*right, (0, 2, 10 * distance(site, "c0", "c2")))
    ((pair, metres),) = solve(site, known, Survey(names, wrong)).distances_off.items()
    assert pair == "c0--c2" and metres == pytest.approx((10 * distance(site, "c0", "c2"), distance(site, "c0", "c2")))


def test_a_control_point_that_contradicts_stated_poses_is_named() -> None:
    site = make_pair_site(5)
    survey = Survey(tuple(site.cameras), points=control_points(site.X[:3]), observations=sightings(site, 3))
    assert not solve(site, stated(site), survey).points_off
    X = site.X[:3].copy()
    X[1] += [0.0, 0.0, 2.0]
    ((name, (off, tolerated)),) = solve(site, stated(site), replace(survey, points=control_points(X))).points_off.items()
    assert name == "control point 2" and off == pytest.approx(2, abs=0.01) and tolerated < 1


def test_positions_in_wrong_units_are_reported_unless_a_crs_is_given() -> None:
    site = make_pair_site(5)
    assert not solve(site, stated(site), Survey()).units_off
    nearest, limit = solve(site, stated(site, 1000), Survey()).units_off["nearest"]
    assert nearest > limit == 1000
    nearest, limit = solve(site, stated(site, 0.001), Survey()).units_off["nearest"]
    assert nearest < limit == 0.05
    assert not solve(site, stated(site, 1000), replace(Survey(), crs="EPSG:32632")).units_off

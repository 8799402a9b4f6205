"""Unstated lenses: their standard deviations are known, and those that the images do not determine are reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_pairs import PairSite, make_pair_site
from tests.helpers.measured import measured
from wbflow_stages.orientation.lens_sigma import MOST_SIGMA_PX, MOST_VIEWS, lens_sigmas, with_principal_points
from wbflow_stages.poses import solve_poses
from wbflow_stages.sfm.incremental import Model, refine
from wbflow_stages.sfm.view_graph import ViewGraph
from wbflow_stages.types import Poses

FOCAL = 800.0
CERTAIN = 1e-6


def solve(site: PairSite) -> Poses:
    poses = solve_poses(site.views, {}, site.geometries)
    assert isinstance(poses, Poses), poses
    return poses


def adjusted(site: PairSite) -> Model:
    graph = ViewGraph.of(site.views, site.geometries)
    (model,) = graph.models(graph.geometries, {})
    return refine(model, rounds=3)


def test_a_lens_that_well_spread_points_determine_is_not_reported() -> None:
    assert not solve(make_pair_site(6, know="nothing", noise_px=0.2, radius=7)).issues_of("lens-undetermined")


def test_a_lens_without_points_near_its_border_is_reported_as_undetermined() -> None:
    poses = solve(make_pair_site(6, know="nothing", noise_px=0.2, radius=24))
    assert set(poses.issues_of("lens-undetermined")) == set(poses.cameras)
    for sigma in poses.issues_of("lens-undetermined").values():
        assert measured(sigma.border_px) > 3 * MOST_SIGMA_PX and measured(sigma.focal) > 0.005


def test_two_cameras_alone_do_not_determine_their_lens() -> None:
    poses = solve(make_pair_site(2, know="nothing", noise_px=0.2))
    assert set(poses.issues_of("lens-undetermined")) == {"c0", "c1"}


def test_a_stated_lens_is_never_reported_as_undetermined() -> None:
    assert not solve(make_pair_site(2, know="K", noise_px=0.2, radius=24)).issues_of("lens-undetermined")


def test_focal_length_errors_agree_with_their_standard_deviations() -> None:
    normalised_errors = []
    for seed in range(8):
        model = adjusted(make_pair_site(5, know="hfov", noise_px=0.3, points=120, seed=seed, focal=FOCAL))
        sigma = lens_sigmas(model, centre_sigma=CERTAIN)
        normalised_errors.append((model.cameras[0].K[0, 0] / FOCAL - 1) / sigma[0].focal)
    assert 0.5 < np.sqrt(np.mean(np.square(normalised_errors))) < 2


def test_a_shifted_principal_point_is_approximately_recovered() -> None:
    model = adjusted(make_pair_site(6, know="hfov", noise_px=0.05, points=120, focal=FOCAL))
    shift = np.array([4.0, -3.0])  # of all observations, as by a shifted principal point
    seen = refine(replace(model, tracks=replace(model.tracks, xy=model.tracks.xy + shift)), rounds=3)
    found = with_principal_points(seen).cameras[0].K[:2, 2] - model.cameras[0].K[:2, 2]
    assert np.linalg.norm(found - shift) < 0.4 * np.linalg.norm(shift)


def test_uncertain_principal_points_increase_the_uncertainty_of_a_lens() -> None:
    model = adjusted(make_pair_site(5, know="hfov", noise_px=0.3, focal=FOCAL))
    exact, unsure = lens_sigmas(model, centre_sigma=CERTAIN), lens_sigmas(model)
    assert all(unsure[view].border_px > exact[view].border_px for view in model.cameras)


def test_twice_the_noise_doubles_the_uncertainty_of_a_lens() -> None:
    one, two = (adjusted(make_pair_site(5, know="hfov", noise_px=noise, focal=FOCAL)) for noise in (0.15, 0.3))
    ratio = lens_sigmas(two, CERTAIN)[0].border_px / lens_sigmas(one, CERTAIN)[0].border_px
    assert ratio == pytest.approx(2, rel=0.3)


def test_known_lenses_and_very_many_cameras_get_no_lens_sigmas() -> None:
    model = adjusted(make_pair_site(3, know="hfov", noise_px=0.3, focal=FOCAL))
    assert not lens_sigmas(replace(model, lenses={}))
    camera = model.cameras[0]
    assert not lens_sigmas(replace(model, cameras=dict.fromkeys(range(MOST_VIEWS + 1), camera)))


def test_correlated_errors_give_more_uncertainty_than_independent_ones() -> None:
    """As with sky mirrored by wet ground: every second camera sees two quarters of the scene one pixel lower."""
    model = adjusted(make_pair_site(6, know="hfov", noise_px=0.2, focal=FOCAL, points=1200))
    tracks, rng = model.tracks, np.random.default_rng(0)
    X = model.X[tracks.track]
    second = np.flatnonzero(tracks.view % 2 == 1)
    right, upper = (X[second, axis] > np.nanmedian(X[:, axis]) for axis in (0, 1))
    together = right ^ upper
    alone = rng.permutation(together)
    open_px = []
    for lower in (together, alone):
        xy = tracks.xy.copy()
        xy[second[lower], 1] += 1.0
        wrong = refine(replace(model, tracks=replace(tracks, xy=xy)), rounds=3)
        open_px.append(np.median([sigma.border_px for sigma in lens_sigmas(wrong, CERTAIN).values()]))
    assert open_px[0] > 1.2 * open_px[1]

"""Solved cameras that the matches which a third camera confirms would have elsewhere are known for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_pairs import PairSite, make_pair_site
from wbflow_stages.poses import solve_poses
from wbflow_stages.sfm.confirmed import MOST_STRAIN, confirmed_matches, strain
from wbflow_stages.sfm.incremental import Model, refine, replace_cameras
from wbflow_stages.sfm.tracks import Edge
from wbflow_stages.sfm.view_graph import ViewGraph
from wbflow_stages.types import Geometry, Poses


def solved(site: PairSite) -> tuple[Model, dict[Edge, Geometry]]:
    graph = ViewGraph.of(site.views, site.geometries)
    (model,) = graph.models(list(graph.geometries), {})
    return refine(model, rounds=3), dict(graph.geometries)


def turned(model: Model, view: int, degrees: float) -> Model:
    """The model with one camera turned about the vertical axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    camera = model.cameras[view]
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return replace_cameras(model, {**model.cameras, view: replace(camera, R=camera.R @ turn)})


def shifted(geometry: Geometry, rows: np.ndarray) -> Geometry:
    """Some points matched with the next ones in the other picture, as cars of a row are."""
    x2 = geometry.x2.copy()
    x2[rows] = np.roll(x2[rows], 1, axis=0)
    return replace(geometry, x2=x2)


@pytest.mark.parametrize("know", ["K", "hfov"])
@pytest.mark.parametrize("noise_px", [0.0, 0.2, 0.5])
def test_cameras_that_all_matches_agree_on_are_under_no_strain(know: str, noise_px: float) -> None:
    site = make_pair_site(5, know=know, noise_px=noise_px)
    assert strain(*solved(site)) < 3
    poses = solve_poses(site.views, {}, site.geometries)
    assert isinstance(poses, Poses) and not poses.strained


@pytest.mark.parametrize("degrees", [0.1, 0.5])
def test_a_camera_a_tenth_of_a_degree_off_is(degrees: float) -> None:
    model, geometries = solved(make_pair_site(5, noise_px=0.2))
    assert strain(turned(model, 2, degrees), geometries) > MOST_STRAIN


def test_matches_that_end_elsewhere_over_a_third_camera_are_not_confirmed() -> None:
    _, geometries = solved(make_pair_site(4, noise_px=0.2))
    edge = next(iter(geometries))
    wrong = np.arange(0, len(geometries[edge].x1), 3)
    found = confirmed_matches({**geometries, edge: shifted(geometries[edge], wrong)})
    kept = {tuple(x) for x in found[edge].x1}
    assert not kept & {tuple(x) for x in geometries[edge].x1[wrong]}
    assert len(kept) > 0.5 * len(geometries[edge].x1)


def test_without_three_cameras_that_share_matches_nothing_is_told() -> None:
    assert np.isnan(strain(*solved(make_pair_site(2, noise_px=0.2))))

"""Cameras that the pairs which see most contradict are taken out of a model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.helpers.exact_pairs import PairSite, make_pair_site, turned_wrong
from wbflow_stages.sfm.incremental import Model, grow
from wbflow_stages.sfm.support import straight_error_px, without_unsupported
from wbflow_stages.sfm.tracks import Edge, build_tracks
from wbflow_stages.types import Geometry


def solved(site: PairSite) -> tuple[Model, dict[Edge, Geometry]]:
    """The model of a site's right pairs, by number."""
    number = {name: k for k, name in enumerate(site.cameras)}
    edges = {(number[a], number[b]): geometry for (a, b), geometry in site.geometries.items()}
    model = grow({number[name]: camera for name, camera in site.cameras.items()}, build_tracks(edges, len(number)), edges)
    assert model is not None and len(model.cameras) == len(number)
    return model, edges


def test_a_model_that_its_pairs_agree_with_keeps_all_cameras() -> None:
    model, edges = solved(make_pair_site(4))
    kept, out = without_unsupported(model, edges, 2.0)
    assert kept is model and out == []
    assert all(straight_error_px(model.cameras[i], model.cameras[j], g) < 0.01 for (i, j), g in edges.items())


def test_a_camera_that_its_strongest_pair_contradicts_is_taken_out_and_no_other() -> None:
    site = make_pair_site(4)
    model, edges = solved(site)
    wrong = turned_wrong(site, ("c1", "c3"), seed=3)
    believed = {edge: g for edge, g in edges.items() if edge not in ((0, 3), (2, 3))}
    believed[0, 3] = replace(edges[0, 3], inliers=20)
    believed[1, 3] = replace(wrong, inliers=500)
    kept, out = without_unsupported(model, believed, 2.0)
    assert out == [3]
    assert set(kept.cameras) == {0, 1, 2} and not (kept.use & (kept.tracks.view == 3)).any()
    assert np.isfinite(kept.error_px()[kept.use]).all()


def test_known_cameras_stay() -> None:
    site = make_pair_site(3)
    model, edges = solved(site)
    believed = {edge: turned_wrong(site, (f"c{edge[0]}", f"c{edge[1]}"), seed=k) for k, edge in enumerate(edges)}
    kept, out = without_unsupported(replace(model, held=(0, 1, 2)), believed, 2.0)
    assert out == [] and set(kept.cameras) == {0, 1, 2}

"""Depths of other views serve as candidate planes, on a yard whose depth is known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_scene import Yard, make_yard, true_depth
from wbflow_stages.fusion.pair_depth import inverse_depth_slopes
from wbflow_stages.mvs.transferred import transferred_planes
from wbflow_stages.refine import refine
from wbflow_stages.types import DepthMap


@pytest.fixture(scope="module")
def yard() -> Yard:
    return make_yard((-24, -8, 8, 24))


def exact(yard: Yard, name: str) -> DepthMap:
    """The true depth, as if it came from pairs."""
    z = true_depth(yard.cameras[name]).astype(np.float32)
    slope_x, slope_y = inverse_depth_slopes(z, 500.0)
    return replace(yard.depths()[name], depth=z, slope_x=slope_x, slope_y=slope_y)


def test_the_surface_of_one_view_becomes_candidate_planes_of_another(yard: Yard) -> None:
    name, other = list(yard.cameras)[:2]
    planes = transferred_planes(yard.cameras[name], yard.cameras, {other: exact(yard, other)})
    error = np.abs(1 / planes[0] / true_depth(yard.cameras[name]) - 1)
    known = np.isfinite(planes[0])
    assert known.mean() > 0.5
    assert np.median(error[known]) < 1e-3
    assert (error[known] < 0.01).mean() > 0.95


def test_a_view_in_another_component_gives_no_candidate_planes(yard: Yard) -> None:
    name, other = list(yard.cameras)[:2]
    elsewhere = replace(yard.cameras[other], component=1)
    assert np.isnan(transferred_planes(yard.cameras[name], {other: elsewhere}, {other: exact(yard, other)})).all()


def test_depth_that_only_other_views_have_is_found(yard: Yard) -> None:
    """The view's own depth is a stripe of 12 columns at its left border: alone, planes would have to spread from there."""
    name, depths = list(yard.cameras)[1], yard.depths()
    others = {n: camera for n, camera in yard.cameras.items() if n != name}
    known = depths[name].depth.copy()
    known[:, 12:] = np.nan
    stripe = replace(depths[name], depth=known, sure=np.isfinite(known))
    inputs = yard.frames[name], yard.cameras[name], stripe, yard.frames, others
    accuracy = []
    for other_depths in (None, {n: depths[n] for n in others}):
        found = refine(*inputs, depths=other_depths, sweeps=1)
        assert isinstance(found, DepthMap)
        accuracy.append(np.mean(np.abs(found.depth / true_depth(yard.cameras[name]) - 1) < 0.01))
    assert accuracy[1] > accuracy[0] + 0.1


def test_wrong_depths_of_other_views_do_no_harm(yard: Yard) -> None:
    name, depths = list(yard.cameras)[1], yard.depths()
    others = {n: camera for n, camera in yard.cameras.items() if n != name}
    inputs = yard.frames[name], yard.cameras[name], depths[name], yard.frames, others
    wrong = {n: replace(depths[n], depth=np.float32(1.2) * depths[n].depth) for n in others}
    with_them, without = refine(*inputs, depths=wrong), refine(*inputs)
    assert isinstance(with_them, DepthMap) and isinstance(without, DepthMap)
    truth = true_depth(yard.cameras[name])
    accuracy = [np.mean(np.abs(found.depth / truth - 1) < 0.01) for found in (with_them, without)]
    assert accuracy[0] > accuracy[1] - 0.005

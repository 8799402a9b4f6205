"""A depth has little support where its surroundings are unknown or lie on another surface."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.fusion.pair_depth import inverse_depth_slopes
from wbflow_stages.fusion.surface_support import surface_support
from wbflow_stages.types import Bools, DepthMap, Float32s


def slope() -> Float32s:
    """Depth (80, 120) of sloping ground, 10 m in the first row to 20 m in the last."""
    return np.repeat(1 / np.linspace(0.1, 0.05, 80)[:, None], 120, axis=1).astype(np.float32)


def depth_map(depth: Float32s) -> DepthMap:
    slopes = inverse_depth_slopes(slope(), 100.0)
    shape = depth.shape
    return DepthMap(depth, 0.0005 * depth, *slopes, np.ones(shape, np.uint32), ("other",), np.ones(shape, np.bool_))


def support_of(depth: Float32s, usable: Bools | None = None) -> Float32s:
    return surface_support(depth_map(depth), np.isfinite(depth) if usable is None else usable)


def test_a_pixel_on_a_slope_has_support_and_an_outlier_has_none() -> None:
    depth = slope()
    depth[40, 60] *= 1.05
    share = support_of(depth)
    assert share[40, 60] == 0 and share[40, 70] > 0.95


@pytest.mark.parametrize("kept", [0.1, 0.5])
def test_support_of_sparse_pixels_is_about_their_density(kept: float) -> None:
    known = np.random.default_rng(0).uniform(size=slope().shape) < kept
    share = support_of(slope(), known)
    assert share[known].mean() == pytest.approx(kept, rel=0.25)
    assert (share[~known] == 0).all()


def test_neighbours_give_support_in_proportion_to_their_weight() -> None:
    """A pixel in the middle of a patch of weight 0 has no support, one at its rim has some."""
    weight = np.ones(slope().shape, np.float32)
    weight[20:60, 40:80] = 0
    known = np.ones(slope().shape, np.bool_)
    share = surface_support(depth_map(slope()), known, weight)
    assert share[40, 60] == 0 and share[40, 40] > 0.3 and share[10, 20] > 0.95
    off_surface = slope()
    off_surface[weight > 0] *= 1.05
    assert (surface_support(depth_map(off_surface), known, weight)[25:55, 45:75] == 0).all()

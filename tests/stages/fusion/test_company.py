"""A depth stands alone where its surroundings are unknown, or lie elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.fusion.company import company
from wbflow_stages.fusion.pair_depth import inverse_depth_slopes
from wbflow_stages.types import Bools, DepthMap, Float32s


def slope() -> Float32s:
    """Depth (80, 120) of ground that falls away, 10 to 20 m."""
    return np.repeat(1 / np.linspace(0.1, 0.05, 80)[:, None], 120, axis=1).astype(np.float32)


def company_of(depth: Float32s, believed: Bools | None = None, asked: Bools | None = None) -> Float32s:
    shape = depth.shape
    believed = np.isfinite(depth) if believed is None else believed
    slopes = inverse_depth_slopes(slope(), 100.0)
    found = DepthMap(depth, 0.0005 * depth, *slopes, np.ones(shape, np.uint32), ("other",), np.ones(shape, np.bool_))
    return company(found, believed, believed if asked is None else asked)


def test_a_slope_is_in_company_and_a_pixel_off_it_is_not() -> None:
    depth = slope()
    depth[40, 60] *= 1.05
    share = company_of(depth)
    assert share[40, 60] == 0 and share[40, 70] > 0.95


@pytest.mark.parametrize("kept", [0.1, 0.5])
def test_sparse_specks_have_as_much_company_as_there_are_of_them(kept: float) -> None:
    known = np.random.default_rng(0).uniform(size=slope().shape) < kept
    share = company_of(slope(), known)
    assert share[known].mean() == pytest.approx(kept, rel=0.25)
    assert (share[~known] == 0).all()


def test_a_pixel_that_is_not_believed_is_in_the_company_of_those_that_are() -> None:
    asked = np.ones(slope().shape, np.bool_)
    believed = asked.copy()
    believed[30:50, 50:70] = False
    share = company_of(slope(), believed, asked)
    assert share[40, 51] > 0.3 and share[40, 60] == 0

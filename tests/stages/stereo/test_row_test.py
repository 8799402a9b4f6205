"""Right rows match, wrong rows don't, and rows that are a little off say by how much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.dots import stereo_pair
from wbflow_stages.stereo.matcher import RectifiedPair
from wbflow_stages.stereo.row_test import row_test


@pytest.fixture(scope="module")
def pair() -> RectifiedPair:
    left, right = stereo_pair(320, 448)
    usable = np.ones(left.shape, dtype=np.bool_)
    return RectifiedPair(left, right, usable, usable, 10, 60)


def test_right_rows_are_confirmed(pair: RectifiedPair) -> None:
    rows, disparity, confidence = row_test(pair)
    assert rows.passed(0.3, 4.0)
    assert abs(rows.row_error_px) < 0.5
    assert np.isfinite(disparity).mean() > 0.3
    assert disparity.shape == confidence.shape


@pytest.mark.parametrize("shift", [2, -2])
def test_rows_off_by_two_are_said_to_be(pair: RectifiedPair, shift: int) -> None:
    rows, *_ = row_test(replace(pair, right=np.roll(pair.right, shift, axis=0)))
    assert np.sign(rows.row_error_px) == -np.sign(shift)


def test_rows_of_another_picture_are_not_confirmed(pair: RectifiedPair) -> None:
    other = np.random.default_rng(5).permuted(pair.right, axis=0)
    rows, *_ = row_test(replace(pair, right=other))
    assert not rows.passed(0.01, 2.0)

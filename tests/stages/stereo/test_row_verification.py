"""Right rows are confirmed, wrong rows are not, and the error of rows that are slightly off is measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.dots import stereo_pair
from wbflow_stages.stereo.matcher import RectifiedPair
from wbflow_stages.stereo.row_verification import match_rows


@pytest.fixture(scope="module")
def pair() -> RectifiedPair:
    left, right = stereo_pair(320, 448)
    usable = np.ones(left.shape, dtype=np.bool_)
    return RectifiedPair(left, right, usable, usable, 10, 60)


def test_right_rows_are_confirmed(pair: RectifiedPair) -> None:
    rows, disparity, confidence = match_rows(pair)
    assert rows.confirmed and rows.share >= max(0.3, 4.0 * rows.chance)
    assert abs(rows.row_error_px) < 0.5
    assert np.isfinite(disparity).mean() > 0.3
    assert disparity.shape == confidence.shape


@pytest.mark.parametrize("shift", [2, -2])
def test_the_sign_of_a_two_row_offset_is_reported(pair: RectifiedPair, shift: int) -> None:
    rows, *_ = match_rows(replace(pair, right=np.roll(pair.right, shift, axis=0)))
    assert np.sign(rows.row_error_px) == -np.sign(shift)


def test_rows_of_another_picture_are_not_confirmed(pair: RectifiedPair) -> None:
    other = np.random.default_rng(5).permuted(pair.right, axis=0)
    rows, *_ = match_rows(replace(pair, right=other))
    assert not rows.confirmed


def test_a_small_usable_part_of_a_picture_is_enough_to_confirm_rows() -> None:
    left, right = stereo_pair(180, 320)
    usable = np.zeros(left.shape, dtype=np.bool_)
    usable[60:120, 140:] = True
    rows, *_ = match_rows(RectifiedPair(left, right, usable, np.ones_like(usable), 10, 40))
    assert rows.confirmed


def pavement() -> RectifiedPair:
    """The same stones repeat eight rows further down, 20 pixels to the right: they match there, too, at a wrong disparity."""
    rng = np.random.default_rng(1)
    stones = rng.uniform(30, 220, (8, 600)).astype(np.float32)
    left = np.concatenate([np.roll(stones, 20 * course, axis=1) for course in range(40)])
    right = np.roll(left, -30, axis=1)
    usable = np.ones(left.shape, dtype=np.bool_)
    ground = np.full(left.shape, 30, np.float32)
    return RectifiedPair(left, right, usable, usable, 0, 70, ground, ground)


def test_repeating_stones_confirm_rows_where_the_ground_is_known() -> None:
    rows, *_ = match_rows(pavement())
    assert rows.share > 0.3 and not rows.cells.confirms_rows
    assert rows.on_ground is not None and rows.on_ground.confirms_rows


def test_repeating_stones_do_not_confirm_wrong_rows() -> None:
    right = pavement()
    wrong, *_ = match_rows(replace(right, right=np.roll(right.right, 8, axis=0)))
    assert wrong.share > 0.3 and not wrong.confirmed


@pytest.fixture(scope="module")
def partly_striped(pair: RectifiedPair) -> RectifiedPair:
    """The left part of the image has vertical stripes, and matches on any rows."""
    right = pair.right.copy()
    left = pair.left.copy()
    stripes = np.random.default_rng(3).uniform(30, 220, (1, left.shape[1])).astype(np.float32)
    left[:, :300] = stripes[:, :300]
    right[:, :270] = stripes[:, 30:300]
    return replace(pair, left=left, right=right)


def test_stripes_that_match_on_any_rows_do_not_outvote_the_rest(partly_striped: RectifiedPair) -> None:
    rows, *_ = match_rows(partly_striped)
    assert rows.chance > 0.3 and rows.share < 2.0 * rows.chance  # stripes match on all rows
    assert rows.confirmed
    wrong, *_ = match_rows(replace(partly_striped, right=np.roll(partly_striped.right, 31, axis=0)))
    assert not wrong.confirmed

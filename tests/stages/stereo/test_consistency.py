"""Raw disparity is kept where both views agree and the partner is a valid pixel; speckles are removed, holes filled."""

from __future__ import annotations

import numpy as np

from wbflow_stages.stereo.consistency import agreeing, disagreement, fill_along_rows, lands_on, without_speckles
from wbflow_stages.stereo.matcher import RectifiedPair, mirrored

NAN = np.float32(np.nan)


def constant(value: float | np.float32, shape: tuple[int, int] = (6, 40)) -> np.ndarray:
    return np.full(shape, value, dtype=np.float32)


def test_disparities_that_point_at_each_other_have_no_disagreement() -> None:
    left, right = constant(5), constant(5)
    np.testing.assert_array_equal(disagreement(left, right, -1)[:, 5:], 0)
    assert np.isinf(disagreement(left, right, -1)[:, :5]).all()  # these point out of the right image
    np.testing.assert_array_equal(disagreement(right, left, 1)[:, :35], 0)


def test_disagreement_is_measured_at_the_pixel_that_is_pointed_to() -> None:
    left, right = constant(5), constant(5)
    right[2, 10] = 7.5
    assert disagreement(left, right, -1)[2, 15] == 2.5
    right[2, 10] = NAN
    assert np.isinf(disagreement(left, right, -1)[2, 15])


def test_pixels_at_a_jump_must_agree_more_closely_than_pixels_on_flat_areas() -> None:
    left, right = constant(5, (12, 40)), constant(6, (12, 40))
    assert agreeing(left, right, -1, 2.0)[:, 15:].all()
    left[6:], right[6:] = 12, 13
    kept = agreeing(left, right, -1, 2.0)
    assert not kept[4:8, 15:].any()
    assert kept[:4, 15:].all() and kept[8:, 15:].all()


def test_disparities_that_point_to_invalid_pixels_are_detected() -> None:
    valid = np.ones((6, 40), dtype=bool)
    valid[3, 10] = False
    landed = lands_on(valid, constant(5), -1)
    assert not landed[3, 15] and landed[3, 16] and landed[2, 15]
    assert not landed[:, :5].any()


def test_speckles_are_removed_and_steep_ground_is_kept() -> None:
    disparity = constant(NAN, (40, 60))
    disparity[2:5, 2:5] = 9
    rows = np.arange(10, 40, dtype=np.float32)
    disparity[10:, :] = (3.3 * rows)[:, None]  # 3.3 pixels per row: ground seen at a low angle
    kept = without_speckles(disparity, 20)
    assert np.isnan(kept[2:5, 2:5]).all()
    np.testing.assert_array_equal(kept[10:], disparity[10:])
    np.testing.assert_array_equal(without_speckles(disparity, 9), disparity)


def test_a_disparity_jump_along_a_row_separates_pieces() -> None:
    disparity = constant(5, (4, 40))
    disparity[:, 20:] = 8
    assert np.isnan(without_speckles(disparity, 81)).all()
    assert not np.isnan(without_speckles(disparity, 80)).any()


def test_a_hole_is_filled_with_the_farther_neighbour() -> None:
    row = np.array([[NAN, 4, NAN, NAN, 9, NAN]], dtype=np.float32)
    np.testing.assert_array_equal(fill_along_rows(row, 1), [[4, 4, 4, 4, 9, 9]])
    np.testing.assert_array_equal(fill_along_rows(row, -1), [[4, 4, 9, 9, 9, 9]])
    assert np.isnan(fill_along_rows(np.full((1, 3), NAN), 1)).all()


def test_pixels_without_a_valid_partner_in_the_range_are_out_of_reach() -> None:
    valid = np.ones((1, 20), dtype=bool)
    other = np.zeros((1, 20), dtype=bool)
    other[0, 5] = True
    grey = np.zeros((1, 20), np.float32)
    reach = RectifiedPair(grey, grey, valid, other, 2, 4).matchable_pixels()
    np.testing.assert_array_equal(np.flatnonzero(reach[0]), [7, 8, 9])
    reach = mirrored(RectifiedPair(grey, grey, other, valid, 2, 4)).matchable_pixels()[:, ::-1]
    np.testing.assert_array_equal(np.flatnonzero(reach[0]), [1, 2, 3])

"""Row offsets of a fraction of a pixel are measured from the images alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.helpers.dots import as_they_are, frame_of, stereo_pair, texture, true_disparity
from wbflow_stages.disparity import match_dense
from wbflow_stages.stereo.matcher import RectifiedPair
from wbflow_stages.stereo.y_parallax import measure_y_parallax
from wbflow_stages.types import Disparity, RowMatches


def rows_of(left: np.ndarray, right: np.ndarray) -> RowMatches:
    truth = true_disparity(*left.shape)
    found = match_dense(frame_of(left), frame_of(right), as_they_are(left, right, float(truth.min() - 3), float(truth.max() + 3)))
    assert isinstance(found, Disparity) and found.rows is not None
    return found.rows


@pytest.mark.parametrize("lower", [0.0, 0.1, 0.3, -0.2])
def test_a_shift_by_a_fraction_of_a_row_is_measured(lower: float) -> None:
    left, right = stereo_pair()
    y, x = np.mgrid[: right.shape[0], : right.shape[1]].astype(np.float32)
    shifted = cv2.remap(right, x, y - np.float32(lower), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    found = rows_of(left, shifted)
    row_offset = found.x2[:, 1] - found.x1[:, 1]
    assert len(row_offset) > 20
    # partners nearer to the row are found more often
    assert np.median(row_offset) == pytest.approx(lower, abs=0.01 + 0.1 * abs(lower))
    assert np.mean(np.abs(row_offset - lower) <= 3 * found.sigma_px) > 0.95


def test_row_matches_agree_with_the_true_disparity() -> None:
    left, right = stereo_pair()
    found = rows_of(left, right)
    at = np.rint(found.x1).astype(int)
    truth = true_disparity(*left.shape)[at[:, 1], at[:, 0]]
    assert np.median(np.abs(found.x1[:, 0] - found.x2[:, 0] - truth)) < 0.2


def test_unrelated_pictures_give_almost_no_row_matches() -> None:
    left, _ = stereo_pair()
    found = match_dense(
        frame_of(left), frame_of(texture(left.shape[0], left.shape[1], seed=9)), as_they_are(left, left, 0.0, 40.0)
    )
    assert not isinstance(found, Disparity) or found.rows is None or len(found.rows.x1) <= 3


def test_a_strip_of_few_rows_gives_no_row_matches() -> None:
    strip = np.full((5, 40), 9.0, np.float32)
    valid = np.ones(strip.shape, dtype=bool)
    x1, x2, sigma_px = measure_y_parallax(RectifiedPair(strip, strip, valid, valid, 0, 3), np.zeros_like(strip), 10.0)
    assert len(x1) == len(x2) == len(sigma_px) == 0

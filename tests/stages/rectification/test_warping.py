"""Points and images are mapped to the rectified image and back, by homographies and by polar rows."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wbflow_stages.rectification.warping import disparity_px, from_rectified, resampling, to_rectified, warp, warp_with_mask
from wbflow_stages.types import INVALID, Disparity, PolarRows, Rectification

SIDES: tuple[Literal[1, 2], ...] = (1, 2)


def planar() -> Rectification:
    H1 = np.array([[1.1, 0.1, 20.0], [-0.05, 0.95, 8.0], [1e-4, -2e-5, 1.0]])
    H2 = np.array([[0.9, -0.2, 30.0], [0.1, 1.05, 4.0], [-1e-4, 3e-5, 1.0]])
    return Rectification("hartley", "", H1, H2, (240, 200), (230, 200), 0.0, 10.0, 0.0, 0.0, 10.0)


def polar(direction: int = 1) -> Rectification:
    angles = np.linspace(-0.6, 0.7, 200)[::direction]
    rows1 = PolarRows(np.array([-60.0, 70.0]), angles, direction, 50.0 if direction > 0 else -300.0)
    rows2 = PolarRows(np.array([-90.0, 60.0]), angles**3 + angles, direction, 80.0 if direction > 0 else -320.0)
    return Rectification("polar", "", None, None, (240, 200), (230, 200), 0.0, 10.0, 0.0, 0.0, 10.0, rows1, rows2)


@pytest.mark.parametrize("rectification", [planar(), polar(1), polar(-1)], ids=["planar", "polar", "polar leftward"])
@given(x=st.floats(0, 200), y=st.floats(0, 150))
def test_mapping_a_point_to_the_rectified_image_and_back_is_exact(rectification: Rectification, x: float, y: float) -> None:
    point = np.array([[x, y]])
    for side in SIDES:
        there = to_rectified(rectification, side, point)
        assert np.abs(from_rectified(rectification, side, there) - point).max() < 1e-8


@pytest.mark.parametrize("rectification", [planar(), polar(1), polar(-1)], ids=["planar", "polar", "polar leftward"])
def test_area_and_axes_of_a_resampled_pixel_agree_with_mapped_small_shapes(
    rectification: Rectification,
) -> None:
    points = np.random.default_rng(0).uniform([0, 0], [200, 150], (10, 2))
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    circle = 0.1 * np.column_stack([np.cos(turn), np.sin(turn)])
    for side in SIDES:
        area, longer, shorter = resampling(rectification, side, points)
        for k, point in enumerate(points):
            reach = np.hypot(
                *(to_rectified(rectification, side, point + circle) - to_rectified(rectification, side, point[None])).T
            )
            assert reach.max() / 0.1 == pytest.approx(longer[k], rel=0.02)
            assert reach.min() / 0.1 == pytest.approx(shorter[k], rel=0.02)
            (a, c), (b, d) = to_rectified(rectification, side, point + 0.1 * np.eye(2)) - to_rectified(
                rectification, side, point[None]
            )
            assert (a * d - b * c) / 0.01 == pytest.approx(area[k], rel=0.02)


@pytest.mark.parametrize("rectification", [planar(), polar(1), polar(-1)], ids=["planar", "polar", "polar leftward"])
def test_a_warped_image_shows_the_pixels_of_its_source(rectification: Rectification) -> None:
    y, x = np.mgrid[0:150, 0:200].astype(np.float32)
    image = np.dstack([2 * x + y, x - 3 * y, 0 * x + 7]).astype(np.float32)  # linear in x and y: interpolation is exact
    for side in SIDES:
        warped, valid = warp_with_mask(rectification, side, image, np.ones((150, 200), dtype=bool))
        assert np.array_equal(warped, warp(rectification, side, image))
        assert valid.mean() > 0.2
        rows, columns = np.nonzero(valid)
        source = from_rectified(rectification, side, np.column_stack([columns, rows]).astype(np.float64))
        assert source.min() > -0.1
        assert np.abs(warped[valid][:, 0] - (2 * source[:, 0] + source[:, 1])).max() < 0.1
        assert np.abs(warped[valid][:, 1] - (source[:, 0] - 3 * source[:, 1])).max() < 0.1


def test_a_masked_pixel_invalidates_the_rectified_pixels_that_it_touches() -> None:
    mask = np.ones((150, 200), dtype=bool)
    mask[70, 90] = False
    rectification = planar()
    x, y = to_rectified(rectification, 1, np.array([[90.0, 70.0]]))[0]
    _, valid = warp_with_mask(rectification, 1, mask.astype(np.uint8), mask)
    assert not valid[round(y), round(x)]
    assert valid[round(y) - 4, round(x)]


def test_disparity_is_stored_in_sixteenths_of_a_pixel_with_an_offset() -> None:
    left = np.array([[16, 8, INVALID]], dtype=np.int16)
    right = np.array([[-16, INVALID, 0]], dtype=np.int16)
    confidence = np.zeros((1, 3), dtype=np.uint8)
    disparity = Disparity(left, right, confidence, confidence, 100, 0.5)
    np.testing.assert_array_equal(disparity_px(disparity, 1), np.array([[101.0, 100.5, np.nan]], dtype=np.float32))
    np.testing.assert_array_equal(disparity_px(disparity, 2), np.array([[99.0, np.nan, 100.0]], dtype=np.float32))


def test_a_rectification_without_homographies_or_polar_rows_is_refused() -> None:
    broken = Rectification("hartley", "", None, None, (10, 10), (10, 10), 0.0, 10.0, 0.0, 0.0, 10.0)
    with pytest.raises(ValueError, match="homography or polar"):
        to_rectified(broken, 1, np.zeros((1, 2)))

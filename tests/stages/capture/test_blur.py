"""Blur and lack of detail are measured in pixels, whatever a picture shows and however dark or noisy it is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.helpers.synthetic_site import small_yard
from wbflow_stages.capture.image_statistics import blur_px, detail_px


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    return np.asarray(small_yard().cameras[0].captures[0])


def measured(image: np.ndarray) -> float:
    return blur_px(np.clip(image, 0, 255).astype(np.uint8), np.ones(image.shape[:2], bool))


@pytest.mark.parametrize("contrast", [1.0, 0.4])
@pytest.mark.parametrize("noise", [0.0, 5.0])
def test_a_sharp_picture_has_little_measured_blur(picture: np.ndarray, contrast: float, noise: float) -> None:
    noisy = np.random.default_rng(0).normal(0, noise, picture.shape)
    assert measured(100 * (1 - contrast) + contrast * picture.astype(np.float64) + noisy) < 0.7


@pytest.mark.parametrize("contrast", [1.0, 0.4])
@pytest.mark.parametrize("sigma", [1.5, 2.0])
def test_measured_blur_is_within_a_third_of_the_truth(picture: np.ndarray, sigma: float, contrast: float) -> None:
    blurred = cv2.GaussianBlur(picture, (0, 0), sigma).astype(np.float64)
    assert measured(100 * (1 - contrast) + contrast * blurred) == pytest.approx(sigma, rel=0.34)


@pytest.mark.parametrize(("rows", "columns"), [(48, 80), (12, 20)])
def test_blur_is_measured_where_the_picture_is_softest(rows: int, columns: int) -> None:
    picture = np.random.default_rng(0).uniform(0, 255, (rows, columns, 1)).repeat(16, axis=0).repeat(16, axis=1).repeat(3, axis=2)
    soft = cv2.GaussianBlur(picture, (0, 0), 3.0)
    soft[:, : 8 * columns] = picture[:, : 8 * columns]
    assert measured(picture) < 1.0
    assert measured(soft) > 2.0


@pytest.mark.parametrize("side", range(4))
def test_the_soft_side_of_a_small_photograph_is_found(picture: np.ndarray, side: int) -> None:
    turned = np.rot90(picture, side)
    soft = cv2.GaussianBlur(turned, (0, 0), 4.0)
    soft[:, : turned.shape[1] // 2] = turned[:, : turned.shape[1] // 2]
    assert measured(np.rot90(soft, -side)) > 1.3


def test_blur_of_a_picture_without_edges_is_undefined() -> None:
    assert np.isnan(measured(np.full((90, 160, 3), 120.0)))


def detail(image: np.ndarray, noise: float = 0.0) -> float:
    return detail_px(np.clip(image, 0, 255).astype(np.uint8), np.ones(image.shape[:2], bool), noise)


@pytest.mark.parametrize("contrast", [1.0, 0.4])
@pytest.mark.parametrize("noise", [0.0, 5.0])
def test_a_sharp_picture_resolves_its_pixels(picture: np.ndarray, contrast: float, noise: float) -> None:
    noisy = np.random.default_rng(0).normal(0, noise, picture.shape)
    assert detail(100 * (1 - contrast) + contrast * picture.astype(np.float64) + noisy, noise) == 1.0


@pytest.mark.parametrize("size", [(9, 1), (1, 9)])
def test_a_picture_smeared_in_one_direction_does_not_resolve_its_pixels(picture: np.ndarray, size: tuple[int, int]) -> None:
    assert detail(cv2.blur(picture, size)) > 2.0


@pytest.mark.parametrize("times", [3, 4])
def test_an_enlarged_picture_does_not_resolve_its_pixels(picture: np.ndarray, times: int) -> None:
    small = cv2.resize(picture, None, fx=1 / times, fy=1 / times, interpolation=cv2.INTER_AREA)
    assert detail(cv2.resize(small, picture.shape[1::-1])) > 0.5 * times


def test_an_empty_picture_does_not_lack_detail() -> None:
    assert detail(np.full((90, 160, 3), 120.0)) == 1.0

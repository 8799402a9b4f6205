"""Disparity maps are sampled between their pixels for the depths of a frame, and the depths of pairs are compared."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbflow_stages.fusion.pair_depth import NoiseModel, offset_px, sample_disparity


@settings(deadline=None)  # the first example includes compilation
@given(st.floats(-6, 6), st.floats(-1, 1), st.integers(0, 2**32 - 1))
def test_disparity_of_steep_ground_is_interpolated_exactly_between_rows(per_row: float, per_column: float, seed: int) -> None:
    """Its disparity changes by several pixels per row: the nearest row alone would be off by up to half of that."""
    y, x = np.mgrid[0:24, 0:30].astype(np.float32)
    ground = (40 + per_row * y + per_column * x).astype(np.float32)
    at = np.random.default_rng(seed).uniform([0, 0], [28.9, 22.9], (50, 2))
    truth = 40 + per_row * at[:, 1] + per_column * at[:, 0]
    np.testing.assert_allclose(sample_disparity(ground, at), truth, atol=1e-3)


@pytest.mark.parametrize("edge", ["across rows", "along rows"])
def test_disparity_is_not_averaged_across_edges(edge: str) -> None:
    y, x = np.mgrid[0:20, 0:20]
    step = np.where((y if edge == "across rows" else x) < 10, np.float32(5), np.float32(25)).astype(np.float32)
    at = np.random.default_rng(1).uniform(8, 11, (200, 2))
    assert set(sample_disparity(step, at)) == {5.0, 25.0}


def test_nothing_is_sampled_outside_the_map_and_only_known_pixels_beside_holes() -> None:
    flat = np.full((8, 8), 3, dtype=np.float32)
    flat[4, 4] = np.nan
    read = sample_disparity(flat, np.array([[-0.1, 3.0], [3.0, 7.5], [4.2, 4.2], [4.7, 4.2]]))
    np.testing.assert_array_equal(np.isnan(read), [True, True, True, False])


def test_a_uniform_offset_of_one_pair_is_measured_in_spite_of_noise() -> None:
    rng = np.random.default_rng(0)
    gain = np.full((120, 160), 0.1, np.float32)
    gain[40:60] = np.nan  # a band of rows is unknown
    depths = [(50 + 0.1 * (offset + rng.normal(0, 0.35, gain.shape))).astype(np.float32) for offset in (0.0, 0.0, 1.0)]
    depths[1][rng.random(gain.shape) < 0.2] = 30  # look-alikes
    offsets = offset_px(depths, [gain, gain, gain], NoiseModel())
    assert offsets[0, 1] < 0.15
    assert offsets[0, 2] == pytest.approx(1 / np.sqrt(2), abs=0.1)
    assert offset_px(depths, [gain, np.full_like(gain, 10), gain], NoiseModel()).keys() == {(0, 2)}, "too inexact to be fused"


def test_noise_correlated_over_patches_is_not_taken_for_an_offset() -> None:
    """At night, errors are correlated over whole patches, here of 20 x 20 pixels."""
    rng = np.random.default_rng(2)
    gain = np.full((200, 200), 0.1, dtype=np.float32)
    patches = [np.kron(rng.normal(0, 0.5, (10, 10)), np.ones((20, 20))) for _ in range(2)]
    depths = [(50 + 0.1 * (patch + rng.normal(0, 0.2, gain.shape))).astype(np.float32) for patch in patches]
    assert offset_px(depths, [gain, gain], NoiseModel())[0, 1] < 0.1
    depths[1] += 0.1
    assert offset_px(depths, [gain, gain], NoiseModel())[0, 1] == pytest.approx(1 / np.sqrt(2), abs=0.15)


def test_an_error_in_part_of_the_view_is_not_taken_for_an_offset_of_the_pair() -> None:
    rng = np.random.default_rng(1)
    gain = np.full((200, 300), 0.1, dtype=np.float32)
    depths = [(50 + 0.1 * rng.normal(0, 0.35, gain.shape)).astype(np.float32) for _ in range(2)]
    depths[1][:80] += 0.7  # two of the five rows of tiles
    assert offset_px(depths, [gain, gain], NoiseModel())[0, 1] < 0.15
    gain[:, 5:] = np.nan  # 1.7 % of the view is left, less than needed
    assert offset_px(depths, [gain, gain], NoiseModel()) == {}


def test_a_pattern_that_one_pair_mistakes_is_not_taken_for_an_offset() -> None:
    rng = np.random.default_rng(1)
    gain = np.full((200, 300), 0.1, dtype=np.float32)
    gain[:, 12:] = np.nan  # 4 % of the view is left
    depths = [(50 + 0.1 * rng.normal(0, 0.35, gain.shape)).astype(np.float32) for _ in range(2)]
    depths[1][:120] += 0.7  # three of the five rows of tiles
    assert offset_px(depths, [gain, gain], NoiseModel())[0, 1] < 0.25
    depths[1][120:160] += 0.7
    assert offset_px(depths, [gain, gain], NoiseModel())[0, 1] > 3

"""Posterior probability of points, and the points of a cloud that are kept."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from wbflow_stages.fusion.posterior import most_probable, noisiness, posterior
from wbflow_stages.fusion.visibility import CrossCheck, TrustedDepth
from wbflow_stages.types import DepthMap, Float32s, Frame, View

HEIGHT, WIDTH, WALL = 40, 60, 30
"""Size of the frame, pixels; from column `WALL` on, it shows nothing but noise."""


def noisy_frame(noise: float) -> Frame:
    rng = np.random.default_rng(0)
    image = rng.normal(120, noise, (HEIGHT, WIDTH, 1)) + np.zeros(3)
    image[:, :WALL] += rng.normal(0, 40, (HEIGHT, WALL, 1))
    mask = np.ones((HEIGHT, WIDTH), np.bool_)
    return Frame(image.clip(0, 255).round().astype(np.uint8), mask, View(WIDTH, HEIGHT), noise_left=noise)


def plane_probabilities(noise: float) -> Float32s:
    """Posterior probabilities of a plane that one pair supports and nothing contradicts."""
    flat, none = np.full((HEIGHT, WIDTH), 10.0, np.float32), np.zeros((HEIGHT, WIDTH), np.float32)
    depth = DepthMap(flat, 0.01 * flat, none, none, np.ones(flat.shape, np.uint32), ("roof",), np.ones(flat.shape, np.bool_))
    one = np.ones(flat.shape, np.uint8)
    check = CrossCheck(one, one.astype(np.uint16), one, none, none, none, one)
    return posterior(TrustedDepth(noisy_frame(noise), depth, none), check)


def test_depths_are_less_probable_where_the_picture_is_mostly_noise() -> None:
    shown = noisiness(noisy_frame(8.0))
    assert shown[:, : WALL - 4].max() < 0.1
    assert abs(np.median(shown[:, WALL + 4 :]) - np.log(2)) < 0.05  # the patch shows only noise
    quiet, noisy = plane_probabilities(0.0), plane_probabilities(8.0)
    inside = (slice(12, -12), slice(12, WALL - 12)), (slice(12, -12), slice(WALL + 12, -12))
    assert np.abs(quiet[inside[0]] - noisy[inside[0]]).max() < 0.02
    assert (noisy[inside[1]] < quiet[inside[1]] - 0.05).all()


def test_noise_never_makes_a_depth_more_probable() -> None:
    assert (plane_probabilities(8.0) <= plane_probabilities(0.0)).all()


@given(arrays(np.float32, st.integers(1, 200), elements=st.floats(0.5, 1.0, width=32)), st.floats(0.5, 1.0))
def test_the_least_probable_points_are_removed_and_no_more_than_necessary(probability: np.ndarray, share: float) -> None:
    kept = most_probable(probability, share)
    assert kept.any()
    if kept.all():
        return
    assert probability[kept].min() > probability[~kept].max()
    more = probability >= probability[~kept].max()
    assert probability[more].mean(dtype=np.float64) < share
    assert probability[kept].mean(dtype=np.float64) >= share or more.sum() > len(probability) / 2


def test_a_cloud_is_thinned_only_if_too_few_of_its_points_are_right() -> None:
    rng = np.random.default_rng(0)
    good, poor = rng.uniform(0.85, 1.0, 1000), rng.uniform(0.5, 1.0, 1000)
    assert most_probable(good.astype(np.float32), 0.9).all()
    kept = most_probable(poor.astype(np.float32), 0.8)
    assert 0.55 < kept.mean() < 0.85
    assert abs(poor[kept].mean() - 0.8) < 0.002

"""Colours of points in another view, as evidence about their depth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from wbflow_stages.fusion.colour_evidence import colour_evidence
from wbflow_stages.types import Uint8s

COUNT = 2000


def darker(rgb: Uint8s) -> Uint8s:
    return (0.5 * rgb + 20).astype(np.uint8)


def grey(rgb: Uint8s) -> Uint8s:
    return np.repeat(rgb.mean(axis=1, keepdims=True), 3, axis=1).astype(np.uint8)


@pytest.mark.parametrize("other_camera", [np.asarray, darker, grey])
def test_colours_of_the_same_surface_speak_for_a_depth_whatever_the_camera(other_camera: Callable[[Uint8s], Uint8s]) -> None:
    rng = np.random.default_rng(0)
    own = rng.integers(60, 200, (COUNT, 3)) + rng.normal(0, 4, (COUNT, 3))
    other = own + rng.normal(0, 4, (COUNT, 3))
    wrong = np.arange(COUNT) >= COUNT // 2
    other[wrong] = rng.integers(60, 200, (wrong.sum(), 3))
    evidence = colour_evidence(own.astype(np.uint8), other_camera(other.astype(np.uint8)), ~wrong)
    assert np.median(evidence[~wrong]) > 0.3
    assert np.median(evidence[wrong]) < -0.3
    assert np.abs(evidence).max() <= 2.5


def test_on_a_surface_of_one_colour_colours_say_nothing() -> None:
    rng = np.random.default_rng(1)
    own, other = (rng.normal(120, 3, (COUNT, 3)).astype(np.uint8) for _ in range(2))
    evidence = colour_evidence(own, other, np.arange(COUNT) < COUNT // 2)
    assert abs(evidence.mean()) < 0.1


def test_without_enough_agreeing_points_there_is_no_evidence() -> None:
    rgb = np.full((COUNT, 3), 90, np.uint8)
    assert not colour_evidence(rgb, rgb, np.arange(COUNT) < 50).any()

"""Depths that reach into a region that shows nothing are believed where they fill it: a wall, and not the sky."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.fusion.even_regions import believed
from wbflow_stages.types import Bools, DepthMap, Frame, View

HEIGHT, WIDTH = 120, 160
TOP = 50
"""Rows of an even region above textured ground."""


def frame(noise: float = 0.0) -> Frame:
    rng = np.random.default_rng(0)
    image = np.full((HEIGHT, WIDTH, 3), 210.0)
    image[TOP:] = rng.uniform(40, 200, (HEIGHT - TOP, WIDTH, 1))
    image += rng.normal(0, noise, image.shape) if noise else 0.0
    return Frame(image.clip(0, 255).astype(np.uint8), np.ones((HEIGHT, WIDTH), np.bool_), View(WIDTH, HEIGHT))


def depth_map(sure: Bools) -> DepthMap:
    depth = np.full((HEIGHT, WIDTH), 10.0, np.float32)
    none = np.zeros_like(depth)
    return DepthMap(depth, 0.01 * depth, none, none, np.ones(depth.shape, np.uint32), ("roof",), sure)


def sure_down_from(row: int) -> Bools:
    """The ground, and a band above it."""
    return np.repeat(np.arange(HEIGHT)[:, None] >= row, WIDTH, axis=1)


def test_a_band_of_sky_above_the_horizon_is_not_believed() -> None:
    kept = believed(frame(), depth_map(sure_down_from(TOP - 8)))
    assert not kept[: TOP - 2].any()
    assert kept[TOP + 1 :].all()


def test_a_wall_that_is_filled_is_believed() -> None:
    assert believed(frame(), depth_map(sure_down_from(5))).all()


def test_what_is_masked_stays_masked() -> None:
    masked = frame()
    masked.mask[:, :30] = False
    kept = believed(masked, depth_map(sure_down_from(0)))
    assert not kept[:, :30].any() and kept[:, 30:].all()


@pytest.mark.parametrize("side", [6, 40])
def test_a_small_even_patch_is_judged_by_what_is_around_it(side: int) -> None:
    patched = frame()
    patched.image[TOP + 10 : TOP + 10 + side, 60 : 60 + side] = 90
    sure = sure_down_from(0)
    sure[TOP + 10 : TOP + 10 + side, 60 : 60 + side] = False
    assert believed(patched, depth_map(sure)).all() == (side == 6)


def test_noise_is_something_to_be_seen() -> None:
    assert believed(frame(noise=6.0), depth_map(sure_down_from(TOP - 8))).mean() > 0.95

"""Depths in a region without texture are used only if they fill most of it, as on a wall but not in the sky."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wbflow_stages.fusion.even_regions import usable_pixels
from wbflow_stages.types import Bools, DepthMap, Frame, View

HEIGHT, WIDTH = 120, 160
TOP = 50
"""Number of rows of an even region above textured ground."""


def frame(noise: float = 0.0) -> Frame:
    rng = np.random.default_rng(0)
    image = np.full((HEIGHT, WIDTH, 3), 210.0)
    image[TOP:] = rng.uniform(40, 200, (HEIGHT - TOP, WIDTH, 1))
    image += rng.normal(0, noise, image.shape) if noise else 0.0
    return Frame(image.clip(0, 255).astype(np.uint8), np.ones((HEIGHT, WIDTH), np.bool_), View(WIDTH, HEIGHT))


def depth_map(known: Bools) -> DepthMap:
    depth = np.where(known, 10.0, np.nan).astype(np.float32)
    none = np.zeros_like(depth)
    return DepthMap(depth, 0.01 * depth, none, none, np.ones(depth.shape, np.uint32), ("roof",), known)


def known_down_from(row: int) -> Bools:
    """(h, w) True from this row down: the ground, and what lies between it and the row."""
    return np.repeat(np.arange(HEIGHT)[:, None] >= row, WIDTH, axis=1)


def test_depth_in_a_band_of_sky_above_the_horizon_is_not_used() -> None:
    kept = usable_pixels(frame(), depth_map(known_down_from(TOP - 8)))
    assert not kept[: TOP - 2].any()
    assert kept[TOP + 1 :].all()


def test_depth_in_a_sky_with_a_brightness_gradient_is_not_used() -> None:
    shaded = frame()
    shaded.image[:TOP] = (210 - np.arange(WIDTH))[:, None].clip(60, 210)
    assert not usable_pixels(shaded, depth_map(known_down_from(TOP - 8)))[: TOP - 2].any()


def test_depth_on_a_mostly_filled_wall_is_used() -> None:
    assert usable_pixels(frame(), depth_map(known_down_from(5))).all()


def test_depth_of_masked_pixels_is_not_used() -> None:
    masked = frame()
    masked.mask[:, :30] = False
    kept = usable_pixels(masked, depth_map(known_down_from(0)))
    assert not kept[:, :30].any() and kept[:, 30:].all()


@pytest.mark.parametrize("side", [6, 40])
def test_unknown_depth_matters_in_large_even_patches_but_not_in_small_ones(side: int) -> None:
    patched = frame()
    patched.image[TOP + 10 : TOP + 10 + side, 60 : 60 + side] = 90
    known = known_down_from(0)
    known[TOP + 10 : TOP + 10 + side, 60 : 60 + side] = False
    assert usable_pixels(patched, depth_map(known)).all() == (side == 6)


@pytest.mark.parametrize("noise_left", [0.0, 6.0])
def test_noise_counts_as_texture_unless_its_level_is_known(noise_left: float) -> None:
    noisy = replace(frame(noise=2.0), noise_left=noise_left)
    sky = usable_pixels(noisy, depth_map(known_down_from(TOP - 8)))[: TOP - 8]
    assert sky.all() if noise_left == 0 else sky.mean() < 0.1

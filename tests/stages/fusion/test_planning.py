"""Exposures are equalised where views see the same surface; the nearest views are those that share most of it."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.fusion.planning import Subsampled, exposure_gains, natural_voxel, nearest_views, subsample
from wbflow_stages.types import Camera, DepthMap, Frame, View

K = np.array([[200.0, 0, 159.5], [0, 200, 89.5], [0, 0, 1]])


def wall(x: float, gain: float = 1.0) -> tuple[Camera, Subsampled]:
    """A camera at x that looks at a wall at a distance of 10, whose grey level depends on the position on it."""
    camera = Camera(K, np.eye(3), np.array([x, 0.0, 0.0]), 320, 180)
    place = x + (np.arange(320) - 159.5) / 20
    grey = gain * (80 + 30 * np.sin(place))
    image = np.repeat(np.repeat(grey[None, :, None], 180, axis=0), 3, axis=2)
    flat = np.zeros((180, 320), np.float32)
    depth = DepthMap(flat + 10, flat + 0.001, flat, flat, flat.astype(np.uint32), (), flat == 0)
    frame = Frame((image + 0.5).astype(np.uint8), flat == 0, View(320, 180, K))
    return camera, subsample(frame, depth)


def test_exposure_gains_equalise_the_exposures() -> None:
    views = {"a": wall(0.0), "b": wall(0.5, 1.5), "c": wall(1.0, 0.8)}
    cameras, small = {n: v[0] for n, v in views.items()}, {n: v[1] for n, v in views.items()}
    near = {n: nearest_views(n, cameras, small, 4) for n in views}
    gains = exposure_gains(cameras, small, near)
    assert gains["b"] / gains["a"] == pytest.approx(1 / 1.5, rel=0.03)
    assert gains["c"] / gains["a"] == pytest.approx(1 / 0.8, rel=0.03)
    assert np.prod([gains[n] for n in views]) ** (1 / 9) == pytest.approx(1, abs=0.01)


def test_cameras_that_share_no_surface_keep_their_exposure() -> None:
    views = {"a": wall(0.0), "far": wall(500.0, 2.0)}
    cameras, small = {n: v[0] for n, v in views.items()}, {n: v[1] for n, v in views.items()}
    assert nearest_views("a", cameras, small, 4) == []
    gains = exposure_gains(cameras, small, {"a": [], "far": []})
    assert all(gain == pytest.approx(1) for gain in gains.values())


def test_the_nearest_views_are_those_that_share_most_of_the_surface() -> None:
    views = {name: wall(x) for name, x in (("a", 0.0), ("far", 9.0), ("near", 1.0), ("next", 4.0))}
    cameras, small = {n: v[0] for n, v in views.items()}, {n: v[1] for n, v in views.items()}
    assert nearest_views("a", cameras, small, 2) == ["near", "next"]


def test_the_natural_voxel_is_a_round_number_of_about_a_pixels_footprint() -> None:
    camera, small = wall(0.0)
    assert natural_voxel({"a": camera}, {"a": small}) == pytest.approx(0.05)

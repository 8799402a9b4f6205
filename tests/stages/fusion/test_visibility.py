"""Several views of one wall say where it is, and whose depth is off."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.fuse import fuse
from wbflow_stages.fusion.visibility import cross_check
from wbflow_stages.types import Camera, Cloud, DepthMap, Float32s, Float64s, Frame, View

SIDE, FOCAL, WALL = 80, 200.0, 10.0
"""Pixels of a frame and of the focal length; metres to the wall, on which a pixel covers five centimetres."""
PATCH = slice(30, 50), slice(30, 50)


def cameras(count: int) -> dict[str, Camera]:
    """Side by side, in steps of 30 cm; they look along z."""
    K = np.array([[FOCAL, 0.0, SIDE / 2], [0.0, FOCAL, SIDE / 2], [0.0, 0.0, 1.0]])
    return {f"c{k}": Camera(K, np.eye(3), np.array([0.3 * k, 0.0, 0.0]), SIDE, SIDE) for k in range(count)}


def leaning(camera: Camera, lean: float) -> tuple[Float32s, Float32s]:
    """Depth (h, w) of a wall that recedes by `lean` per metre to the right, and its slope in inverse depth."""
    x = (np.arange(SIDE) - SIDE / 2) / FOCAL
    q = (1 - lean * x) / (WALL + lean * camera.C[0])
    depth = np.broadcast_to(1 / q, (SIDE, SIDE)).astype(np.float32)
    return depth, np.full((SIDE, SIDE), q[1] - q[0], np.float32)


def views(count: int, lean: float, off: float) -> tuple[dict[str, Camera], dict[str, DepthMap]]:
    """Depths of such a wall, of which the first view has a patch that is `off` metres behind it."""
    found, maps = cameras(count), {}
    names = tuple(found)
    for name, camera in found.items():
        depth, slope = leaning(camera, lean)
        if name == "c0":
            depth = depth.copy()
            depth[PATCH] += np.float32(off)
        all_of_them = np.full((SIDE, SIDE), (1 << count) - 1, np.uint32)
        known = np.ones((SIDE, SIDE), np.bool_)
        maps[name] = DepthMap(depth, 0.03 * known.astype(np.float32), slope, 0 * slope, all_of_them, names, known)
    return found, maps


@pytest.mark.parametrize("lean", [0.0, 0.7])
def test_the_median_of_the_views_is_the_wall(lean: float) -> None:
    found, maps = views(4, lean, off=0.08)
    check = cross_check("c0", ["c1", "c2", "c3"], found, maps.__getitem__)
    there: Float64s = maps["c0"].depth * (1.0 + check.shift)
    assert np.abs(there - leaning(found["c0"], lean)[0])[PATCH].max() < 0.002


@pytest.mark.parametrize(("off", "left_out"), [(0.05, False), (0.12, True)])
def test_who_is_off_by_more_than_a_pixel_covers_is_left_to_the_others(off: float, left_out: bool) -> None:
    found, maps = views(4, 0.0, off)
    maps["c0"].sigma[...] = 0.1  # so that the others still agree
    image = np.full((SIDE, SIDE, 3), 128, np.uint8)
    frames = {name: Frame(image, np.ones((SIDE, SIDE), np.bool_), View(SIDE, SIDE)) for name in found}
    cloud = fuse(frames, found, maps)
    assert isinstance(cloud, Cloud)
    assert cloud.given["c1"] == SIDE * SIDE
    assert cloud.given["c0"] == SIDE * SIDE - (20 * 20 if left_out else 0)

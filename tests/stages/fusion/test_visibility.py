"""Several views of one wall determine how probable a depth is."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.fusion.visibility import CrossCheck, TrustedDepth, cross_check
from wbflow_stages.types import Camera, DepthMap, Float32s, Frame, View

SIDE, FOCAL, WALL = 80, 200.0, 10.0
"""Side of the frame and focal length, pixels; distance of the wall, metres, at which a pixel covers 5 cm."""
PATCH = slice(30, 50), slice(30, 50)


def cameras(count: int) -> dict[str, Camera]:
    """Cameras side by side, 30 cm apart, that look along z."""
    K = np.array([[FOCAL, 0.0, SIDE / 2], [0.0, FOCAL, SIDE / 2], [0.0, 0.0, 1.0]])
    return {f"c{k}": Camera(K, np.eye(3), np.array([0.3 * k, 0.0, 0.0]), SIDE, SIDE) for k in range(count)}


def leaning(camera: Camera, lean: float) -> tuple[Float32s, Float32s]:
    """Depth (h, w) of a wall that recedes by `lean` metres per metre to the right, and its slope in inverse depth."""
    x = (np.arange(SIDE) - SIDE / 2) / FOCAL
    q = (1 - lean * x) / (WALL + lean * camera.C[0])
    depth = np.broadcast_to(1 / q, (SIDE, SIDE)).astype(np.float32)
    return depth, np.full((SIDE, SIDE), q[1] - q[0], np.float32)


def views(count: int, lean: float, off: float) -> tuple[dict[str, Camera], dict[str, DepthMap]]:
    """Depth maps of a leaning wall; in that of the first view, a patch lies `off` metres behind the wall."""
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


def check_of(found: dict[str, Camera], maps: dict[str, DepthMap], own: float) -> CrossCheck:
    """Cross-check of the first view against the others; `own`: log-odds that a view's own depth is right."""
    grey = Frame(np.zeros((SIDE, SIDE, 3), np.uint8), np.ones((SIDE, SIDE), np.bool_), View(SIDE, SIDE))
    trusted = {name: TrustedDepth(grey, depth, np.full((SIDE, SIDE), own, np.float32)) for name, depth in maps.items()}
    return cross_check("c0", ["c1", "c2", "c3"], found, trusted.__getitem__)


@pytest.mark.parametrize("lean", [0.0, 0.7])
def test_views_of_the_same_wall_agree_with_its_depth(lean: float) -> None:
    check = check_of(*views(4, lean, off=0.0), own=3.0)
    middle = slice(20, 60), slice(40, 60)
    assert (check.agreeing[middle] == 3).all() and (check.pairs[middle] >= 6).all() and (check.opposing[middle] == 0).all()


@pytest.mark.parametrize(("own", "against"), [(5.0, 10.0), (-2.0, 0.5)])
def test_views_oppose_a_depth_as_strongly_as_they_trust_their_own(own: float, against: float) -> None:
    """A patch 0.5 m in front of the wall: views that are sure of their depth rule it out, unsure ones hardly oppose it."""
    check = check_of(*views(4, 0.0, off=-0.5), own=own)
    seen = -check.opposing[PATCH]
    assert (seen > against).all() if own > 0 else (seen < against).all()


def test_colours_oppose_a_wrong_depth_even_in_views_without_a_depth() -> None:
    """A patch 2 m in front of a painted wall, compared with a view that has no depth on its left half."""
    found, maps = views(2, 0.0, off=-2.0)
    paint = np.random.default_rng(3).integers(0, 256, (SIDE, 2 * SIDE, 3)).astype(np.uint8)
    known = np.ones((SIDE, SIDE), np.bool_)
    trusted = {}
    for name, shift in (("c0", 0), ("c1", 6)):  # a baseline of 30 cm moves the wall by 6 px
        frame = Frame(paint[:, shift : shift + SIDE], known, View(SIDE, SIDE))
        trusted[name] = TrustedDepth(frame, maps[name], np.zeros((SIDE, SIDE), np.float32))
    maps["c1"].depth[:, : SIDE // 2] = np.nan
    colours = cross_check("c0", ["c1"], found, trusted.__getitem__).colours
    assert (colours[PATCH] < -0.5).mean() > 0.9
    assert (colours[:25, 10:] > 1).all()
    assert (colours[:, :5] == 0).all()  # outside the other view's picture

"""The demo scenes: their ground truth is correct, tiles repeat exactly, and traffic moves."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest

from wbflow_demo import square
from wbflow_demo.parts.ground import repeating_tiles
from wbflow_demo.render.cameras import Viewpoint, camera_at
from wbflow_demo.render.light import light_of, overcast_of
from wbflow_demo.render.photograph import DemoSite, render_view
from wbflow_demo.render.renderer import OPEN_SKY, PreparedScene, build_atlas
from wbflow_demo.render.scene import SceneBuilder
from wbflow_demo.scenes import SCENES, render
from wbflow_stages.core.cameras import backproject, project

SIZE = (160, 90)


@cache
def tiny(name: str) -> DemoSite:
    return render(name, cameras=3, size=SIZE, captures=2)


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


@pytest.mark.parametrize("name", [name for name in SCENES if name != "yard"])
def test_the_depth_maps_of_different_cameras_agree(name: str) -> None:
    """A point may be hidden behind what another camera sees, but not lie in front of it."""
    site = tiny(name)
    left = site.cameras[0]
    v, u = np.nonzero(left.depth > 0)
    points = backproject(left.camera, np.column_stack([u, v]).astype(float), left.depth[v, u].astype(float))
    agree = []
    for right in site.cameras[1:]:
        x, z = project(right.camera, points)
        pixel = np.rint(x).astype(int)
        inside = (z > 0) & (pixel >= 0).all(axis=1) & (pixel < SIZE).all(axis=1)
        inside[inside] &= right.depth[pixel[inside, 1], pixel[inside, 0]] > 0
        ratio = z[inside] / right.depth[pixel[inside, 1], pixel[inside, 0]]
        assert (ratio < 0.93).mean() < 0.08
        agree.append(int((np.abs(ratio - 1) < 0.03).sum()))
    assert max(agree) > 500


@pytest.mark.parametrize("name", [name for name in SCENES if name != "yard"])
def test_a_small_part_of_some_picture_moves_between_captures(name: str) -> None:
    shares = []
    for camera in tiny(name).cameras:
        first, second = (cv2.GaussianBlur(c, (0, 0), 1.0).astype(np.float32) for c in camera.captures[:2])
        gain = np.median((first + 1) / (second + 1))
        shares.append(float(((np.abs(first - gain * second).max(axis=-1) > 25) & camera.mask).mean()))
    assert max(shares) > 0.0005
    assert max(shares) < 0.4


def test_the_same_arguments_give_the_same_bytes_and_another_seed_another_scene() -> None:
    first, second = (render("carpark", cameras=2, size=(64, 36), captures=2) for _ in range(2))
    other = render("carpark", cameras=1, size=(64, 36), captures=1, seed=1)
    for a, b in zip(first.cameras, second.cameras, strict=True):
        assert all(np.array_equal(p, q) for p, q in zip(a.captures, b.captures, strict=True))
        assert np.array_equal(a.depth, b.depth)
    assert np.array_equal(first.reference.points, second.reference.points)
    assert not np.array_equal(first.cameras[0].captures[0], other.cameras[0].captures[0])


def test_the_ground_of_the_square_is_flat_at_height_zero() -> None:
    camera = tiny("square").cameras[0]
    v, u = np.nonzero(camera.depth[70:] > 0)  # the lowest rows, which show little but tiles
    points = backproject(camera.camera, np.column_stack([u, v + 70]).astype(float), camera.depth[v + 70, u].astype(float))
    assert np.median(np.abs(points[:, 2])) < 1e-4
    assert (np.abs(points[:, 2]) < 1e-3).mean() > 0.7


def test_the_first_three_cameras_of_the_square_stand_at_the_stated_places() -> None:
    centres = [np.array(v.centre) for v in square.viewpoints()]
    assert all(c[2] == 2.5 for c in centres)
    flat = [c[:2] / np.linalg.norm(c[:2]) for c in centres]
    assert [round(angle_deg(flat[i], flat[j])) for i, j in ((0, 1), (1, 2), (0, 2))] == [42, 56, 98]


def test_tiles_repeat_exactly() -> None:
    pixels = repeating_tiles(np.random.default_rng(3), 0.8, 8, 0.0125).pixels
    period = len(pixels) // 8
    assert period == 64
    assert np.array_equal(pixels, np.roll(pixels, period, axis=0))
    assert np.array_equal(pixels, np.roll(pixels, 3 * period, axis=1))
    assert not np.array_equal(pixels, np.roll(pixels, period // 2, axis=0))


def test_the_square_looks_the_same_from_one_tile_further() -> None:
    """Two views straight down, one tile apart, differ only by the noise of filtering; half a tile apart, they differ clearly."""
    build = SceneBuilder()
    square._ground(build, np.random.default_rng(0), 0.05)
    scene = build.build()
    prepared = PreparedScene(scene, overcast_of("day", ()), build_atlas(scene.textures), OPEN_SKY)
    views = []
    for shift in (0.0, square.TILE_M, 0.5 * square.TILE_M):
        down = Viewpoint("down", (1.3 + shift, 2.1, 4.0), (1.3 + shift, 2.101, 0.0), 40.0, (0.0, 0.0, 0.0, 0.0, 0.0))
        views.append(render_view(prepared, camera_at(down, SIZE)[0], None))
    assert np.abs(views[0] - views[1]).mean() < 0.02 * views[0].std()
    assert np.abs(views[0] - views[2]).mean() > 0.5 * views[0].std()


def test_a_dark_scene_has_no_lamps_but_its_pictures_show_structure() -> None:
    assert light_of("night", [(0.0, 0.0, 5.0)]).lamps
    assert not light_of("dark", [(0.0, 0.0, 5.0)]).lamps
    day, dark = (render("yard", cameras=1, size=(320, 180), captures=1, light=light).cameras[0] for light in ("day", "dark"))
    assert np.array_equal(day.depth, dark.depth)
    a, b = (cv2.GaussianBlur(c.captures[0].mean(axis=-1), (0, 0), 2)[40:].ravel() for c in (day, dark))
    fine = [image - cv2.blur(image.reshape(-1, 320), (31, 31)).ravel() for image in (a, b)]
    assert 15 < b.mean() < 120
    assert np.corrcoef(np.stack(fine))[0, 1] > 0.25


def test_an_unknown_scene_is_refused_with_a_list_of_scenes() -> None:
    with pytest.raises(ValueError, match=r"no scene 'moon'; there are yard, square, carpark"):
        render("moon")


def test_more_cameras_than_a_scene_has_are_refused() -> None:
    with pytest.raises(ValueError, match="1 to 6 cameras, not 7"):
        render("square", cameras=7, small=True)

"""The renderer, checked against facts about a picture that are known without rendering."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_demo.parts.movers import movers
from wbflow_demo.render.cameras import MOUNTS, camera_at, look_at
from wbflow_demo.render.light import Light, light_of
from wbflow_demo.render.paint import Texture, encode
from wbflow_demo.render.photograph import Daytime, changed_pixels, render_pixels, render_view, true_depth
from wbflow_demo.render.renderer import PreparedScene, build_atlas
from wbflow_demo.render.scene import SceneBuilder, joined
from wbflow_demo.yard import LAMPS, static_yard
from wbflow_stages.types import Camera

OVERCAST = Light((0.0, 0.6, 0.8), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0))


def checker(texel_m: float) -> Texture:
    """A texture of alternating black and white texels."""
    board = (np.indices((80, 80)).sum(axis=0) % 2).astype(np.float32)
    return encode(np.repeat(board[..., None], 3, axis=2), texel_m)


def above(height: float, focal: float = 200.0) -> Camera:
    """A camera that looks (almost) straight down."""
    C = np.array([0.0, 0.0, height])
    return Camera(np.array([[focal, 0, 39.5], [0, focal, 39.5], [0, 0, 1.0]]), look_at(C, np.array([0.0, 0.001, 0.0])), C, 80, 80)


def floor(texture: Texture) -> PreparedScene:
    build = SceneBuilder()
    build.quad((-4.0, 4.0, 0.0), (8.0, 0, 0), (0, -8.0, 0), build.add_texture(texture))
    scene = build.build()
    return PreparedScene(scene, OVERCAST, build_atlas(scene.textures))


def test_the_normals_of_all_shapes_point_outward() -> None:
    build = SceneBuilder()
    texture = build.add_texture(checker(0.1))
    build.box((1.0, 2.0, 0.0), (2.0, 3.0, 4.0), texture, yaw=0.3)
    build.beam((5.0, 5.0, 0.0), (7.0, 6.0, 3.0), 0.2, texture)
    build.tube((-3.0, 0.0, 0.0), 0.5, 2.0, texture)
    build.ball((0.0, -4.0, 1.0), (1.0, 0.8, 0.6), texture)
    scene = build.build()
    middles = scene.vertices.reshape(-1, 3, 3).mean(axis=1)
    inside = np.array([[1.0, 2.0, 2.0], [6.0, 5.5, 1.5], [-3.0, 0.0, 1.0], [0.0, -4.0, 1.0]], np.float32)
    # facets are in the order of construction; the beam is slanted, so only components across its axis count
    counts = (12, 8, 42, len(middles) - 62)
    owner = np.repeat(np.arange(4), counts)
    outward = middles - inside[owner]
    along = np.array([2.0, 1.0, 3.0], np.float32) / np.sqrt(14)
    beam = owner == 1
    outward[beam] -= (outward[beam] @ along)[:, None] * along
    assert (np.einsum("ni,ni->n", outward, scene.normals) > 0).all()


def test_a_texture_is_sharp_when_near_and_averaged_when_far() -> None:
    near = render_view(floor(checker(0.1)), above(1.0), None)
    far = render_view(floor(checker(0.03)), above(300.0, focal=2000.0), None)[20:60, 20:60]  # 15 cm per pixel
    assert near.max() > 10 * near.min()
    assert far.std() < 0.03 * far.mean()
    assert far.mean() == pytest.approx(near.mean(), rel=0.1)


def test_a_texture_appears_where_its_coordinates_say() -> None:
    """A white spot 1.2 m to the right of and 0.7 m below the top left corner of a floor appears there."""
    spot = np.full((80, 80, 3), 0.02, np.float32)
    spot[5:9, 10:14] = 0.9
    picture = render_view(floor(encode(spot, 0.1)), above(20.0), None)[..., 0]
    y, x = np.average(np.indices(picture.shape).reshape(2, -1), axis=1, weights=(picture > 0.5 * picture.max()).ravel())
    # 10 pixels per metre; the centre of the picture is the origin
    assert x == pytest.approx(39.5 + 10 * (-4 + 1.2), abs=0.6)
    assert y == pytest.approx(39.5 + 10 * (-4 + 0.7), abs=0.6)


def test_depth_is_measured_along_the_optical_axis() -> None:
    depth, normals = true_depth(floor(checker(0.1)), above(3.0))
    assert depth == pytest.approx(3.0, abs=3e-3)
    assert normals[..., 2] == pytest.approx(1.0)


@pytest.mark.parametrize("light", ["day", "night"])
def test_only_pixels_that_movers_touch_need_to_be_rendered_again(light: Daytime) -> None:
    still = static_yard(np.random.default_rng(1), 0.15)
    mover = movers(np.random.default_rng(2), 0.15, 1)[0]
    scene = joined(still, mover)
    empty = PreparedScene(still, light_of(light, LAMPS), build_atlas(scene.textures))
    busy = PreparedScene(scene, empty.light, empty.atlas, empty.sky)
    camera, lens = camera_at(MOUNTS[3], (160, 90))
    whole = render_view(busy, camera, lens)
    patched = render_view(empty, camera, lens)
    changed = changed_pixels(mover, empty.light, camera, lens)
    pixels = np.flatnonzero(changed)
    patched.reshape(-1, 3)[pixels] = render_pixels(busy, camera, lens, pixels)
    assert 0.02 < changed.mean() < 0.6
    tolerance = 0.002 if light == "day" else 0.03  # far, faint shadows of lamps are neglected
    assert np.percentile(np.abs(whole - patched), 99.9) < tolerance

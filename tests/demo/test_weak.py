"""The yard with white plaster, wet asphalt and snow: the same walls and ground, with little texture; wet ground mirrors sky."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_demo.parts.ground import cobbles
from wbflow_demo.parts.weak import snow, wet_asphalt, white_plaster
from wbflow_demo.render.light import light_of
from wbflow_demo.render.renderer import PreparedScene, build_atlas, shade, trace
from wbflow_demo.render.scene import SceneBuilder
from wbflow_demo.scenes import render


def test_weak_surfaces_have_the_geometry_of_the_yard() -> None:
    usual, weak = (
        render("yard", size=(96, 54), cameras=1, captures=1, surfaces=kind).cameras[0] for kind in ("standard", "weak")
    )
    assert np.isclose(usual.depth, weak.depth, rtol=1e-4).mean() > 0.9, "crates and drums stand elsewhere"


def test_plaster_snow_and_wet_asphalt_have_little_contrast() -> None:
    contrast = []
    for paint in (white_plaster, snow, wet_asphalt, cobbles):
        pixels = paint(np.random.default_rng(0), 4.0, 4.0, 0.05).pixels.astype(float)
        contrast.append(pixels.std(axis=(0, 1)).mean() / pixels.mean())
    assert max(contrast[:2]) < 0.03 and contrast[2] < 0.1 < contrast[3]


@pytest.mark.parametrize(("surfaces", "scene"), [("muddy", "yard"), ("weak", "square")])
def test_surfaces_that_a_scene_does_not_have_are_refused(surfaces: str, scene: str) -> None:
    with pytest.raises(ValueError, match="surfaces"):
        render(scene, small=True, surfaces=surfaces)


def test_wet_ground_is_brighter_at_grazing_angles_than_from_above() -> None:
    build = SceneBuilder()
    paving = build.add_texture(wet_asphalt(np.random.default_rng(0), 2.0, 2.0, 0.1))
    build.quad((-50.0, 50.0, 0.0), (100.0, 0.0, 0.0), (0.0, -100.0, 0.0), paving)
    scene = build.build()
    prepared = PreparedScene(scene, light_of("day", ()), build_atlas(scene.textures))
    seen = []
    for forward in (0.3, 12.0):
        ray = np.array([[0.0, forward, -1.0]], np.float32)
        at = trace(prepared, np.array([0.0, 0.0, 2.0]), ray / np.linalg.norm(ray), 0.001)
        seen.append(float(shade(prepared, at, np.zeros((1, 2), np.float32)).mean()))
    assert seen[1] > 3 * seen[0]

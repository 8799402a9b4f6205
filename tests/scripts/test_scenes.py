"""The scenes that only benches use: their symmetry and their camera positions are as stated, and each renders."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import scenes
from scenes import hall, mast

from wbflow_demo.render import renderer
from wbflow_demo.render.cameras import camera_at
from wbflow_demo.render.light import overcast_of
from wbflow_demo.render.photograph import render_view, true_depth
from wbflow_demo.render.renderer import PreparedScene, build_atlas, spiral
from wbflow_demo.scenes import render

SIZE = (160, 90)


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


@pytest.mark.parametrize(("symmetry", "turn", "same"), [(4, 3, True), (4, 6, True), (2, 6, True), (2, 3, False), (1, 3, False)])
def test_the_hall_looks_the_same_only_after_turns_of_its_symmetry(symmetry: int, turn: int, same: bool) -> None:
    """With this symmetry, camera k + 3 (a quarter turn) or k + 6 (half a turn) sees the same as k, light and shadow included."""
    prepared = hall_stage(symmetry)
    views = hall.viewpoints()
    for k in (1, 2):
        (one, _), (other, _) = (camera_at(views[i], SIZE) for i in (k, k + turn))
        a, b = render_view(prepared, one, None), render_view(prepared, other, None)
        difference = np.abs(a - b).max(axis=-1) / (a + b + 0.01).max(axis=-1)
        depth = np.abs(true_depth(prepared, one)[0] - true_depth(prepared, other)[0])
        if same:
            assert (difference > 0.02).mean() < 0.003
            assert (depth > 0.01).mean() < 0.003
        else:
            assert (difference > 0.1).mean() > 0.03
        assert angle_deg(one.R[2], other.R[2]) > 80


@cache
def hall_stage(symmetry: int) -> PreparedScene:
    scene = hall.static_hall(np.random.default_rng(5), 0.1, symmetry)
    return PreparedScene(scene, overcast_of("night", hall.LAMPS), build_atlas(scene.textures), hall.even_sky(scene))


def test_the_cameras_of_the_mast_are_close_together_and_look_far() -> None:
    centres = np.array([v.centre for v in mast.viewpoints()])
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)[~np.eye(len(centres), dtype=bool)]
    assert 0.25 < apart.min() < 0.4
    assert 3.5 < apart.max() < 4.5
    depth = render("mast", cameras=1, size=SIZE, captures=1).cameras[0].depth
    assert np.median(depth[depth > 0]) > 200


@pytest.mark.parametrize("name", scenes.NAMES)
def test_every_bench_scene_can_be_rendered(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(renderer, "spiral", lambda _: spiral(6))  # coarse light from the sky is enough, and takes half the time
    (camera,) = render(name, cameras=1, size=(64, 36), captures=1).cameras
    assert (camera.depth > 0).mean() > 0.3

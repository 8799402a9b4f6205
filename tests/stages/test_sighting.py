"""Guides for marking one place in several pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wbflow_stages.core.lenses import lens_pixels
from wbflow_stages.sighting import Sights
from wbflow_stages.types import Float64s, Lens

K = [[400.0, 0, 319.5], [0, 400.0, 179.5], [0, 0, 1]]


def camera(C: list[float], model: str, distortion: list[float]) -> dict[str, Any]:
    """A camera at C that looks at the origin, z up."""
    ahead = -np.array(C) / np.linalg.norm(C)
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    R = np.array([right, np.cross(ahead, right), ahead])
    return {"K": K, "R": R.tolist(), "C": C, "width": 640, "height": 360, "model": model, "distortion": distortion}


CAMERAS = {
    "plain": camera([-5, -10, 4], "brown", [0.0] * 5),
    "barrel": camera([0, -12, 5], "brown", [-0.25, 0.06, 0.001, 0, 0]),
    "wide": camera([6, -9, 6], "fisheye", [0.02, -0.003, 0, 0]),
}


def seen(name: str, X: list[float]) -> Float64s:
    entry = CAMERAS[name]
    lens = Lens(np.array(entry["K"]), np.array(entry["distortion"]), None, 640, 360, entry["model"])
    pixels: Float64s = lens_pixels(lens, (np.array([X]) - entry["C"]) @ np.array(entry["R"]).T)
    return np.asarray(pixels[0], dtype=np.float64)


PLACE = [1.2, 2.5, 0.7]
CLICKS = {name: seen(name, PLACE).tolist() for name in CAMERAS}


@pytest.mark.parametrize("name", CAMERAS)
def test_an_epipolar_guide_bends_with_the_lens_and_passes_through_the_place(name: str) -> None:
    other = next(n for n in CAMERAS if n != name)
    (line,) = Sights(CAMERAS).guide(name, {other: CLICKS[other]}, None)["lines"]
    points = np.array(line)
    starts, along = points[:-1], np.diff(points, axis=0)
    t = np.clip(((CLICKS[name] - starts) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0, 1)
    assert np.linalg.norm(starts + t[:, None] * along - CLICKS[name], axis=1).min() < 0.1


def test_two_clicks_determine_the_place_and_its_pixel_in_a_third_camera() -> None:
    sights = Sights(CAMERAS)
    two = {name: CLICKS[name] for name in ("plain", "barrel")}
    assert sights.residuals([(two, None)])[0]["place"] == pytest.approx(PLACE, abs=1e-6)
    assert sights.guide("wide", two, None)["at"] == pytest.approx(CLICKS["wide"], abs=0.02)


def test_residuals_are_given_in_pixels_and_in_metres() -> None:
    (found, one) = Sights(CAMERAS).residuals([(CLICKS, [1.2, 2.5, 1.0]), ({"plain": CLICKS["plain"]}, [1.2, 2.5, 1.0])])
    assert found["metres"] == pytest.approx(0.3, abs=1e-6)
    assert max(found["pixels"].values()) < 1e-6
    assert one["place"] is None
    assert one["pixels"]["plain"] == pytest.approx(float(np.linalg.norm(seen("plain", [1.2, 2.5, 1.0]) - CLICKS["plain"])))


def test_a_camera_without_a_pose_has_no_guides_and_no_residuals() -> None:
    sights = Sights(CAMERAS)
    assert sights.guide("other", CLICKS, PLACE) == {}
    assert sights.residuals([({"other": [1.0, 2.0]}, None)]) == [{"place": None, "pixels": {}, "metres": None}]


def test_parallel_rays_give_no_place() -> None:
    twin = {"one": CAMERAS["plain"], "two": CAMERAS["plain"]}
    assert Sights(twin).residuals([({"one": [100.0, 100.0], "two": [100.0, 100.0]}, None)])[0]["place"] is None


@pytest.mark.parametrize("name", CAMERAS)
def test_a_pixel_on_the_ground_is_mapped_back_to_its_ground_point(name: str) -> None:
    sights = Sights(CAMERAS)
    corners = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.5]]
    outline = sights.outline(name, corners, 0.25)
    for at, corner in zip(outline["corners"], corners, strict=True):
        assert sights.on_ground(name, at, 0.25) == pytest.approx(corner, abs=2e-3)
    assert len(outline["lines"]) == 3

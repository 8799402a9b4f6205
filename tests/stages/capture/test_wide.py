"""A lens that is too wide for one pinhole is split into several views that together show all of its field."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from wbflow_stages.capture.wide import views_of_lens
from wbflow_stages.core.cameras import same_camera
from wbflow_stages.core.lenses import WIDEST_DEG, lens_pixels, lens_rays, off_axis
from wbflow_stages.frames import clean_frame
from wbflow_stages.types import Capture, Float64s, Lens

COEFFICIENTS = np.array([-0.012, 0.004, -0.0011, 0.0001])


def fisheye(width: int, height: int, across_deg: float) -> Lens:
    """A fisheye whose image shows `across_deg` degrees across its width."""
    bent = lens_pixels(Lens(np.eye(3), COEFFICIENTS, model="fisheye"), rays_at(across_deg / 2))[0, 0]
    f = 0.5 * width / bent
    K = np.array([[f, 0.0, 0.5 * width + 3.0], [0.0, f, 0.5 * height - 2.0], [0.0, 0.0, 1.0]])
    return Lens(K, COEFFICIENTS, None, width, height, "fisheye")


def rays_at(degrees: float) -> Float64s:
    return np.array([[np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))]])


def views_of(lens: Lens) -> list[Lens]:
    assert lens.K is not None
    found = views_of_lens(lens.K.tolist(), lens.distortion.tolist(), lens.width, lens.height, lens.model)
    return [replace(lens, camera="gate", turn=np.array(turn), window=np.array(window)) for turn, window in found]


def shown_in(view: Lens, rays: Float64s) -> np.ndarray:
    """(n,) is each direction inside the window of a view?"""
    assert view.turn is not None and view.window is not None
    x, y, z = (rays @ view.turn.T).T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = x / z, y / z
    left, right, up, down = view.window
    return np.asarray((z > 0) & (u >= left) & (u <= right) & (v >= up) & (v <= down))


@pytest.mark.parametrize(
    ("width", "height", "across_deg", "count"),
    [(640, 360, 180, 3), (640, 640, 180, 5), (640, 360, 130, 2), (640, 640, 130, 4), (360, 640, 100, 3), (640, 480, 108, 0)],
)
def test_the_views_together_cover_the_field_of_the_lens(width: int, height: int, across_deg: float, count: int) -> None:
    lens = fisheye(width, height, across_deg)
    views = views_of(lens)
    assert len(views) == count
    if not views:
        return
    pixels = np.random.default_rng(0).uniform([0, 0], [width - 1, height - 1], (2000, 2))
    rays = lens_rays(lens, pixels)
    rays = rays[np.degrees(off_axis(rays)) < 88]
    seen = np.stack([shown_in(view, rays) for view in views])
    assert seen.any(axis=0).mean() > 0.97
    assert seen.sum(axis=0).mean() < 1.45
    for view in views:
        assert view.turn is not None and view.window is not None
        np.testing.assert_allclose(view.turn @ view.turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view.turn) > 0
        assert np.degrees(np.arctan(view.window)).max() <= WIDEST_DEG / 2 + 1e-9
    axis_angles = [float(off_axis(view.turn[2:])[0]) for view in views if view.turn is not None]
    assert all(a <= b + 1e-6 for a, b in pairwise(axis_angles))


def test_each_view_agrees_with_its_pinhole() -> None:
    lens = fisheye(480, 270, 180)
    ramps = np.stack([*np.meshgrid(np.arange(480) / 1.9, 50 + np.arange(270) / 1.9), np.full((270, 480), 120.0)], axis=-1)
    capture = Capture(
        "gate.png", np.asarray(cv2.imencode(".png", np.rint(ramps).astype(np.uint8)[..., ::-1])[1].ravel(), np.uint8)
    )
    frames = [clean_frame([capture], view, None, resolution=None, overlays=False) for view in views_of(lens)]
    for frame, view in zip(frames, views_of(lens), strict=True):
        K = frame.view.K
        assert K is not None and view.turn is not None
        x, y = np.meshgrid(np.arange(frame.view.width), np.arange(frame.view.height))
        rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ np.linalg.inv(K).T @ view.turn
        came_from = lens_pixels(lens, rays)
        usable = frame.mask.ravel()
        assert usable.mean() > 0.6
        error = 1.9 * (frame.image.reshape(-1, 3)[usable, :2].astype(float) - [0, 50]) - came_from[usable]
        assert np.percentile(np.abs(error), 99.5) < 2.5  # pixels at the border may contain some of the black surroundings
        assert np.abs(error).max() < 12
        assert not frame.notes
    assert same_camera(frames[0].view, frames[1].view)


def test_views_of_different_cameras_do_not_count_as_one_camera() -> None:
    one, other = (replace(view, camera=name) for view, name in zip(views_of(fisheye(640, 360, 180)), "ab", strict=False))
    frames = [clean_frame([_noise_capture()], view, None, resolution=None, overlays=False) for view in (one, other)]
    assert not same_camera(frames[0].view, frames[1].view)


def _noise_capture() -> Capture:
    noise = np.random.default_rng(0).integers(60, 200, (360, 640, 3)).astype(np.uint8)
    return Capture("a.png", np.asarray(cv2.imencode(".png", noise)[1].ravel(), np.uint8))

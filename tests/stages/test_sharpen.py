"""Observations sharpened on the pixels themselves."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from exact_pairs import look
from wbflow_stages.epipolar import project
from wbflow_stages.sfm.mapping import Model
from wbflow_stages.sfm.sharpen import sharpened, smooth_grey
from wbflow_stages.sfm.tracks import Tracks
from wbflow_stages.types import Frame, View

K = np.array([[800.0, 0, 399.5], [0, 800.0, 299.5], [0, 0, 1]])
PIXELS_PER_UNIT = 200


def wall_model(noise_px: float, exposures: tuple[float, ...] = (1.0, 1.0, 1.0)) -> tuple[Model, dict[int, Frame], np.ndarray]:
    """Points of a painted wall (y = 0) in three views, observed with noise in all but the middle one; and their true places."""
    rng = np.random.default_rng(0)
    paint = cv2.GaussianBlur(rng.uniform(0, 255, (1200, 1600)), (0, 0), 4.0)
    paint = 128 + 40 * (paint - paint.mean()) / paint.std()
    on_wall = np.array([[1 / PIXELS_PER_UNIT, 0, -4], [0, 0, 0], [0, -1 / PIXELS_PER_UNIT, 3], [0, 0, 1]])  # paint pixels to X, 1
    X = np.column_stack([rng.uniform(-1.5, 1.5, 80), np.zeros(80), rng.uniform(-1.0, 1.0, 80)])
    cameras, frames = {}, {}
    for k, (degrees, exposure) in enumerate(zip((-15, 0, 15), exposures, strict=True)):
        angle = np.radians(degrees)
        cameras[k] = look(K, 5 * np.array([np.sin(angle), -np.cos(angle), 0.1]), np.zeros(3))
        P = cameras[k].K @ cameras[k].R @ np.column_stack([np.eye(3), -cameras[k].C])
        image = np.clip(exposure * cv2.warpPerspective(paint, P @ on_wall, (800, 600), flags=cv2.INTER_CUBIC), 0, 255)
        image = np.repeat(image[:, :, None], 3, axis=2).astype(np.uint8)
        frames[k] = Frame(image, np.ones(image.shape[:2], bool), View(800, 600, K))
    true = np.stack([project(camera, X)[0] for camera in cameras.values()], axis=1).reshape(-1, 2)
    track, view = np.repeat(np.arange(80), 3), np.tile(np.arange(3), 80)
    noise = noise_px * rng.normal(size=true.shape) * (view != 1)[:, None]
    tracks = Tracks(track.astype(np.int32), view.astype(np.int32), true + noise, 80)
    return Model(cameras, tracks, X, np.ones(len(track), bool), {}), frames, true


def greys(frames: dict[int, Frame]) -> dict[int, np.ndarray]:
    return {k: smooth_grey(frame) for k, frame in frames.items()}


@pytest.mark.parametrize("exposures", [(1.0, 1.0, 1.0), (0.7, 1.0, 0.8)])
def test_observations_come_several_times_nearer_to_where_they_belong(exposures: tuple[float, ...]) -> None:
    model, frames, true = wall_model(0.4, exposures)
    before = np.linalg.norm(model.tracks.xy - true, axis=1)[model.tracks.view != 1]
    after = np.linalg.norm(sharpened(model, greys(frames)).tracks.xy - true, axis=1)[model.tracks.view != 1]
    assert np.median(before) > 0.3
    assert np.median(after) < 0.05


def test_what_shows_something_else_stays_as_it_is() -> None:
    model, frames, _ = wall_model(0.4)
    noise = np.random.default_rng(1).uniform(0, 255, (*frames[2].mask.shape, 3)).astype(np.uint8)
    frames[2] = Frame(np.asarray(cv2.GaussianBlur(noise, (0, 0), 1.0), np.uint8), frames[2].mask, frames[2].view)
    after = sharpened(model, greys(frames)).tracks
    assert np.array_equal(after.xy[after.view == 2], model.tracks.xy[after.view == 2])
    assert not np.array_equal(after.xy[after.view == 0], model.tracks.xy[after.view == 0])

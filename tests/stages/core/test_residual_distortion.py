"""Lens distortion that is solved together with the poses is removed from the frames and pairs of the same night."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wbflow_stages.core.residual_distortion import (
    distorted_pixels,
    residual_distortion,
    residual_px,
    undistorted_frame,
    undistorted_frames,
    without_distortion,
)
from wbflow_stages.rectification.warping import warp, warp_with_mask
from wbflow_stages.types import Bools, Camera, Float64s, Frame, Rectification, Uint8s, View

WIDTH, HEIGHT = 240, 160
K = np.array([[180.0, 0, 121.0], [0, 180.0, 78.0], [0, 0, 1]])
BENT = Camera(K, np.eye(3), np.zeros(3), WIDTH, HEIGHT, radial=(-0.15, 0.02))
x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float64), np.arange(HEIGHT, dtype=np.float64))


def painted(x: Float64s, y: Float64s) -> Uint8s:
    """A smooth RGB image, evaluated at any coordinates."""
    waves = [120 + 60 * np.sin(0.11 * x + k) + 50 * np.cos(0.09 * y - 0.05 * x + 2 * k) for k in range(3)]
    return np.stack(waves, axis=-1).clip(0, 255).astype(np.uint8)


def bent_frame() -> Frame:
    """The smooth image as the distorting lens shows it."""
    straight = without_distortion(BENT, np.column_stack([x.ravel(), y.ravel()]))
    u, v = (straight[:, k].reshape(x.shape) for k in (0, 1))
    return Frame(painted(u, v), np.ones((HEIGHT, WIDTH), np.bool_), View(WIDTH, HEIGHT, K, False))


def largest_error(image: Uint8s, expected: Uint8s, mask: Bools) -> float:
    return float(np.abs(image.astype(float) - expected)[mask].max())


def test_removing_distortion_inverts_adding_it() -> None:
    bend = residual_distortion(BENT)
    assert bend is not None
    u, v = distorted_pixels(bend, x, y)
    back = without_distortion(BENT, np.column_stack([u.ravel(), v.ravel()]).astype(np.float64))
    assert np.abs(back - np.column_stack([x.ravel(), y.ravel()])).max() < 1e-4


def test_a_distorted_frame_becomes_a_pinhole_image() -> None:
    frame = undistorted_frame(bent_frame(), BENT)
    assert largest_error(bent_frame().image, painted(x, y), frame.mask) > 40
    assert largest_error(frame.image, painted(x, y), frame.mask) <= 3
    assert 0.9 < frame.mask.mean() <= 1.0


@pytest.mark.parametrize("radial", [(0.0, 0.0), (-0.002, 0.0)])
def test_a_frame_with_negligible_distortion_stays_unchanged(radial: tuple[float, float]) -> None:
    frame, camera = bent_frame(), replace(BENT, radial=radial)
    assert undistorted_frame(frame, camera) is frame
    frames = {"gate": frame}
    assert undistorted_frames(frames, {"gate": camera, "roof": BENT}) is frames


def test_frames_are_straightened_when_they_are_accessed() -> None:
    frames = undistorted_frames({"gate": bent_frame(), "roof": bent_frame()}, {"gate": BENT})
    assert list(frames) == ["gate", "roof"] and len(frames) == 2
    assert largest_error(frames["gate"].image, painted(x, y), frames["gate"].mask) <= 3
    assert np.array_equal(frames["roof"].image, bent_frame().image)


def test_a_rectified_image_is_sampled_from_the_distorted_frame() -> None:
    H = np.array([[0.9, 0.05, 4.0], [-0.04, 0.95, 6.0], [1e-4, -1e-4, 1.0]])
    known = Rectification("hartley", "", H, H, (230, 150), (230, 150), 0.0, 10.0, 0.0, 0.0, 10.0)
    bent = replace(known, bend1=residual_distortion(BENT))
    frame = bent_frame()
    inside = np.all([warp_with_mask(each, 1, frame.image, frame.mask)[1] for each in (bent, known)], axis=0)
    assert inside.mean() > 0.6
    assert largest_error(warp(bent, 1, bent_frame().image), warp(known, 1, painted(x, y)), inside) <= 3
    assert largest_error(warp(bent, 2, painted(x, y)), warp(known, 2, painted(x, y)), inside) == 0


@pytest.mark.parametrize("radial", [(2.9, -18.5), (-3.0, 0.0), (0.2, 4.0), (-0.5, 0.05)])
def test_extreme_distortion_coefficients_give_finite_pixels(radial: tuple[float, float]) -> None:
    """An adjustment from few points may give such coefficients, whose model folds over within the frame."""
    camera = Camera(np.array([[600.0, 0, 239.5], [0, 600, 134.5], [0, 0, 1]]), np.eye(3), np.zeros(3), 480, 270, radial=radial)
    corners = np.array([[0.0, 0], [479, 0], [0, 269], [479, 269], [239.5, 134.5]])
    straight = without_distortion(camera, corners)
    assert np.isfinite(straight).all() and np.allclose(straight[4], corners[4])
    assert np.isfinite(residual_px(camera))

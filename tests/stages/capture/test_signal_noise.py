"""Noise of dark nights is measured in the captures and removed from their frame; daytime frames stay unchanged."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from wbflow_stages.capture.signal import capture_noise, denoised, remaining_noise
from wbflow_stages.frames import clean_frame
from wbflow_stages.types import Capture, Float32s, Lens, Uint8s

BENT = Lens(np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]]), np.array([-0.2, 0.05, 0, 0, 0]), None, 320, 240)


def scene() -> Float32s:
    """Boards and stripes, (240, 320, 3)."""
    image = np.zeros((240, 320, 3), np.float32)
    for row in range(6):
        for column in range(8):
            image[40 * row : 40 * row + 40, 40 * column : 40 * column + 40] = 50 + 17 * ((3 * row + 5 * column) % 7)
    image[:, ::9] += 40
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7), np.float32)


def noisy_capture(noise: float, seed: int) -> Capture:
    levels = scene() + np.random.default_rng(seed).normal(0, noise, (240, 320, 3))
    image = np.clip(levels + 0.5, 0, 255).astype(np.uint8)
    return Capture(f"{seed}.png", np.asarray(cv2.imencode(".png", image)[1], np.uint8).ravel())


def rms_error(image: Uint8s, truth: Uint8s) -> float:
    """Root mean square error without a border of 20 pixels, grey levels."""
    return float(np.sqrt(np.mean((image.astype(float) - truth)[20:-20, 20:-20] ** 2)))


@pytest.mark.parametrize("noise", [4.0, 11.0])
def test_noise_is_measured_before_distortion_is_removed(noise: float) -> None:
    frame = clean_frame([noisy_capture(noise, 1)], BENT, None)
    grey = noise * np.sqrt(0.299**2 + 0.587**2 + 0.114**2)  # weighted sum of three channels with independent noise
    assert frame.noise == pytest.approx(grey, rel=0.2)


@pytest.mark.parametrize("count", [1, 3, 5])
def test_a_noisy_night_frame_is_denoised_and_keeps_its_stripes(count: int) -> None:
    truth = clean_frame([noisy_capture(0, 0)], BENT, None).image
    frame = clean_frame([noisy_capture(24, seed) for seed in range(count)], BENT, None)
    assert any("denoised" in note for note in frame.notes)
    noisy = np.median([clean_frame([noisy_capture(24, seed)], BENT, None, denoise=False).image for seed in range(count)], axis=0)
    assert rms_error(frame.image, truth) < 0.7 * rms_error(noisy.astype(np.uint8), truth)
    stripes = frame.image[:, :, 1].astype(float).std(axis=1).mean() / truth[:, :, 1].astype(float).std(axis=1).mean()
    assert stripes > 0.9


def test_a_daytime_frame_is_not_denoised() -> None:
    captures = [noisy_capture(1.5, seed) for seed in range(3)]
    frame = clean_frame(captures, BENT, None)
    np.testing.assert_array_equal(frame.image, clean_frame(captures, BENT, None, denoise=False).image)
    assert not any("noisy" in note for note in frame.notes)


def test_clipped_pixels_are_ignored_when_noise_is_measured() -> None:
    grey = np.zeros((128, 128), np.float32)
    grey[64:] = 90 + np.random.default_rng(0).normal(0, 6, (64, 128))
    assert capture_noise(np.clip(grey, 0, 255)) == pytest.approx(6, rel=0.2)


def test_remaining_noise_falls_with_more_captures_and_smaller_frames() -> None:
    assert remaining_noise(10, 1, 1.0) > remaining_noise(10, 3, 1.0) > remaining_noise(10, 9, 1.0) > remaining_noise(10, 9, 0.5)
    medians = np.median(np.random.default_rng(0).normal(0, 1, (20_000, 5)), axis=1)
    assert remaining_noise(1, 5, 1.0) / remaining_noise(1, 1, 1.0) == pytest.approx(medians.std(), rel=0.03)


def test_denoising_the_same_frame_gives_the_same_bytes() -> None:
    image = clean_frame([noisy_capture(24, 1)], BENT, None).image
    np.testing.assert_array_equal(denoised(image, 5.0), denoised(image, 5.0))

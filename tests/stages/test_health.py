"""A camera is compared with its own reference: what happened to it, by how much, and no false alarms."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.helpers.dots import frame_of, texture
from wbflow_stages.core.rotations import rotation_matrix
from wbflow_stages.health import examine
from wbflow_stages.types import Frame, ShiftHistory

W, H, F = 480, 320, 500.0
K = np.array([[F, 0, (W - 1) / 2], [0, F, (H - 1) / 2], [0, 0, 1]])
WORLD = texture(2 * H, 2 * W, seed=3)


def seen(
    pan_deg: float = 0.0, tilt_deg: float = 0.0, roll_deg: float = 0.0, zoom: float = 1.0, world: np.ndarray = WORLD
) -> Frame:
    """A far image as a camera sees it after turning by exactly these angles, at this zoom."""
    R = turn(pan_deg, tilt_deg, roll_deg)
    far = np.array([[F, 0, W - 0.5], [0, F, H - 0.5], [0, 0, 1]])
    lens = K @ np.diag([1, 1, 1 / zoom])
    back = far @ R.T @ np.linalg.inv(lens)
    grey = cv2.warpPerspective(world, back, (W, H), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    frame = frame_of(grey)
    object.__setattr__(frame.view, "K", K)
    return frame


def turn(pan_deg: float, tilt_deg: float, roll_deg: float) -> np.ndarray:
    """(3, 3) rotation from the camera axes before to those after."""
    return rotation_matrix(np.radians([tilt_deg, pan_deg, roll_deg]))


def lit(frame: Frame, image: np.ndarray) -> Frame:
    """The same view in another light."""
    return Frame(np.clip(np.rint(image), 0, 255).astype(np.uint8), frame.mask, frame.view)


REFERENCE = seen()


def test_a_camera_without_a_reference_is_ok() -> None:
    assert examine(REFERENCE).state == "ok"


@pytest.mark.parametrize("light", ["same", "lamps", "noise", "shade"])
def test_a_camera_that_has_not_moved_is_ok_in_any_light(light: str) -> None:
    rng = np.random.default_rng(1)
    image = REFERENCE.image.astype(np.float64)
    x = np.linspace(0, 1, W)[None, :, None]
    tonight = {
        "same": image,
        "lamps": 12 + 0.35 * image * (0.2 + np.exp(-((x - 0.3) ** 2) / 0.05)),
        "noise": image + rng.normal(0, 12, image.shape),
        "shade": np.where(x > 0.5, 0.4 * image, image),
    }[light]
    found = examine(lit(REFERENCE, tonight), REFERENCE)
    assert found.state == "ok"
    assert "unverified" not in found.text
    assert float(found.figures["motion_px"]) < 0.3


@pytest.mark.parametrize("angles", [(0.25, 0.1, 0.0), (-0.1, 0.2, 0.15), (0.0, 0.0, 0.35)])
def test_a_small_turn_is_measured_with_its_standard_deviation(angles: tuple[float, float, float]) -> None:
    found = examine(seen(*angles), REFERENCE, nudged_px=0.5)
    assert found.state == "shifted"
    true = float(np.linalg.norm(angles))
    sigma = float(found.figures["turn_sigma_deg"])
    assert abs(float(found.figures["turn_deg"]) - true) < max(4 * sigma, 0.003)
    assert sigma < 0.02
    assert found.turn is not None
    assert np.abs(found.turn - turn(*angles)).max() < 2e-4
    assert found.homography is not None
    assert found.expected["motion_px"] == 0.5
    assert found.remedy


def test_a_small_turn_is_a_shift_and_a_larger_one_a_move() -> None:
    assert examine(seen(0.3), REFERENCE).state == "shifted"
    moved = examine(seen(0.6), REFERENCE)
    assert moved.state == "moved"
    assert float(moved.figures["turn_deg"]) == pytest.approx(0.6, rel=0.03)
    far = examine(seen(9.0), REFERENCE)
    assert far.state == "moved"
    assert float(far.figures["turn_deg"]) == pytest.approx(9.0, rel=0.05)


def test_a_changed_zoom_is_a_move() -> None:
    assert examine(seen(zoom=1.02), REFERENCE).state == "moved"


def test_usual_swaying_of_a_camera_is_not_reported_as_a_shift() -> None:
    swaying = ShiftHistory(np.array([-1.5, 2.0, 0.3, 1.8, -2.1, 0.9]), np.zeros(6), np.zeros(6))
    tonight = seen(0.25)
    assert examine(tonight, REFERENCE).state == "shifted"
    assert examine(tonight, REFERENCE, history=swaying).state == "ok"
    still = ShiftHistory(np.full(6, 0.1), np.zeros(6), np.zeros(6))
    assert examine(tonight, REFERENCE, history=still).state == "shifted"


@pytest.mark.parametrize("level", [2.0, 70.0])
def test_a_covered_or_unlit_lens_is_obscured(level: float) -> None:
    rng = np.random.default_rng(2)
    found = examine(lit(REFERENCE, rng.normal(level, 1.5, REFERENCE.image.shape)), REFERENCE)
    assert found.state == "obscured"
    assert float(found.figures["flat"]) > float(found.expected["flat"])


def test_another_scene_is_recognised_even_with_the_same_burned_in_clock() -> None:
    other = seen(world=texture(2 * H, 2 * W, seed=9))
    assert examine(other, REFERENCE).state == "wrong-scene"
    image = other.image.copy()
    image[4:40, 8:160] = REFERENCE.image[4:40, 8:160]
    assert examine(lit(other, image), REFERENCE).state == "wrong-scene"


def test_an_undecidable_camera_is_ok_but_unverified() -> None:
    other = seen(world=texture(2 * H, 2 * W, seed=9))
    found = examine(lit(other, 8 + 0.12 * other.image.astype(np.float64)), REFERENCE)
    assert found.state == "ok"
    assert "unverified" in found.text


def test_a_picture_of_another_size_counts_as_a_moved_camera() -> None:
    assert examine(frame_of(texture(100, 200)), REFERENCE).state == "moved"

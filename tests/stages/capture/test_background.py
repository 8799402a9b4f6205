"""The merged image of a night: what moves, what is doubtful, how frames are weighted, and which overlays are burned in."""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_stages.capture.background import merge
from wbflow_stages.capture.image_statistics import POOR, weigh
from wbflow_stages.types import Uint8s

WIDTH, HEIGHT = 320, 180
EVERYWHERE = np.ones((HEIGHT, WIDTH), np.bool_)


def scene(seed: int = 0) -> np.ndarray:
    """A detailed picture of middle brightness, (h, w, 3) float32."""
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(rng.uniform(40, 170, (12, 20, 3)).astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return np.asarray(coarse + cv2.GaussianBlur(rng.normal(0, 30, (HEIGHT, WIDTH, 3)).astype(np.float32), (0, 0), 0.8))


def shot(seed: int, exposure: float = 1.0, noise: float = 2.0) -> Uint8s:
    """A capture of the scene."""
    return as_bytes(scene() * exposure + np.random.default_rng(seed).normal(0, noise, (HEIGHT, WIDTH, 3)))


def as_bytes(picture: np.ndarray) -> Uint8s:
    return np.asarray(np.clip(np.rint(picture), 0, 255), np.uint8)


def test_only_areas_covered_in_most_frames_are_doubtful() -> None:
    frames = [shot(k, 0.95 + 0.02 * k) for k in range(5)]
    for k, frame in enumerate(frames):
        frame[20:50, 30 + 40 * k : 55 + 40 * k] = 20  # a pedestrian
        if k < 2:
            frame[100:140, 200:240] = 250  # two vans at the same place, one after the other
        elif k < 4:
            frame[100:140, 200:240] = 5
    found = merge(frames)
    assert found.doubtful[104:136, 204:236].all()
    assert found.doubtful[:90].sum() == 0, "what only one frame shows is outvoted"
    assert found.doubtful.mean() < 0.04
    assert np.abs(found.image[20:50].astype(float) - scene()[20:50] * 0.99).mean() < 4


def test_two_frames_merge_to_the_later_one_and_their_differences_are_doubtful() -> None:
    first, second = shot(1), shot(2, 1.1)
    second[60:100, 60:100] = 10
    found = merge([first, second])
    assert np.array_equal(found.image, second)
    assert found.doubtful[64:96, 64:96].all() and found.doubtful.mean() < 0.06


def test_frames_that_differ_everywhere_mark_nothing_as_doubtful() -> None:
    assert not merge([shot(0), as_bytes(scene(7)), as_bytes(scene(8))]).doubtful.any()


def test_identical_frames_are_distinguished_from_frames_with_noise() -> None:
    frame = shot(0)
    with_clock = frame.copy()
    with_clock[:12, :60] = 200
    assert merge([frame, with_clock, frame]).unchanged > 0.98
    assert merge([shot(k) for k in range(3)]).unchanged < 0.1


def test_blurred_blinded_and_dark_frames_get_low_weight_and_a_note() -> None:
    frames = [shot(k) for k in range(7)]
    frames[1] = as_bytes(cv2.GaussianBlur(frames[1], (0, 0), 4))
    frames[2][:, :120] = 255
    frames[3] = as_bytes(frames[3] * 0.3)
    weights, notes = weigh(frames, [f"gate_{k}.jpg" for k in range(7)], EVERYWHERE)
    assert weights.tolist() == [1, POOR, POOR, POOR, 1, 1, 1]
    assert [(note.split()[0], note.split()[2]) for note in notes] == [
        ("gate_1.jpg", "blurred"),
        ("gate_2.jpg", "blinded"),
        ("gate_3.jpg", "too"),
    ]


def test_frames_of_low_weight_are_outvoted() -> None:
    good, glare = [shot(k) for k in (1, 2)], [as_bytes(np.full((HEIGHT, WIDTH, 3), 90.0)) for _ in range(3)]
    weights = np.array([1, 1, POOR, POOR, POOR])
    error = np.abs(merge([*good, *glare], weights).image.astype(float) - scene()).mean()
    assert error < 5 < np.abs(merge([*good, *glare]).image.astype(float) - scene()).mean()


def with_text(frame: Uint8s, text: str, where: tuple[int, int]) -> Uint8s:
    cv2.putText(frame, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (230, 230, 230), 1, cv2.LINE_8)
    return frame


def test_a_burned_in_clock_is_found_when_the_light_changes() -> None:
    clock = [with_text(shot(k, 0.8 + 0.07 * k), f"GATE 12:0{k}:1{k}", (10, 20)) for k in range(4)]
    strokes = with_text(np.zeros((HEIGHT, WIDTH, 3), np.uint8), "GATE 12:0", (10, 20)).max(axis=2) > 0
    found = merge(clock).overlaid
    assert found[strokes].mean() > 0.9
    assert found.mean() < 0.05


def test_a_sign_in_the_scene_is_not_taken_for_an_overlay() -> None:
    def with_sign(k: int) -> Uint8s:
        return as_bytes(
            with_text(as_bytes(scene()), "TOR 2", (100, 90)) * (0.8 + 0.06 * k) + np.random.default_rng(k).normal(0, 2)
        )

    assert not merge([with_sign(k) for k in range(4)]).overlaid.any()
    assert not merge([shot(k) for k in range(4)]).overlaid.any(), "without a change of light nothing can be said"

"""A running clock in the images of a camera is reported, unless a mask hides it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from wbflow_stages.capture.clock import running_clock
from wbflow_stages.types import Uint8s

HEIGHT, WIDTH = 360, 640
TIMES = ("GATE 2026-11-19 21:03:17", "GATE 2026-11-19 21:18:42", "GATE 2026-11-19 21:33:58")


def night(texts: tuple[str, ...], y: int = 22, cars: bool = False) -> list[Uint8s]:
    """Captures of a noisy scene, with a line of text in each."""
    rng = np.random.default_rng(5)
    scene = 110 + 30 * cv2.GaussianBlur(rng.standard_normal((HEIGHT, WIDTH, 3)), (0, 0), 3.0) * 6
    captures = []
    for k, text in enumerate(texts):
        picture = np.asarray(np.clip(scene + rng.normal(0, 3, scene.shape), 0, 255), dtype=np.uint8)
        if cars:
            cv2.rectangle(picture, (60 + 150 * k, 320), (130 + 150 * k, 350), (235, 235, 235), -1)
        cv2.putText(picture, text, (8, y), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (245, 245, 240), 1, cv2.LINE_AA)
        captures.append(picture)
    return captures


@pytest.mark.parametrize("y", [22, 350])
def test_running_digits_are_found_at_the_top_and_at_the_bottom(y: int) -> None:
    found = running_clock(night(TIMES, y), np.ones((HEIGHT, WIDTH), np.bool_))
    assert found is not None
    left, top, width, height = found
    assert top <= y <= top + height + 3 and height < 20 and left < 20 and width > 120


def test_fixed_text_cars_single_captures_and_masked_clocks_are_not_reported() -> None:
    usable = np.ones((HEIGHT, WIDTH), np.bool_)
    assert running_clock(night(("GATE",) * 3), usable) is None
    assert running_clock(night(("",) * 3, cars=True), usable) is None
    assert running_clock(night(TIMES)[:1], usable) is None
    usable[:40] = False
    assert running_clock(night(TIMES), usable) is None


def paved(shadows: tuple[int | None, ...]) -> list[Uint8s]:
    """Captures of a row of bright and dark paving stones; `shadows`: leftmost column of each capture's shadow, None for none."""
    rng = np.random.default_rng(3)
    stones = np.repeat(np.where(rng.random(40) < 0.5, 220.0, 120.0), 16)
    scene = np.full((HEIGHT, WIDTH), 110.0)
    scene[330:342] = stones
    captures = []
    for left in shadows:
        picture = scene + rng.normal(0, 2, scene.shape)
        if left is not None:
            picture[300:, left : left + 60] *= 0.45
        captures.append(np.repeat(np.clip(picture, 0, 255).astype(np.uint8)[..., None], 3, axis=2))
    return captures


def test_shadows_that_cross_bright_paving_are_not_taken_for_digits() -> None:
    usable = np.ones((HEIGHT, WIDTH), np.bool_)
    assert running_clock(paved((None, 200, None)), usable) is None
    assert running_clock(paved((100, 260, 420)), usable) is None

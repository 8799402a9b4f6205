"""A learned matcher that a user supplies: what it finds, and the message for a file that is no such model."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from tests.helpers.made_up_model import POINTS, two_pictures
from wbflow_stages.matches import match
from wbflow_stages.types import Capture, Features, Float64s, Frame, Matches, Rejected, View

WIDTH, HEIGHT = 96, 64
SHIFT = np.array([8.0, -6.0])
PLACES = np.array([[12 + 6 * (i % 4) * 3, 16 + 16 * (i // 4)] for i in range(POINTS)], dtype=np.float64)


def dots(move: Float64s, times: int = 1) -> Frame:
    """Dots of different brightness, moved by `move`, with `times` as many pixels along each side."""
    image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    for k, (x, y) in enumerate((PLACES + move).astype(int)):
        image[y, x] = 255 - 10 * k
    image = np.repeat(np.repeat(image, times, axis=0), times, axis=1)
    return Frame(image, np.ones(image.shape[:2], dtype=bool), View(WIDTH * times, HEIGHT * times))


def no_features(frame: Frame) -> Features:
    empty = np.zeros(0, np.float32)
    return Features(
        np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 128), np.float32), empty, np.zeros(0, np.uint8), frame.view
    )


def model_capture(model: bytes) -> Capture:
    return Capture("mine.onnx", np.frombuffer(model, dtype=np.uint8))


def matched(left: Frame, right: Frame, model: bytes, **options: Any) -> Matches | Rejected:
    options |= {"left_frame": left, "right_frame": right, "model": model_capture(model)}
    return match(no_features(left), no_features(right), matcher="onnx", **options)


def test_a_learned_model_matches_points_of_two_pictures() -> None:
    left, right = dots(np.zeros(2)), dots(SHIFT)
    matches = matched(left, right, two_pictures(WIDTH, HEIGHT))
    assert isinstance(matches, Matches) and matches.i1 is None and matches.matcher == "onnx"
    np.testing.assert_array_equal(matches.x1, PLACES)
    np.testing.assert_array_equal(matches.x2, PLACES + SHIFT)
    assert (matches.probability > 0.99).all()


def test_points_of_a_model_of_fixed_size_are_scaled_to_frame_pixels() -> None:
    matches = matched(dots(np.zeros(2), times=4), dots(SHIFT), two_pictures(WIDTH, HEIGHT))
    assert isinstance(matches, Matches)
    np.testing.assert_allclose(matches.x1, 4 * PLACES + 1.5)  # the centre of a block of 4 x 4 pixels
    np.testing.assert_array_equal(matches.x2, PLACES + SHIFT)


def test_masked_points_and_points_of_low_score_are_not_matched() -> None:
    left, right = dots(np.zeros(2)), dots(SHIFT)
    left.mask[:20] = False  # the first of three rows of dots
    dim = right.image.copy()
    dim[dim == 205] = 178  # one dot has another brightness
    matches = matched(left, Frame(dim, right.mask, right.view), two_pictures(WIDTH, HEIGHT), min_score=0.99)
    assert isinstance(matches, Rejected) and matches.figures == {"matches": 7, "needed": 8}


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (b"no model at all", "mine.onnx: ONNX Runtime cannot read it: "),
        (two_pictures(WIDTH, HEIGHT)[:-40], "give the file that the model was exported to, whole"),
        (two_pictures(WIDTH, HEIGHT, image0="photo0"), "mine.onnx takes photo0 (1, 1, 64, 96), image1 (1, 1, 64, 96) and gives"),
        (
            two_pictures(WIDTH, HEIGHT, mscores0="somewhat"),
            "gives kpts0, kpts1, matches0, somewhat: a model of image0, image1 ->",
        ),
        (two_pictures(WIDTH, HEIGHT, channels=4), "takes image0 (1, 4, 64, 96)"),
        (two_pictures(WIDTH, HEIGHT, Floor="Flour"), "No Op registered for Flour"),
    ],
)
def test_an_unsuitable_model_is_refused_with_its_inputs_and_the_wanted_ones(model: bytes, words: str) -> None:
    with pytest.raises(ValueError) as caught:
        matched(dots(np.zeros(2)), dots(SHIFT), model)
    assert words in str(caught.value)


def test_the_onnx_matcher_without_a_model_is_refused() -> None:
    left = dots(np.zeros(2))
    with pytest.raises(TypeError, match="model"):
        match(no_features(left), no_features(left), left_frame=left, right_frame=left, matcher="onnx")


def test_without_the_package_the_message_tells_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'wbflow\[onnx\]'"):
        matched(dots(np.zeros(2)), dots(SHIFT), two_pictures(WIDTH + 32, HEIGHT))

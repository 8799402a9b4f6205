"""A learned matcher that a user supplies: what it finds, and the message for a file that is no such model."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from tests.helpers.made_up_model import POINTS, two_pictures
from wbflow_stages.matches import match
from wbflow_stages.matching.learned import read_interface, why_unreadable
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


def test_the_number_of_threads_changes_no_match_and_is_restored() -> None:
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(2)
        with_two = matched(dots(np.zeros(2)), dots(SHIFT), two_pictures(WIDTH, HEIGHT))
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(threads)
    with_default = matched(dots(np.zeros(2)), dots(SHIFT), two_pictures(WIDTH, HEIGHT))
    assert isinstance(with_two, Matches) and isinstance(with_default, Matches)
    assert (
        with_two.x1.tobytes() == with_default.x1.tobytes()
        and with_two.probability.tobytes() == with_default.probability.tobytes()
    )


def test_names_and_sizes_of_inputs_and_outputs_are_read_from_the_model() -> None:
    interface = read_interface(two_pictures(WIDTH, HEIGHT))
    assert interface.inputs == {"image0": (1, 1, HEIGHT, WIDTH), "image1": (1, 1, HEIGHT, WIDTH)}
    assert interface.outputs == ("kpts0", "kpts1", "matches0", "mscores0")
    assert read_interface(two_pictures()).inputs["image0"] == (1, 1, 0, 0)


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (b"no model at all", "mine.onnx is no ONNX model: give the file"),
        (two_pictures(WIDTH, HEIGHT)[:-40], "mine.onnx is no ONNX model: give the file"),
        (two_pictures(WIDTH, HEIGHT, image0="photo0"), "mine.onnx takes photo0 (1, 1, 64, 96), image1 (1, 1, 64, 96) and gives"),
        (
            two_pictures(WIDTH, HEIGHT, mscores0="somewhat"),
            "gives kpts0, kpts1, matches0, somewhat: a model of image0, image1 ->",
        ),
        (two_pictures(WIDTH, HEIGHT, channels=4), "takes image0 (1, 4, 64, 96)"),
        (two_pictures(WIDTH, HEIGHT, Floor="Flour"), "cannot run it"),
    ],
)
def test_an_unsuitable_model_is_refused_with_its_inputs_and_the_wanted_ones(model: bytes, words: str) -> None:
    with pytest.raises(ValueError) as caught:
        matched(dots(np.zeros(2)), dots(SHIFT), model)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("crash", "words"), [("os.abort()", "ends with SIGABRT while it reads it"), ("time.sleep(60)", "has not read it within")]
)
def test_a_model_that_crashes_or_hangs_its_reader_is_refused(monkeypatch: pytest.MonkeyPatch, crash: str, words: str) -> None:
    monkeypatch.setattr("wbflow_stages.matching.learned._READ", f"import os, time; {crash}")
    monkeypatch.setattr("wbflow_stages.matching.learned._LONGEST_S", 0.5)
    why_unreadable.cache_clear()
    with pytest.raises(ValueError, match=f"mine.onnx: OpenCV {words}.*erf"):
        matched(dots(np.zeros(2)), dots(SHIFT), two_pictures(WIDTH, HEIGHT))
    why_unreadable.cache_clear()


def test_the_onnx_matcher_without_a_model_is_refused() -> None:
    left = dots(np.zeros(2))
    with pytest.raises(TypeError, match="model"):
        match(no_features(left), no_features(left), left_frame=left, right_frame=left, matcher="onnx")

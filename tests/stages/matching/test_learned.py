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


def nothing(frame: Frame) -> Features:
    empty = np.zeros(0, np.float32)
    return Features(
        np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 128), np.float32), empty, np.zeros(0, np.uint8), frame.view
    )


def given(model: bytes) -> Capture:
    return Capture("mine.onnx", np.frombuffer(model, dtype=np.uint8))


def found(left: Frame, right: Frame, model: bytes, **options: Any) -> Matches | Rejected:
    options |= {"left_frame": left, "right_frame": right, "model": given(model)}
    return match(nothing(left), nothing(right), matcher="onnx", **options)


def test_points_of_the_two_pictures_are_matched() -> None:
    left, right = dots(np.zeros(2)), dots(SHIFT)
    matches = found(left, right, two_pictures(WIDTH, HEIGHT))
    assert isinstance(matches, Matches) and matches.i1 is None and matches.matcher == "onnx"
    np.testing.assert_array_equal(matches.x1, PLACES)
    np.testing.assert_array_equal(matches.x2, PLACES + SHIFT)
    assert (matches.probability > 0.99).all()


def test_a_model_of_a_size_sees_the_frame_in_that_size_and_its_points_are_in_pixels_of_the_frame() -> None:
    matches = found(dots(np.zeros(2), times=4), dots(SHIFT), two_pictures(WIDTH, HEIGHT))
    assert isinstance(matches, Matches)
    np.testing.assert_allclose(matches.x1, 4 * PLACES + 1.5)  # the centre of a block of 4 x 4 pixels
    np.testing.assert_array_equal(matches.x2, PLACES + SHIFT)


def test_what_a_mask_hides_and_what_the_model_doubts_is_no_match() -> None:
    left, right = dots(np.zeros(2)), dots(SHIFT)
    left.mask[:20] = False  # the first of three rows of dots
    dim = right.image.copy()
    dim[dim == 205] = 178  # one dot has another brightness
    matches = found(left, Frame(dim, right.mask, right.view), two_pictures(WIDTH, HEIGHT), min_score=0.99)
    assert isinstance(matches, Rejected) and matches.figures == {"matches": 7, "needed": 8}


def test_any_number_of_threads_finds_the_same_and_stays_as_it_was() -> None:
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(2)
        many = found(dots(np.zeros(2)), dots(SHIFT), two_pictures(WIDTH, HEIGHT))
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(threads)
    once = found(dots(np.zeros(2)), dots(SHIFT), two_pictures(WIDTH, HEIGHT))
    assert isinstance(many, Matches) and isinstance(once, Matches)
    assert many.x1.tobytes() == once.x1.tobytes() and many.probability.tobytes() == once.probability.tobytes()


def test_names_and_sizes_are_read_from_the_file() -> None:
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
def test_a_file_that_is_no_such_model_is_named_with_what_it_is_and_what_is_wanted(model: bytes, words: str) -> None:
    with pytest.raises(ValueError) as caught:
        found(dots(np.zeros(2)), dots(SHIFT), model)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("ends", "words"), [("os.abort()", "ends with SIGABRT while it reads it"), ("time.sleep(60)", "has not read it within")]
)
def test_a_model_that_takes_its_reader_along_costs_its_matches_only(
    monkeypatch: pytest.MonkeyPatch, ends: str, words: str
) -> None:
    monkeypatch.setattr("wbflow_stages.matching.learned._READ", f"import os, time; {ends}")
    monkeypatch.setattr("wbflow_stages.matching.learned._LONGEST_S", 0.5)
    why_unreadable.cache_clear()
    with pytest.raises(ValueError, match=f"mine.onnx: OpenCV {words}.*erf"):
        found(dots(np.zeros(2)), dots(SHIFT), two_pictures(WIDTH, HEIGHT))
    why_unreadable.cache_clear()


def test_without_a_model_the_matcher_says_that_it_needs_one() -> None:
    left = dots(np.zeros(2))
    with pytest.raises(TypeError, match="model"):
        match(nothing(left), nothing(left), left_frame=left, right_frame=left, matcher="onnx")

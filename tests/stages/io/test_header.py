"""The size that a header states is the size that decoding gives."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from wbflow_stages.io.header import picture_size


@pytest.mark.parametrize("form", [".png", ".jpg", ".tif", ".bmp", ".webp", ".ppm"])
def test_the_size_of_what_opencv_writes(form: str) -> None:
    image = np.random.default_rng(1).integers(0, 255, (37, 51, 3), np.uint8)
    data = cv2.imencode(form, image)[1].tobytes()
    assert picture_size(data) == (51, 37)


@pytest.mark.parametrize("form", [".png", ".jpg", ".tif", ".bmp", ".webp", ".ppm"])
def test_a_header_cut_short_states_nothing_or_the_truth(form: str) -> None:
    data = cv2.imencode(form, np.zeros((37, 51, 3), np.uint8))[1].tobytes()
    for end in range(64):
        assert picture_size(data[:end]) in {None, (51, 37)}


def test_a_header_may_promise_more_than_anybody_should_decode() -> None:
    bomb = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 30_000, 30_000, 8, 2, 0, 0, 0)
    assert picture_size(bomb) == (30_000, 30_000)


def test_what_is_no_picture_states_no_size() -> None:
    assert picture_size(b"") is None
    assert picture_size(b"no picture at all") is None

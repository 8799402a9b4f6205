"""The focal length that a camera wrote into its file."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from wbflow_stages.frames import clean_frame
from wbflow_stages.io.exif import focal_in_long_sides
from wbflow_stages.types import Capture, Lens


def photograph(order: str, focal_mm: int | None, width: int = 120, height: int = 80) -> np.ndarray:
    """A JPEG with an EXIF segment in the byte order "<" or ">"."""
    pixels = np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8)
    plain = cv2.imencode(".jpg", pixels)[1].tobytes()
    if focal_mm is None:
        return np.frombuffer(plain, np.uint8)
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8)
    directory = struct.pack(order + "HHHII", 1, 0x8769, 4, 1, 26) + struct.pack(order + "I", 0)
    exif = struct.pack(order + "HHHIHH", 1, 0xA405, 3, 1, focal_mm, 0) + struct.pack(order + "I", 0)
    body = b"Exif\0\0" + head + directory + exif
    segment = b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body
    return np.frombuffer(plain[:2] + segment + plain[2:], np.uint8)


@pytest.mark.parametrize("order", ["<", ">"])
def test_the_focal_length_is_read(order: str) -> None:
    assert focal_in_long_sides(photograph(order, 28)) == pytest.approx(28 / 36)


@pytest.mark.parametrize("data", [photograph("<", None), photograph("<", 28)[:30], np.zeros(0, np.uint8), np.zeros(99, np.uint8)])
def test_files_that_do_not_say_give_none(data: np.ndarray) -> None:
    assert focal_in_long_sides(data) is None


@pytest.mark.parametrize(("width", "height"), [(120, 80), (80, 120)])
def test_a_frame_guesses_its_lens_from_the_file(width: int, height: int) -> None:
    frame = clean_frame([Capture("a.jpg", photograph("<", 36, width, height))], Lens(), None, resolution=None)
    assert frame.view.K is not None and not frame.view.focal_known
    assert frame.view.K[0, 0] == pytest.approx(120)


def test_what_the_site_says_goes_before() -> None:
    frame = clean_frame([Capture("a.jpg", photograph("<", 36))], Lens(hfov_deg=90.0), None, resolution=None)
    assert frame.view.K is not None and frame.view.K[0, 0] == pytest.approx(60)

"""Headers of image files: the segments of a JPEG, and the focal length and image size stated there."""

from __future__ import annotations

import struct
from itertools import pairwise

import cv2
import numpy as np
import pytest

from wbflow_stages.frames import clean_frame
from wbflow_stages.io.image_headers import APP1, SCAN, focal_in_long_sides, jpeg_segments, picture_size
from wbflow_stages.types import Capture, Lens

JPEG = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (32, 48, 3), dtype=np.uint8))[1].tobytes()


def test_segments_are_contiguous_and_end_with_the_first_scan() -> None:
    found = list(jpeg_segments(JPEG))
    assert [marker for marker, _, _ in found].count(SCAN) == 1
    assert found[-1][0] == SCAN and found[-1][2] == len(JPEG)
    assert all(end == start - 4 for (_, _, end), (_, start, _) in pairwise(found))


def test_a_thumbnail_inside_a_segment_is_skipped() -> None:
    thumbnail = b"\xff\xe1" + (len(JPEG) + 2).to_bytes(2, "big") + JPEG
    whole = JPEG[:2] + thumbnail + JPEG[2:]
    found = list(jpeg_segments(whole))
    assert found[0][0] == APP1 and whole[slice(*found[0][1:])] == JPEG
    assert [marker for marker, _, _ in found[1:]] == [marker for marker, _, _ in jpeg_segments(JPEG)]


def test_fill_bytes_between_segments_are_skipped() -> None:
    filled = JPEG[:2] + b"\xff\xff" + JPEG[2:]
    assert [marker for marker, _, _ in jpeg_segments(filled)] == [marker for marker, _, _ in jpeg_segments(JPEG)]


def test_other_files_and_truncated_ones_have_no_scan() -> None:
    assert list(jpeg_segments(b"\x89PNG....")) == [] and list(jpeg_segments(b"")) == []
    scan = next(start for marker, start, _ in jpeg_segments(JPEG) if marker == SCAN)
    assert all(marker != SCAN for marker, _, _ in jpeg_segments(JPEG[: scan - 4]))


def photograph(order: str, focal_mm: int | None, width: int = 120, height: int = 80) -> np.ndarray:
    """A JPEG with an EXIF segment in the byte order "<" or ">", or without one if `focal_mm` is None."""
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
def test_the_focal_length_is_read_from_exif_in_both_byte_orders(order: str) -> None:
    assert focal_in_long_sides(photograph(order, 28)) == pytest.approx(28 / 36)


@pytest.mark.parametrize("data", [photograph("<", None), photograph("<", 28)[:30], np.zeros(0, np.uint8), np.zeros(99, np.uint8)])
def test_files_without_exif_have_no_focal_length(data: np.ndarray) -> None:
    assert focal_in_long_sides(data) is None


@pytest.mark.parametrize(("width", "height"), [(120, 80), (80, 120)])
def test_the_focal_length_of_a_frame_is_guessed_from_exif(width: int, height: int) -> None:
    frame = clean_frame([Capture("a.jpg", photograph("<", 36, width, height))], Lens(), None, resolution=None)
    assert frame.view.K is not None and not frame.view.focal_known
    assert frame.view.K[0, 0] == pytest.approx(120)


def test_a_stated_field_of_view_takes_precedence_over_exif() -> None:
    frame = clean_frame([Capture("a.jpg", photograph("<", 36))], Lens(hfov_deg=90.0), None, resolution=None)
    assert frame.view.K is not None and frame.view.K[0, 0] == pytest.approx(60)


@pytest.mark.parametrize("form", [".png", ".jpg", ".tif", ".bmp", ".webp", ".ppm"])
def test_the_size_of_images_written_by_opencv_is_read(form: str) -> None:
    image = np.random.default_rng(1).integers(0, 255, (37, 51, 3), np.uint8)
    data = cv2.imencode(form, image)[1].tobytes()
    assert picture_size(data) == (51, 37)


@pytest.mark.parametrize("form", [".png", ".jpg", ".tif", ".bmp", ".webp", ".ppm"])
def test_a_truncated_header_gives_no_size_or_the_right_one(form: str) -> None:
    data = cv2.imencode(form, np.zeros((37, 51, 3), np.uint8))[1].tobytes()
    for end in range(64):
        assert picture_size(data[:end]) in {None, (51, 37)}


def test_the_size_of_a_huge_image_is_read_without_decoding_it() -> None:
    bomb = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 30_000, 30_000, 8, 2, 0, 0, 0)
    assert picture_size(bomb) == (30_000, 30_000)


def test_files_that_are_not_images_have_no_size() -> None:
    assert picture_size(b"") is None
    assert picture_size(b"no picture at all") is None

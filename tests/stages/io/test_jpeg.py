"""Segments of a JPEG are stepped over as a whole; a thumbnail inside one is none of ours."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np

from wbflow_stages.io.jpeg import APP1, SCAN, jpeg_segments

JPEG = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (32, 48, 3), dtype=np.uint8))[1].tobytes()


def test_segments_follow_each_other_up_to_the_first_scan() -> None:
    found = list(jpeg_segments(JPEG))
    assert [marker for marker, _, _ in found].count(SCAN) == 1
    assert found[-1][0] == SCAN and found[-1][2] == len(JPEG)
    assert all(end == start - 4 for (_, _, end), (_, start, _) in pairwise(found))


def test_a_thumbnail_inside_a_segment_is_stepped_over() -> None:
    thumbnail = b"\xff\xe1" + (len(JPEG) + 2).to_bytes(2, "big") + JPEG
    whole = JPEG[:2] + thumbnail + JPEG[2:]
    found = list(jpeg_segments(whole))
    assert found[0][0] == APP1 and whole[slice(*found[0][1:])] == JPEG
    assert [marker for marker, _, _ in found[1:]] == [marker for marker, _, _ in jpeg_segments(JPEG)]


def test_fill_bytes_between_segments_are_passed_over() -> None:
    filled = JPEG[:2] + b"\xff\xff" + JPEG[2:]
    assert [marker for marker, _, _ in jpeg_segments(filled)] == [marker for marker, _, _ in jpeg_segments(JPEG)]


def test_other_files_and_cut_ones_have_no_scan() -> None:
    assert list(jpeg_segments(b"\x89PNG....")) == [] and list(jpeg_segments(b"")) == []
    scan = next(start for marker, start, _ in jpeg_segments(JPEG) if marker == SCAN)
    assert all(marker != SCAN for marker, _, _ in jpeg_segments(JPEG[: scan - 4]))

"""The segments of a JPEG file, without decoding it."""

from __future__ import annotations

from collections.abc import Iterator

SCAN, APP1 = 0xDA, 0xE1
"""Markers: where compressed data begins, and where EXIF stands."""


def jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """(marker, start, end) of each segment up to the first scan, which ends where the file does; nothing for other files.

    start: where the segment's content begins, behind marker and length.  A thumbnail inside a segment has markers of its own:
    whoever looks for one must step over whole segments.
    """
    at = 2 if data[:2] == b"\xff\xd8" else len(data)
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        end = len(data) if marker == SCAN else at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        yield marker, at + 4, end
        if marker == SCAN:
            return
        at = end

"""What an image file states in its header, read without decoding it: JPEG segments, EXIF focal length and time, size."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import Literal

from ..types import Capture, Uint8s

SCAN, APP1 = 0xDA, 0xE1
"""JPEG markers: the start of the compressed data, and the segment that holds EXIF."""


def jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """(marker, start, end) of each segment up to the first scan, which ends where the file does; nothing for other files.

    start: where the segment's content begins, behind marker and length.  A thumbnail inside a segment has markers of its own:
    a search for a marker must skip whole segments.
    """
    offset = 2 if data[:2] == b"\xff\xd8" else len(data)
    while offset + 4 <= len(data) and data[offset] == 0xFF:
        marker = data[offset + 1]
        if marker == 0xFF:  # fill byte
            offset += 1
            continue
        end = len(data) if marker == SCAN else offset + 2 + int.from_bytes(data[offset + 2 : offset + 4], "big")
        yield marker, offset + 4, end
        if marker == SCAN:
            return
        offset = end


EXIF_POINTER, FOCAL_LENGTH_35MM, TAKEN = 0x8769, 0xA405, 0x9003
FILM_WIDTH_MM = 36.0


def focal_in_long_sides(data: Uint8s) -> float | None:
    """Focal length as a multiple of the image's long side; None if the file doesn't state it.  data: the encoded bytes."""
    _, millimetres = _exif(data, FOCAL_LENGTH_35MM, 2)
    return millimetres / FILM_WIDTH_MM if millimetres else None


def taken_at(captures: Sequence[Capture]) -> list[datetime]:
    """When captures were taken according to the camera (EXIF DateTimeOriginal); captures without that are skipped."""
    return [moment for capture in captures if (moment := _time_taken(capture.data))]


def _time_taken(data: Uint8s) -> datetime | None:
    tiff, start = _exif(data, TAKEN, 4)
    if start is None:
        return None
    try:
        return datetime.strptime(tiff[start : start + 19].decode("ascii"), "%Y:%m:%d %H:%M:%S")
    except ValueError:  # no date, or a clock that was never set
        return None


def _exif(data: Uint8s, tag: int, size: int) -> tuple[bytes, int | None]:
    """The TIFF block of a JPEG's EXIF segment, and the value of a tag as a number of `size` bytes; None if it is missing."""
    head = bytes(data[:65536])
    segments = (head[start:end] for marker, start, end in jpeg_segments(head) if marker == APP1)
    tiff = next((segment[6:] for segment in segments if segment[:6] == b"Exif\0\0"), b"")
    byte_order: Literal["little", "big"] = "little" if tiff[:2] == b"II" else "big"

    def number(offset: int, size: int) -> int:
        return int.from_bytes(tiff[offset : offset + size], byte_order)

    def entry(directory: int, tag: int) -> int | None:
        """Offset of a tag's value."""
        for offset in range(directory + 2, directory + 2 + 12 * number(directory, 2), 12):
            if number(offset, 2) == tag and offset + 12 <= len(tiff):
                return offset + 8
        return None

    pointer = entry(number(4, 4), EXIF_POINTER)
    offset = None if pointer is None else entry(number(pointer, 4), tag)
    return tiff, None if offset is None else number(offset, size)


_NO_FRAME = {0xC4, 0xC8, 0xCC}
"""JPEG markers from C0 to CF that begin no frame (ITU-T T.81, table B.1)."""
_WIDTH, _HEIGHT = 256, 257
"""TIFF tags."""
_MOST_ENTRIES = 4096
"""Most entries of a TIFF directory that are read."""


def picture_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) in pixels before any EXIF rotation; None for other formats, or if the header is truncated."""
    try:
        if data[:8] == b"\x89PNG\r\n\x1a\n":
            width, height = struct.unpack_from(">II", data, 16)
        elif data[:2] == b"\xff\xd8":
            frame = next((s for marker, s, _ in jpeg_segments(data) if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME), None)
            if frame is None:
                return None
            height, width = struct.unpack_from(">HH", data, frame + 1)
        elif data[:4] in {b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"}:
            return _tiff_size(data)
        elif data[:2] == b"BM":
            width, height = struct.unpack_from("<ii", data, 18)
        elif data[:4] == b"RIFF" and data[8:12] == b"WEBP":
            return _webp_size(data)
        elif header := re.match(rb"P[1-6]\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s", data[:4096]):
            width, height = int(header[1]), int(header[2])
        else:
            return None
    except struct.error:
        return None
    return abs(width), abs(height)


def _tiff_size(data: bytes) -> tuple[int, int] | None:
    """Size in the first directory (TIFF 6.0, section 2; BigTIFF has longer fields)."""
    byte_order = "<" if data[:2] == b"II" else ">"
    is_bigtiff = data[2:4] in {b"+\0", b"\0+"}
    (offset,) = struct.unpack_from(byte_order + ("Q" if is_bigtiff else "I"), data, 8 if is_bigtiff else 4)
    (count,) = struct.unpack_from(byte_order + ("Q" if is_bigtiff else "H"), data, offset)
    first, step, value_offset = (offset + 8, 20, 12) if is_bigtiff else (offset + 2, 12, 8)
    values = {}
    for entry in range(first, first + step * min(count, _MOST_ENTRIES), step):
        tag, kind = struct.unpack_from(byte_order + "HH", data, entry)
        if tag in {_WIDTH, _HEIGHT}:
            field_format = {3: "H", 4: "I", 16: "Q"}.get(kind, "I")
            (values[tag],) = struct.unpack_from(byte_order + field_format, data, entry + value_offset)
    return (values[_WIDTH], values[_HEIGHT]) if len(values) == 2 else None


def _webp_size(data: bytes) -> tuple[int, int] | None:
    """Size by the kind of the first chunk (RFC 9649, section 2)."""
    if data[12:16] == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if data[12:16] == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if data[12:16] == b"VP8X" and len(data) >= 30:
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    return None

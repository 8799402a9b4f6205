"""The size of a picture as its header states it, without decoding: PNG, JPEG, TIFF (also BigTIFF), BMP, WebP, PNM."""

from __future__ import annotations

import re
import struct

from .jpeg import jpeg_segments

_NO_FRAME = {0xC4, 0xC8, 0xCC}
"""Markers among the JPEG's C0 to CF that begin no frame (ITU-T T.81, table B.1)."""
_WIDTH, _HEIGHT = 256, 257
"""TIFF tags."""
_MOST_ENTRIES = 4096
"""Entries of a TIFF directory that are looked at."""


def picture_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) in pixels before any EXIF rotation; None where the form is another, or the header is cut short."""
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
    """Of the first directory (TIFF 6.0, section 2; BigTIFF has longer fields)."""
    order = "<" if data[:2] == b"II" else ">"
    big = data[2:4] in {b"+\0", b"\0+"}
    (at,) = struct.unpack_from(order + ("Q" if big else "I"), data, 8 if big else 4)
    (count,) = struct.unpack_from(order + ("Q" if big else "H"), data, at)
    first, step, value = (at + 8, 20, 12) if big else (at + 2, 12, 8)
    found = {}
    for entry in range(first, first + step * min(count, _MOST_ENTRIES), step):
        tag, kind = struct.unpack_from(order + "HH", data, entry)
        if tag in {_WIDTH, _HEIGHT}:
            form = {3: "H", 4: "I", 16: "Q"}.get(kind, "I")
            (found[tag],) = struct.unpack_from(order + form, data, entry + value)
    return (found[_WIDTH], found[_HEIGHT]) if len(found) == 2 else None


def _webp_size(data: bytes) -> tuple[int, int] | None:
    """By kind of the first chunk (RFC 9649, section 2)."""
    if data[12:16] == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if data[12:16] == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if data[12:16] == b"VP8X" and len(data) >= 30:
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    return None

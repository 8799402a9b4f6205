"""The focal length that a camera wrote into its JPEG (EXIF 2.3, tag FocalLengthIn35mmFilm)."""

from __future__ import annotations

from typing import Literal

from ..types import Uint8s
from .jpeg import APP1, jpeg_segments

EXIF_POINTER, FOCAL_LENGTH_35MM = 0x8769, 0xA405
FILM_WIDTH_MM = 36.0


def focal_in_long_sides(data: Uint8s) -> float | None:
    """Focal length as a multiple of the image's long side; None where the file doesn't say.  data: the encoded bytes."""
    tiff = _tiff(bytes(data[:65536]))
    if tiff is None:
        return None
    order: Literal["little", "big"] = "little" if tiff[:2] == b"II" else "big"

    def number(at: int, size: int) -> int:
        return int.from_bytes(tiff[at : at + size], order)

    def entry(directory: int, tag: int) -> int | None:
        """Where the value of a tag stands."""
        for k in range(number(directory, 2)):
            at = directory + 2 + 12 * k
            if number(at, 2) == tag and at + 12 <= len(tiff):
                return at + 8
        return None

    pointer = entry(number(4, 4), EXIF_POINTER)
    value = None if pointer is None else entry(number(pointer, 4), FOCAL_LENGTH_35MM)
    millimetres = 0 if value is None else number(value, 2)
    return millimetres / FILM_WIDTH_MM if millimetres else None


def _tiff(data: bytes) -> bytes | None:
    """The TIFF block of a JPEG's EXIF segment."""
    for marker, start, end in jpeg_segments(data):
        if marker == APP1 and data[start : start + 6] == b"Exif\0\0":
            return data[start + 6 : end]
    return None

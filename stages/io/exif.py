"""What a camera wrote into its JPEG: focal length and time (EXIF 2.3, tags FocalLengthIn35mmFilm, DateTimeOriginal)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Literal

from ..types import Capture, Uint8s
from .jpeg import APP1, jpeg_segments

EXIF_POINTER, FOCAL_LENGTH_35MM, TAKEN = 0x8769, 0xA405, 0x9003
FILM_WIDTH_MM = 36.0


def focal_in_long_sides(data: Uint8s) -> float | None:
    """Focal length as a multiple of the image's long side; None where the file doesn't say.  data: the encoded bytes."""
    found = _exif(data, FOCAL_LENGTH_35MM)
    millimetres = found.number(found.at, 2) if found else 0
    return millimetres / FILM_WIDTH_MM if millimetres else None


def taken_at(captures: Sequence[Capture]) -> list[datetime]:
    """When captures were taken by what the camera wrote into them (EXIF DateTimeOriginal), as far as they say."""
    return [moment for capture in captures if (moment := _taken(capture.data))]


def _taken(data: Uint8s) -> datetime | None:
    found = _exif(data, TAKEN)
    if found is None:
        return None
    start = found.number(found.at, 4)
    try:
        return datetime.strptime(found.tiff[start : start + 19].decode("ascii"), "%Y:%m:%d %H:%M:%S")
    except ValueError:  # no date, or a clock that was never set
        return None


@dataclass(frozen=True)
class _Entry:
    """An entry of the EXIF directory."""

    tiff: bytes
    at: int
    """Where its value stands."""
    order: Literal["little", "big"]

    def number(self, at: int, size: int) -> int:
        return int.from_bytes(self.tiff[at : at + size], self.order)


def _exif(data: Uint8s, tag: int) -> _Entry | None:
    """The entry of a tag; None where the file has none."""
    tiff = _tiff(bytes(data[:65536]))
    if tiff is None:
        return None
    here = _Entry(tiff, 0, "little" if tiff[:2] == b"II" else "big")

    def entry(directory: int, tag: int) -> int | None:
        """Where the value of a tag stands."""
        for k in range(here.number(directory, 2)):
            at = directory + 2 + 12 * k
            if here.number(at, 2) == tag and at + 12 <= len(tiff):
                return at + 8
        return None

    pointer = entry(here.number(4, 4), EXIF_POINTER)
    at = None if pointer is None else entry(here.number(pointer, 4), tag)
    return None if at is None else replace(here, at=at)


def _tiff(data: bytes) -> bytes | None:
    """The TIFF block of a JPEG's EXIF segment."""
    for marker, start, end in jpeg_segments(data):
        if marker == APP1 and data[start : start + 6] == b"Exif\0\0":
            return data[start + 6 : end]
    return None

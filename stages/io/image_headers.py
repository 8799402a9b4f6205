"""What an image file states in its header, read without decoding it: format, size, JPEG segments, EXIF focal length and time."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import Literal

from ..types import Capture, Uint8s

SCAN = 0xDA
"""JPEG marker: compressed data begins."""
APP1 = 0xE1
"""JPEG marker: the segment that holds EXIF data."""
_START_OF_IMAGE = 0xD8
_END_OF_IMAGE = 0xD9
_RESTARTS = range(0xD0, 0xD8)
"""JPEG markers within compressed data (RST0 to RST7), which have no length."""

_JPEG_START = b"\xff\xd8\xff"
_PNG_START = b"\x89PNG\r\n\x1a\n"
_TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_HEIF_BRANDS = (b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1")
"""Major brands of HEIC files (ISO/IEC 23008-12): coded as H.265."""
_IMAGE_BRANDS = (*_HEIF_BRANDS, b"avif", b"avis")
_OTHER_KINDS = {
    b"\xff\x0a": "a JPEG XL image",
    b"\x00\x00\x00\x0cJXL ": "a JPEG XL image",
    b"PK\x03\x04": "a ZIP archive",
    b"\x1f\x8b": "a compressed file (gzip)",
    b"%PDF": "a PDF document",
}
"""First bytes of files that people take for images."""
MOST_LEADING_BYTES = 512
"""Most bytes before a JPEG that are skipped: the header of a stream's part is shorter, an EXIF thumbnail lies behind more."""


def jpeg_offset(data: bytes) -> int | None:
    """Where a JPEG begins: 0, or behind a few bytes that a recorder has left before it; None for other files.

    A JPEG that begins inside the segments of another one, whose own beginning is lost, is a thumbnail and does not count.
    """
    offset = data.find(_JPEG_START, 0, MOST_LEADING_BYTES + len(_JPEG_START))
    if offset < 0:
        return None
    leading = data[:offset]
    if b"Exif" in leading or b"JFIF" in leading or leading[:4] in {b"RIFF", *_TIFF_STARTS} or leading[4:8] == b"ftyp":
        return None
    return offset


def jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """(marker, start, end) of each segment up to the first scan, which ends where the file does; nothing for other files.

    start: where the segment's content begins, behind marker and length.  A thumbnail inside a segment has markers of its own:
    a search for a marker must skip whole segments.  Bytes between segments that belong to none are skipped, as decoders do.
    """
    if data[:2] != b"\xff\xd8":
        return
    offset = 2
    while True:
        offset = _next_marker(data, offset)
        if offset + 4 > len(data):
            return
        marker = data[offset + 1]
        start = offset + 4
        if marker == SCAN:
            yield marker, start, len(data)
            return
        end = offset + 2 + int.from_bytes(data[offset + 2 : offset + 4], "big")
        yield marker, start, end
        offset = end


def _next_marker(data: bytes | bytearray, offset: int) -> int:
    """Offset of the next marker (0xFF, then neither 0x00 nor 0xFF), or of the end of the data."""
    while True:
        offset = data.find(b"\xff", offset)
        if offset < 0 or offset + 1 >= len(data):
            return len(data)
        if data[offset + 1] not in {0x00, 0xFF}:
            return offset
        offset += 1


def jpeg_end(data: bytes) -> int | None:
    """Offset behind the end marker of the JPEG that `data` begins with; None if the marker has not arrived.

    Compressed data holds markers only between scans and for restarts: an end marker inside a segment (of a thumbnail) or behind
    the picture is not taken for that of the picture.
    """
    if data[:2] != b"\xff\xd8":
        return None
    offset, is_complete = read_jpeg(data, 2)
    return offset if is_complete else None


def read_jpeg(data: bytes | bytearray, offset: int) -> tuple[int, bool]:
    """Read a JPEG marker by marker, as `jpeg_end` does, from an offset on: (offset, is it complete?).

    offset: behind the start marker, or what an earlier call returned when less had arrived.  The offset that is returned is that
    behind the picture, or where to read on when more has arrived: no byte is read twice, however large the picture is.
    """
    while True:
        place = _next_marker(data, offset)
        if place >= len(data):
            # the last byte may be the first one of a marker; the segment that is read may end behind the data
            return max(offset, len(data) - 1), False
        offset = place
        marker = data[offset + 1]
        if marker == _START_OF_IMAGE:  # the next picture: this one has no end marker
            return offset, True
        if marker == _END_OF_IMAGE:
            return offset + 2, True
        if marker in _RESTARTS or marker == 0x01:
            offset += 2
            continue
        if offset + 4 > len(data):
            return offset, False
        # every other marker begins a segment with a length; the data of a scan follow its segment
        offset += 2 + int.from_bytes(data[offset + 2 : offset + 4], "big")


def is_truncated(data: bytes) -> bool:
    """Does a JPEG file lack an end marker behind the beginning of a scan, or a PNG file its last chunk?  False for others."""
    if data[:3] == _JPEG_START:
        scans = [start for marker, start, _ in jpeg_segments(data) if marker == SCAN]
        return not scans or data.find(b"\xff\xd9", scans[0]) < 0
    if data[:8] == _PNG_START:
        return data.rfind(b"IEND") < 0
    return False


def is_image(data: bytes) -> bool:
    """Does a file begin as an image does, whatever its name says?"""
    if data[:8] == _PNG_START or data[:4] in _TIFF_STARTS:
        return True
    if data[:6] in {b"GIF87a", b"GIF89a"} or data[:2] == b"BM" or data[4:8] == b"jP  ":
        return True
    if _PNM_HEADER.match(data[:4096]):
        return True
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return True
    if data[4:8] == b"ftyp" and data[8:12] in _IMAGE_BRANDS:
        return True
    return data[:3] == _JPEG_START


def other_content(data: bytes) -> str:
    """What a file holds instead of an image, by its first bytes, in words that follow its name; "" if unknown."""
    text = data.lstrip(b"\xef\xbb\xbf \r\n\t")
    if text.startswith(b"<"):
        shown = " ".join(text[:60].decode("latin-1").split())
        return f"is a web page, not a picture: {shown!r}; it may say what the camera, or the server, wanted"
    for start, kind in _OTHER_KINDS.items():
        if data.startswith(start):
            return f"is {kind}, which is not read: have the camera write JPEG or PNG"
    return ""


def is_heic(data: bytes) -> bool:
    """Is a file a HEIC image, as phones write it?  (Files of brand `mif1` may hold AVIF as well, which lists its brand.)"""
    return data[4:8] == b"ftyp" and data[8:12] in _HEIF_BRANDS and b"avif" not in data[8:64]


def is_video(data: bytes) -> bool:
    """Does a file begin as a video does (MP4, AVI, Matroska, MPEG program or transport stream, H.264), whatever its name says?"""
    if data[4:8] in {b"ftyp", b"moov", b"mdat", b"moof"}:
        return data[8:12] not in _IMAGE_BRANDS
    if data[:4] == b"RIFF" and data[8:12] == b"AVI ":
        return True
    if data[:4] in {b"\x1aE\xdf\xa3", b"\0\0\1\xba"}:
        return True
    if data[:5] in {b"\0\0\0\1g", b"\0\0\0\1\x27"}:  # H.264: a sequence parameter set
        return True
    return len(data) > 376 and data[0] == data[188] == data[376] == 0x47  # a transport stream: packets of 188 bytes


EXIF_POINTER = 0x8769
"""EXIF tag: where the directory of photographic data lies."""
FOCAL_LENGTH_35MM = 0xA405
"""EXIF tag: the focal length, millimetres, of a lens with the same field of view on a film of 36 mm x 24 mm."""
TAKEN = 0x9003
"""EXIF tag: when the picture was taken (DateTimeOriginal)."""
FILM_WIDTH_MM = 36.0
"""Long side of that film."""


def focal_in_long_sides(data: Uint8s) -> float | None:
    """Focal length as a multiple of the image's long side; None if the file doesn't state it.  data: the encoded bytes."""
    _, millimetres = _exif(data, FOCAL_LENGTH_35MM, 2)
    if not millimetres:  # 0 means unknown
        return None
    return millimetres / FILM_WIDTH_MM


def taken_at(captures: Sequence[Capture]) -> list[datetime]:
    """When captures were taken according to the camera (EXIF DateTimeOriginal); captures without that are skipped."""
    moments = []
    for capture in captures:
        moment = _time_taken(capture.data)
        if moment is not None:
            moments.append(moment)
    return moments


def _time_taken(data: Uint8s) -> datetime | None:
    """When a picture was taken, by its EXIF data; None if that does not say."""
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
    tiff = b""
    for marker, start, end in jpeg_segments(head[jpeg_offset(head) or 0 :]):
        segment = head[start:end]
        if marker == APP1 and segment[:6] == b"Exif\0\0":
            tiff = segment[6:]
            break
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
    if pointer is None:
        return tiff, None
    offset = entry(number(pointer, 4), tag)
    if offset is None:
        return tiff, None
    return tiff, number(offset, size)


_NO_FRAME = {0xC4, 0xC8, 0xCC}
"""JPEG markers from C0 to CF that begin no frame (ITU-T T.81, table B.1)."""
_PNM_HEADER = re.compile(rb"P[1-6]\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(?:#[^\n]*\n\s*)*(\d{1,5})?")
"""Width, height and, except in bitmaps, the largest value of a PBM, PGM or PPM file."""


def picture_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) in pixels before any EXIF rotation; None for other formats, or if the header is truncated."""
    try:
        if data[:8] == _PNG_START:
            width, height = struct.unpack_from(">II", data, 16)
        elif data[:2] == b"\xff\xd8":
            return _jpeg_size(data)
        elif data[:4] in _TIFF_STARTS:
            return _tiff_size(data)
        elif data[:2] == b"BM":
            width, height = struct.unpack_from("<ii", data, 18)
        elif data[:4] == b"RIFF" and data[8:12] == b"WEBP":
            return _webp_size(data)
        else:
            header = _PNM_HEADER.match(data[:4096])
            if header is None:
                return None
            width = int(header[1])
            height = int(header[2])
    except struct.error:
        return None
    return abs(width), abs(height)  # the height of a BMP is negative if its first row is the top one


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Size in the header of the frame (ITU-T T.81, B.2.2)."""
    for marker, start, _ in jpeg_segments(data):
        if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME:
            height, width = struct.unpack_from(">HH", data, start + 1)
            return width, height
    return None


_SUBFILE_TYPE = 254
_WIDTH = 256
_HEIGHT = 257
_BITS_PER_SAMPLE = 258
_LARGEST_VALUE = 281
_DNG_VERSION = 50706
"""TIFF tags."""
_MOST_ENTRIES = 4096
"""Most entries of a TIFF directory that are read."""


def _tiff_size(data: bytes) -> tuple[int, int] | None:
    """Size of the first picture of a TIFF."""
    tags = _tiff_tags(data)
    if _WIDTH in tags and _HEIGHT in tags:
        return tags[_WIDTH], tags[_HEIGHT]
    return None


def _tiff_tags(data: bytes) -> dict[int, int]:
    """First value of each whole-number tag of the first directory (TIFF 6.0, section 2; BigTIFF has longer fields).

    Raises struct.error if the directory is not there.
    """
    byte_order = "<" if data[:2] == b"II" else ">"
    # `struct` formats of offsets and of the number of entries, and where the offset of the directory lies
    pointer = "I"
    count_format = "H"
    header = 4
    if data[2:4] in {b"+\0", b"\0+"}:  # BigTIFF
        pointer = "Q"
        count_format = "Q"
        header = 8
    (directory,) = struct.unpack_from(byte_order + pointer, data, header)
    (entries,) = struct.unpack_from(byte_order + count_format, data, directory)
    room = struct.calcsize(pointer)
    step = 4 + 2 * room  # tag and kind of 2 bytes, number of values, values or where they lie
    first = directory + struct.calcsize(count_format)
    tags: dict[int, int] = {}
    for entry in range(first, first + step * min(entries, _MOST_ENTRIES), step):
        tag, kind, values = struct.unpack_from(byte_order + "HH" + pointer, data, entry)
        number_format = _TIFF_NUMBERS.get(kind)
        if number_format is None:
            continue
        offset = entry + 4 + room
        if values * struct.calcsize(number_format) > room:
            (offset,) = struct.unpack_from(byte_order + pointer, data, offset)
        if offset + room <= len(data):
            (tags[tag],) = struct.unpack_from(byte_order + number_format, data, offset)
    return tags


_TIFF_NUMBERS = {1: "B", 3: "H", 4: "I", 16: "Q"}
"""`struct` formats of TIFF's kinds of whole numbers."""


def is_raw_photograph(data: bytes) -> bool:
    """Is a TIFF file the raw data of a camera (DNG, NEF, CR2, ARW), whose first picture is a preview or a thumbnail?"""
    if data[:4] not in _TIFF_STARTS:
        return False
    if data[8:10] == b"CR":  # Canon
        return True
    try:
        tags = _tiff_tags(data)
    except struct.error:
        return False
    is_reduced = bool(tags.get(_SUBFILE_TYPE, 0) & 1)
    return is_reduced or _DNG_VERSION in tags


def largest_stated_value(data: bytes) -> int | None:
    """The value that stands for white according to the header of a PGM, PPM or TIFF; None if the file does not state it."""
    if data[:4] in _TIFF_STARTS:
        try:
            return _tiff_tags(data).get(_LARGEST_VALUE)
        except struct.error:
            return None
    header = _PNM_HEADER.match(data[:4096])
    if header is None or header[3] is None or data[:2] in {b"P1", b"P4"}:
        return None
    return int(header[3])


def has_deep_values(data: bytes) -> bool:
    """Does the header of a PNG, PGM, PPM or TIFF state values of more than 8 bits?"""
    if data[:8] == _PNG_START:
        return data[24:25] == b"\x10"
    if data[:4] in _TIFF_STARTS:
        try:
            return _tiff_tags(data).get(_BITS_PER_SAMPLE, 1) > 8
        except struct.error:
            return False
    return (largest_stated_value(data) or 0) > 255


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

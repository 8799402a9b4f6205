"""Images as files, for tests."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt


def read_image(file: Path, flags: int = cv2.IMREAD_COLOR) -> npt.NDArray[Any]:
    """The pixels of an image file, as OpenCV reads them (BGR); the test fails if it cannot."""
    pixels = cv2.imread(str(file), flags)
    assert pixels is not None, f"{file} is no image"
    return pixels


def decoded(data: bytes, flags: int = cv2.IMREAD_COLOR) -> npt.NDArray[Any]:
    """The pixels of an image file's bytes, as OpenCV reads them (BGR)."""
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    assert pixels is not None
    return pixels


def with_exif(jpeg: bytes, taken: str) -> bytes:
    """The JPEG with the time `taken`, such as 2010:10:12 14:03:00, as EXIF DateTimeOriginal."""
    ifd = struct.pack("<HHHIII", 1, 0x8769, 4, 1, 26, 0)
    exif = struct.pack("<HHHIII", 1, 0x9003, 2, len(taken) + 1, 44, 0)
    body = b"Exif\0\0" + struct.pack("<2sHI", b"II", 42, 8) + ifd + exif + taken.encode() + b"\0"
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:]

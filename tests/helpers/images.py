"""Images as files, for tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt


def read_image(file: Path, flags: int = cv2.IMREAD_COLOR) -> npt.NDArray[Any]:
    """The pixels as OpenCV reads them (BGR); a file that it cannot read is a failure of the test."""
    pixels = cv2.imread(str(file), flags)
    assert pixels is not None, f"{file} is no image"
    return pixels


def decoded(data: bytes, flags: int = cv2.IMREAD_COLOR) -> npt.NDArray[Any]:
    """The pixels of an image file's bytes, as OpenCV reads them (BGR)."""
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    assert pixels is not None
    return pixels

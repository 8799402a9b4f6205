"""Image files as pixels.  Files from the field may be empty, truncated, black or from another camera: each case has its error."""

from __future__ import annotations

import cv2
import numpy as np

from ..io.image_headers import SCAN, jpeg_segments, picture_size
from ..types import Capture, Lens, Uint8s

MOST_PIXELS = 200_000_000
"""Largest image that is decoded if its size is stated: 0.6 GB, and twice that while the channels are reordered."""
MOST_UNSTATED_PIXELS = 110_000_000
"""Largest image that is decoded if its size is not stated: as large as fixed cameras deliver, and seconds to decode."""
MOST_JPEG_PIXELS_A_BYTE = 1000
"""Most pixels per byte of a JPEG file: 64 pixels take at least a bit (ITU-T T.81, F.1.2).  A black PNG may hold thousands."""
FEW_PIXELS = 10_000_000
"""Up to this size, the ratio of pixels to bytes is not checked."""
MOST_MISSING = 0.1
"""Largest share of an image's rows that may be of one colour at its lower end; caption bars are lower."""


class BadCapture(ValueError):
    """A capture that can't be used."""


class EmptyCapture(BadCapture):
    """The file has no bytes."""


class NotAnImage(BadCapture):
    """The bytes cannot be decoded as an image."""


class TruncatedImage(BadCapture):
    """The file ends before the image does, or the image content ends above the lower edge."""


class FeaturelessImage(BadCapture):
    """Black, white or uniform: nothing to see."""


class OversizedImage(BadCapture):
    """The image has more pixels than are decoded: a few bytes can claim gigabytes."""


class WrongSize(BadCapture):
    """The size differs from that of the intrinsics, the mask or the night's other captures."""


def decode(capture: Capture, lens: Lens | None = None) -> Uint8s:
    """Decode an image file into (h, w, 3) uint8 RGB, rotated upright by its EXIF data.

    lens: if it states the size of captures, a file whose header gives another size is not decoded.  Raises BadCapture for a
    file that is empty, not an image, truncated, too large, of another size, or without content (black, white, uniform).
    """
    data = np.ascontiguousarray(capture.data)
    if data.size == 0:
        raise EmptyCapture(f"{capture.name} is empty (0 bytes)")
    file_bytes = data.tobytes()
    refuse_truncated(capture.name, file_bytes)
    _refuse_size(capture.name, file_bytes, lens)
    image = decoded(capture.name, data, cv2.IMREAD_COLOR)
    refuse_unfinished(capture.name, image)
    refuse_featureless(capture.name, image)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def wrong_size(name: str, width: int, height: int, lens: Lens) -> WrongSize:
    """The error for an image whose size differs from that of its intrinsics.

    Parameters
    ----------
    name : of the capture.
    width, height : of the image, pixels.
    lens : states the expected size.
    """
    is_turned = (height, width) == (lens.width, lens.height)
    remedy = "state the intrinsics for the size captured, or set the camera back"
    if is_turned:
        remedy = "is the camera turned, or the EXIF orientation wrong?"
    return WrongSize(f"{name} has {width} x {height} pixels, the intrinsics are for {lens.width} x {lens.height}: {remedy}")


def _refuse_size(name: str, data: bytes, lens: Lens | None) -> None:
    """Raises BadCapture by the header alone, before time and memory are spent on decoding.

    Width and height may be swapped, as the EXIF data may rotate the image.
    """
    if (size := picture_size(data)) is None:
        return
    width, height = size
    size_stated = bool(lens and lens.width and lens.height)
    if size_stated and lens and sorted(size) != sorted((lens.width, lens.height)):
        raise wrong_size(name, width, height, lens)
    if data[:2] == b"\xff\xd8" and width * height > max(FEW_PIXELS, len(data) * MOST_JPEG_PIXELS_A_BYTE):
        raise OversizedImage(f"{name} promises {width} x {height} pixels, which {len(data):,} bytes cannot hold")
    limit = MOST_PIXELS if size_stated else MOST_UNSTATED_PIXELS
    if width * height > limit:
        how = "" if size_stated else " as long as its intrinsics do not state its size"
        raise OversizedImage(f"{name} has {width} x {height} pixels, {limit // 10**6} million are the most that are decoded{how}")


def refuse_truncated(name: str, data: bytes) -> None:
    """Raises TruncatedImage for JPEG without end marker or PNG without last chunk: decoders pad them with grey and only warn."""
    if data[:3] == b"\xff\xd8\xff":
        scan = next((start for marker, start, _ in jpeg_segments(data) if marker == SCAN), None)
        is_complete = scan is not None and data.find(b"\xff\xd9", scan) >= 0
    elif data[:8] == b"\x89PNG\r\n\x1a\n":
        is_complete = data.rfind(b"IEND") >= 0
    else:
        return
    if not is_complete:
        raise TruncatedImage(f"{name} ends after {len(data):,} bytes: the image is truncated")


def refuse_unfinished(name: str, image: Uint8s) -> None:
    """Raises TruncatedImage if the lower end is of one colour: recorders that lost a part of an image pad it in a complete file.

    Black and white are exempt (letter box, night, sky), and so is a colour that the upper edge has as well: the background of a
    drawing.
    """
    last_pixel = image[-1, -1]
    if last_pixel.max() < 24 or last_pixel.min() > 231 or (image[0] == last_pixel).all():
        return
    last_row = next((row for row in range(len(image) - 1, -1, -1) if (image[row] != last_pixel).any()), None)
    missing = 0.0 if last_row is None else 1.0 - (last_row + 1) / len(image)  # one colour everywhere: see `refuse_featureless`
    if missing > MOST_MISSING:
        raise TruncatedImage(f"{name} is unfinished: the lower {100 * missing:.0f} % of it are of one colour")


def decoded(name: str, data: Uint8s, flags: int) -> Uint8s:
    """Pixels as OpenCV reads them (BGR).  Raises NotAnImage if it cannot."""
    try:
        image = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        image = None
    if image is None:
        raise NotAnImage(f"{name} is no image that can be read ({data.size:,} bytes)")
    return np.asarray(image, dtype=np.uint8)


def refuse_featureless(name: str, image: Uint8s) -> None:
    """Raises FeaturelessImage for an image that is black, white or uniform.

    Averaging over cells removes sensor noise; cells that then span less than six grey levels show nothing.
    """
    cells = cv2.resize(image, (48, 32), interpolation=cv2.INTER_AREA).astype(np.float32).mean(axis=2)
    low, high = np.percentile(cells, [1, 99])
    if high - low >= 6:
        return
    look = "black" if high < 24 else "white" if low > 231 else "uniform"
    raise FeaturelessImage(f"{name} is {look}: nothing can be seen in it; check the camera, its lens and its lighting")

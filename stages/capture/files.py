"""Image files as pixels.  Files from the field arrive empty, cut short, black or from another camera: each case has its name."""

from __future__ import annotations

import cv2
import numpy as np

from ..io.image_headers import SCAN, jpeg_segments, picture_size
from ..types import Capture, Lens, Uint8s

MOST_PIXELS = 200_000_000
"""Of an image that is decoded: 0.6 GB, and twice that while colours are put in order."""
MOST_UNSTATED_PIXELS = 110_000_000
"""Of one whose size nobody has stated: what cameras that stand somewhere have; it takes seconds to decode."""
MOST_JPEG_PIXELS_A_BYTE = 1000
"""Each block of 64 pixels takes a bit at least (ITU-T T.81, F.1.2); a black PNG may hold thousands of pixels in a byte."""
FEW_PIXELS = 10_000_000
"""Of these, no byte is counted."""
MOST_MISSING = 0.1
"""Share of a picture's rows that may be of one colour at its lower end; a caption's bar is lower."""


class BadCapture(ValueError):
    """A capture that can't be used."""


class EmptyCapture(BadCapture):
    """The file has no bytes."""


class NotAnImage(BadCapture):
    """The bytes are no image that can be decoded."""


class TruncatedImage(BadCapture):
    """The file ends before the image does, or the picture before its lower edge."""


class FeaturelessImage(BadCapture):
    """Black, white or uniform: nothing to see."""


class OversizedImage(BadCapture):
    """More pixels than are decoded: a few bytes can promise gigabytes."""


class WrongSize(BadCapture):
    """Not the size that the intrinsics, the mask or the night's other captures have."""


def decode(capture: Capture, lens: Lens | None = None) -> Uint8s:
    """Decode an image file into (h, w, 3) uint8 RGB, turned upright as its EXIF data say.

    lens: where it states the size of captures, one whose header promises another is not decoded at all.  Raises BadCapture for
    what is empty, no image, truncated, too large, of another size, or without any content (black, white, uniform).
    """
    data = np.ascontiguousarray(capture.data)
    if data.size == 0:
        raise EmptyCapture(f"{capture.name} is empty (0 bytes)")
    written = data.tobytes()
    refuse_truncated(capture.name, written)
    _refuse_size(capture.name, written, lens)
    image = decoded(capture.name, data, cv2.IMREAD_COLOR)
    refuse_unfinished(capture.name, image)
    refuse_featureless(capture.name, image)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def wrong_size(name: str, width: int, height: int, lens: Lens) -> WrongSize:
    """What is wrong with a picture of another size than its intrinsics are for.

    Parameters
    ----------
    name : the capture's.
    width, height : of the picture, pixels.
    lens : which states another size.
    """
    turned = (height, width) == (lens.width, lens.height)
    remedy = "state the intrinsics for the size captured, or set the camera back"
    if turned:
        remedy = "is the camera turned, or the EXIF orientation wrong?"
    return WrongSize(f"{name} has {width} x {height} pixels, the intrinsics are for {lens.width} x {lens.height}: {remedy}")


def _refuse_size(name: str, data: bytes, lens: Lens | None) -> None:
    """By the header alone, before memory and time are given for what it promises.

    The image may lie on its side: EXIF data turn it.
    """
    if (size := picture_size(data)) is None:
        return
    width, height = size
    stated = bool(lens and lens.width and lens.height)
    if stated and lens and sorted(size) != sorted((lens.width, lens.height)):
        raise wrong_size(name, width, height, lens)
    if data[:2] == b"\xff\xd8" and width * height > max(FEW_PIXELS, len(data) * MOST_JPEG_PIXELS_A_BYTE):
        raise OversizedImage(f"{name} promises {width} x {height} pixels, which {len(data):,} bytes cannot hold")
    most = MOST_PIXELS if stated else MOST_UNSTATED_PIXELS
    if width * height > most:
        how = "" if stated else " as long as its intrinsics do not state its size"
        raise OversizedImage(f"{name} has {width} x {height} pixels, {most // 10**6} million are the most that are decoded{how}")


def refuse_truncated(name: str, data: bytes) -> None:
    """JPEG must have an end marker after its first scan, PNG a last chunk; decoders pad the rest with grey and only mutter."""
    if data[:3] == b"\xff\xd8\xff":
        scan = next((start for marker, start, _ in jpeg_segments(data) if marker == SCAN), None)
        whole = scan is not None and data.find(b"\xff\xd9", scan) >= 0
    elif data[:8] == b"\x89PNG\r\n\x1a\n":
        whole = data.rfind(b"IEND") >= 0
    else:
        return
    if not whole:
        raise TruncatedImage(f"{name} ends after {len(data):,} bytes: the image is truncated")


def refuse_unfinished(name: str, image: Uint8s) -> None:
    """A recorder that lost a part of a picture pads it with one colour and writes a file that is whole.

    Black and white are left alone (a letter box, a night, a sky), and so is a colour that the upper edge has, too: the ground of
    a drawing.
    """
    last = image[-1, -1]
    if last.max() < 24 or last.min() > 231 or (image[0] == last).all():
        return
    whole = next((row for row in range(len(image) - 1, -1, -1) if (image[row] != last).any()), None)
    missing = 0.0 if whole is None else 1.0 - (whole + 1) / len(image)  # one colour everywhere is featureless
    if missing > MOST_MISSING:
        raise TruncatedImage(f"{name} is unfinished: the lower {100 * missing:.0f} % of it are of one colour")


def decoded(name: str, data: Uint8s, flags: int) -> Uint8s:
    """Pixels as OpenCV reads them (BGR).  Raises NotAnImage for what is none."""
    try:
        image = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        image = None
    if image is None:
        raise NotAnImage(f"{name} is no image that can be read ({data.size:,} bytes)")
    return np.asarray(image, dtype=np.uint8)


def refuse_featureless(name: str, image: Uint8s) -> None:
    """Raises FeaturelessImage for what shows nothing.

    Averaging over cells removes sensor noise; what then spans less than six grey levels is that.
    """
    cells = cv2.resize(image, (48, 32), interpolation=cv2.INTER_AREA).astype(np.float32).mean(axis=2)
    low, high = np.percentile(cells, [1, 99])
    if high - low >= 6:
        return
    look = "black" if high < 24 else "white" if low > 231 else "uniform"
    raise FeaturelessImage(f"{name} is {look}: nothing can be seen in it; look at the camera, its lens and its light")

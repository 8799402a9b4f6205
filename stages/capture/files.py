"""Image files as pixels.  Files from the field may be empty, truncated, black or from another camera: each case has its error."""

from __future__ import annotations

import importlib
from typing import Any

import cv2
import numpy as np

from ..io.image_headers import (
    is_heic,
    is_raw_photograph,
    is_truncated,
    jpeg_end,
    jpeg_offset,
    jpeg_segments,
    largest_stated_value,
    other_content,
    picture_size,
)
from ..types import Capture, Lens, Uint8s
from .levels import Levels, Values, grey_levels_of, levels_of

_SHOWN_BYTES = 200
"""How much of a file that is no image is looked at, to say what it is."""
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


def decode(capture: Capture, lens: Lens | None = None, levels: Levels | None = None) -> Uint8s:
    """Decode an image file into (h, w, 3) uint8 RGB, rotated upright by its EXIF data.

    Raises BadCapture for a file that is empty, not an image, truncated, too large, of another size, or without content (black,
    white, uniform).

    Parameters
    ----------
    capture : the file; its content decides on the format, whatever its name says.
    lens : if it states the size of captures, a file whose header gives another size is not decoded.
    levels : what becomes black and white in a picture of more than 8 bits; None: by its own values (see `levels_of`).
    """
    values = picture_values(capture, lens)
    if levels is None:
        levels = levels_of([values], largest_stated_value(_image_bytes(capture)))
    image = grey_levels_of(values, levels)
    refuse_unfinished(capture.name, image)
    refuse_featureless(capture.name, image)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def picture_values(capture: Capture, lens: Lens | None = None) -> Values:
    """The values of an image file as they are stored, (h, w, 3) BGR of any dtype, rotated upright; see `decode`."""
    if capture.data.size == 0:
        raise EmptyCapture(f"{capture.name} is empty (0 bytes)")
    file_bytes = _image_bytes(capture)
    if is_raw_photograph(file_bytes):
        remedy = "have the camera write JPEG, PNG or TIFF, or develop it before the run"
        raise NotAnImage(f"{capture.name} is a raw photograph, of which only the preview could be read: {remedy}")
    refuse_truncated(capture.name, file_bytes)
    _refuse_size(capture.name, file_bytes, lens)
    if is_heic(file_bytes):
        return _heic_values(capture.name, file_bytes, lens)
    return decoded(capture.name, np.frombuffer(file_bytes, np.uint8), cv2.IMREAD_COLOR)


def _image_bytes(capture: Capture) -> bytes:
    """The bytes of a file from where the image begins."""
    file_bytes = np.ascontiguousarray(capture.data).tobytes()
    return file_bytes[jpeg_offset(file_bytes) or 0 :]


def stray_bytes(capture: Capture) -> str:
    """Where a JPEG file holds bytes that belong to no part of it, in words; "" if it does not.  Decoders skip them."""
    file_bytes = np.ascontiguousarray(capture.data).tobytes()
    offset = jpeg_offset(file_bytes)
    if offset is None:
        return ""
    if offset:
        return "before the picture"
    end = 2
    for _, start, next_end in jpeg_segments(file_bytes):
        if file_bytes[end : start - 4].strip(b"\xff"):  # any number of 0xFF may precede a marker
            return "between its segments"
        end = next_end
    if jpeg_end(file_bytes) is None:
        return "between its segments"
    return ""


def _heic_values(name: str, data: bytes, lens: Lens | None) -> Values:
    """Values of a HEIC file, (h, w, 3) uint8 BGR, turned as the file says.  Raises NotAnImage without the library for it."""
    try:
        heif: Any = importlib.import_module("pillow_heif")
    except ImportError:
        remedy = "pip install 'wbflow[heic]', or have the camera write JPEG"
        raise NotAnImage(f"{name} is a HEIC image, which needs a library of its own: {remedy}") from None
    try:
        file = heif.open_heif(data, convert_hdr_to_8bit=True)
        width, height = file.size
        _refuse_dimensions(name, width, height, lens)
        values = np.asarray(file)
    except (ValueError, RuntimeError, SyntaxError, OSError) as error:
        if isinstance(error, BadCapture):
            raise
        raise NotAnImage(f"{name} is a HEIC image that cannot be read ({len(data):,} bytes): {error}") from None
    if values.ndim == 2:
        return np.asarray(cv2.cvtColor(values, cv2.COLOR_GRAY2BGR), np.uint8)
    return np.ascontiguousarray(values[..., 2::-1])


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
    size = picture_size(data)
    if size is None:
        return
    width, height = size
    _refuse_dimensions(name, width, height, lens)
    if data[:2] == b"\xff\xd8" and width * height > max(FEW_PIXELS, len(data) * MOST_JPEG_PIXELS_A_BYTE):
        raise OversizedImage(f"{name} promises {width} x {height} pixels, which {len(data):,} bytes cannot hold")


def _refuse_dimensions(name: str, width: int, height: int, lens: Lens | None) -> None:
    """Raises WrongSize for another size than the lens states, and OversizedImage for more pixels than are decoded."""
    limit = MOST_UNSTATED_PIXELS
    hint = " as long as its intrinsics do not state its size"
    if lens is not None and lens.width and lens.height:
        if sorted((width, height)) != sorted((lens.width, lens.height)):
            raise wrong_size(name, width, height, lens)
        limit = MOST_PIXELS
        hint = ""
    if width * height > limit:
        raise OversizedImage(
            f"{name} has {width} x {height} pixels, {limit // 10**6} million are the most that are decoded{hint}"
        )


def refuse_truncated(name: str, data: bytes) -> None:
    """Raises TruncatedImage for JPEG without end marker or PNG without last chunk: decoders pad them with grey and only warn."""
    if is_truncated(data):
        raise TruncatedImage(f"{name} ends after {len(data):,} bytes: the image is truncated")


def refuse_unfinished(name: str, image: Uint8s) -> None:
    """Raises TruncatedImage if the lower end is of one colour: recorders that lost a part of an image pad it in a complete file.

    Black and white are exempt (letter box, night, sky), and so is a colour that the upper edge has as well: the background of a
    drawing.
    """
    last_pixel = image[-1, -1]
    if last_pixel.max() < 24 or last_pixel.min() > 231:
        return
    if (image[0] == last_pixel).all():
        return
    row = len(image) - 1
    while row >= 0 and (image[row] == last_pixel).all():
        row -= 1
    if row < 0:  # one colour everywhere: see `refuse_featureless`
        return
    missing = 1.0 - (row + 1) / len(image)
    if missing > MOST_MISSING:
        raise TruncatedImage(f"{name} is unfinished: the lower {100 * missing:.0f} % of it are of one colour")


def decoded(name: str, data: Uint8s, flags: int) -> Values:
    """Pixels as OpenCV reads them (BGR), with all their bits.  Raises NotAnImage if it cannot."""
    image = _imdecode(data, flags | cv2.IMREAD_ANYDEPTH)
    if image is None and flags == cv2.IMREAD_COLOR:
        # values with fractions are read without conversion only: grey ones do not become colours
        grey = _imdecode(data, cv2.IMREAD_ANYDEPTH)
        if grey is not None and grey.ndim == 2:
            image = np.repeat(grey[..., None], 3, axis=2)
    if image is None:
        what = other_content(data[:_SHOWN_BYTES].tobytes())
        if not data.any():
            what = "holds zeros only: its disk, or the job that copies it, has failed"
        raise NotAnImage(f"{name} {what or 'is no image that can be read'} ({data.size:,} bytes)")
    return image


def decoded_mask(name: str, data: Uint8s) -> Uint8s:
    """(h, w) uint8, 255 where a mask file is not zero, at whatever depth.  Raises NotAnImage."""
    values = decoded(name, data, cv2.IMREAD_GRAYSCALE)
    return np.where(values > 0, 255, 0).astype(np.uint8)


def _imdecode(data: Uint8s, flags: int) -> Values | None:
    try:
        return cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        return None


def refuse_featureless(name: str, image: Uint8s) -> None:
    """Raises FeaturelessImage for an image that is black, white or uniform.

    Averaging over cells removes sensor noise; cells that then span less than six grey levels show nothing.
    """
    cells = cv2.resize(image, (48, 32), interpolation=cv2.INTER_AREA).astype(np.float32).mean(axis=2)
    low, high = np.percentile(cells, [1, 99])
    if high - low >= 6:
        return
    if high < 24:
        look = "black"
    elif low > 231:
        look = "white"
    else:
        look = "uniform"
    raise FeaturelessImage(f"{name} is {look}: nothing can be seen in it; check the camera, its lens and its lighting")

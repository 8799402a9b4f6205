"""Helpers shared by the calibration readers: numbers, however they are nested, image sizes, and names of lens models."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from .calibrated import Faulty, Matrix
from .entry import Entry

_WIDTH_KEYS = ("image_width", "img_width", "width", "w")
_HEIGHT_KEYS = ("image_height", "img_height", "height", "h")
_SIZE_KEYS = ("image_size", "img_size", "resolution", "size")

MODEL_NAMES = {
    "plumb_bob": "brown",
    "radtan": "brown",
    "brown_conrady": "brown",
    "opencv": "brown",
    "radial": "brown",
    "simple_radial": "brown",
    "simple_pinhole": "pinhole",
    "perspective": "brown",
    "rational_polynomial": "rational",
    "full_opencv": "rational",
    "equidistant": "fisheye",
    "equi": "fisheye",
    "kannala_brandt": "fisheye",
    "kannala_brandt4": "fisheye",
    "opencv_fisheye": "fisheye",
    "thin_prism": "rational",
}
"""wbflow's lens model for each name that other programs use."""


def size_of(entry: Entry) -> dict[str, Any]:
    """Width and height of the images that a calibration is for.  Raises Faulty if it does not contain them."""
    width = entry.value(*_WIDTH_KEYS)
    height = entry.value(*_HEIGHT_KEYS)
    size_key = entry.key(_SIZE_KEYS)
    if size_key == "ImageSize":
        raise entry.fault(size_key, "may be MATLAB's, which gives rows before columns", "write image_width and image_height")
    if size_key is not None:
        # files may have both forms, as long as they agree
        size = list(_flattened(_data_of(entry[size_key])))
        if len(size) != 2 or (width is not None and [width, height] != size):
            raise entry.fault(size_key, "must be the width and the height", "write image_width and image_height, in pixels")
        width, height = size
    if width is None or height is None:
        what = f"{entry.name} lacks the size of the pictures".lstrip()
        raise Faulty(what, entry.location, "add image_width and image_height, in pixels")
    return {"width": _whole(width), "height": _whole(height)}


def _whole(number: Any) -> Any:
    """A whole number that is written as a float (1920.0) as an int; anything else as it is, to be refused later."""
    if isinstance(number, float) and number.is_integer():
        return int(number)
    return number


def rows_of(flat: list[float], width: int) -> Matrix:
    """The rows of a matrix from its numbers in row-major order."""
    return [flat[start : start + width] for start in range(0, len(flat), width)]


def numbers_of(entry: Entry, key: str) -> list[float]:
    """All numbers of a matrix, given as nested lists or as OpenCV's and ROS's rows, cols and data.  Raises Faulty."""
    value = entry[key]
    flat = list(_flattened(_data_of(value)))
    if isinstance(value, dict):
        rows = value.get("rows")
        columns = value.get("cols")
        if isinstance(rows, int) and isinstance(columns, int) and rows * columns != len(flat):
            raise entry.fault(key, f"says {rows} x {columns}, and holds {len(flat)} numbers")
    try:
        return [_number(item) for item in flat]
    except (TypeError, ValueError, OverflowError):
        raise entry.fault(key, "must hold numbers") from None


def _number(value: Any) -> float:
    """A number as it is written, int or float, so that digests do not depend on who parsed it.  Raises ValueError, TypeError."""
    if isinstance(value, bool):  # which is an int to Python
        raise TypeError
    if isinstance(value, str):  # YAML 1.1 reads 1e-05 as text
        return float(value)
    float(value)  # raises for anything else
    return value  # type: ignore[no-any-return]


def _data_of(value: Any) -> Any:
    """The numbers of a matrix, without the frame of rows, cols and data that OpenCV and ROS put around them."""
    if isinstance(value, dict):
        return value.get("data")
    return value


def _flattened(value: Any) -> Iterable[Any]:
    """The items of lists within lists, in order."""
    if isinstance(value, list):
        for item in value:
            yield from _flattened(item)
    else:
        yield value


def text_of(value: Any) -> str:
    """The value if it is a string, else ""."""
    return value if isinstance(value, str) else ""

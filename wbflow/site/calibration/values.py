"""Helpers shared by the calibration readers: numbers, however they are nested, image sizes, and names of lens models."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ..yaml_document import Location
from .calibrated import Faulty, Matrix

_WIDTH_KEYS = ("image_width", "image_Width", "width")
_HEIGHT_KEYS = ("image_height", "image_Height", "height")
_SIZE_KEYS = ("image_size", "imageSize", "resolution")

MODEL_NAMES = {
    "plumb_bob": "brown",
    "radtan": "brown",
    "brown_conrady": "brown",
    "opencv": "brown",
    "rational_polynomial": "rational",
    "equidistant": "fisheye",
    "equi": "fisheye",
    "kannala_brandt": "fisheye",
    "opencv_fisheye": "fisheye",
    "thin_prism": "rational",
}
"""wbflow's lens model for each name that other programs use."""


def size_of(data: dict[str, Any], location: Location = ()) -> dict[str, Any]:
    """Width and height of the images that a calibration is for.  Raises Faulty if it does not contain them."""
    keys = first_key(data, _WIDTH_KEYS), first_key(data, _HEIGHT_KEYS)
    if keys[0] and keys[1]:
        return {"width": data[keys[0]], "height": data[keys[1]]}
    size = data[key] if (key := first_key(data, _SIZE_KEYS)) else []
    if not isinstance(size, list) or len(size) != 2:
        what = " ".join([*map(str, location), "lacks the size of the pictures"])
        raise Faulty(what, location, "add image_width and image_height, in pixels")
    return {"width": size[0], "height": size[1]}


def rows_of(flat: list[float], width: int) -> Matrix:
    """The rows of a matrix from its numbers in row-major order."""
    return [flat[i : i + width] for i in range(0, len(flat), width)]


def numbers_of(value: Any, key: str, location: Location = ()) -> list[float]:
    """All numbers of a matrix, given as nested lists or as OpenCV's and ROS's rows, cols and data.  Raises Faulty."""
    matrix = value if isinstance(value, dict) else {"data": value}
    rows, columns, flat = matrix.get("rows"), matrix.get("cols"), list(_flattened(matrix.get("data")))
    if isinstance(rows, int) and isinstance(columns, int) and rows * columns != len(flat):
        raise Faulty(f"{key} says {rows} x {columns}, and holds {len(flat)} numbers", (*location, key))
    try:
        return [float(str(number)) for number in flat]  # strings too (YAML 1.1 reads 1e-05 as one), but not booleans
    except (TypeError, ValueError, OverflowError):
        raise Faulty(f"{key} must hold numbers", (*location, key)) from None


def _flattened(value: Any) -> Iterable[Any]:
    if isinstance(value, list):
        for item in value:
            yield from _flattened(item)
    else:
        yield value


def first_key(data: dict[str, Any], names: tuple[str, ...]) -> str | None:
    """The first of these names that has a value."""
    return next((name for name in names if data.get(name) is not None), None)


def text_of(value: Any) -> str:
    """The value if it is a string, else ""."""
    return value if isinstance(value, str) else ""

"""COLMAP's models, as text (cameras.txt and images.txt) or binary (.bin), with all of COLMAP's camera models.

References
----------
https://colmap.github.io/format.html, https://colmap.github.io/cameras.html
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...cache.untrusted import Unreadable, is_file, read_untrusted
from ..yaml_document import CalibrationError, SiteError, read_text
from .calibrated import Calibrated, Matrix, calibrated, centre

_LAYOUTS: dict[str, tuple[str, int, int]] = {
    "SIMPLE_PINHOLE": ("pinhole", 1, 0),
    "PINHOLE": ("pinhole", 2, 0),
    "SIMPLE_RADIAL": ("brown", 1, 1),
    "RADIAL": ("brown", 1, 2),
    "OPENCV": ("brown", 2, 4),
    "OPENCV_FISHEYE": ("fisheye", 2, 4),
    "FULL_OPENCV": ("rational", 2, 8),
    "FOV": ("fov", 2, 1),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", 1, 1),
    "RADIAL_FISHEYE": ("fisheye", 1, 2),
    "THIN_PRISM_FISHEYE": ("thin-prism-fisheye", 2, 8),
    "RAD_TAN_THIN_PRISM_FISHEYE": ("rad-tan-thin-prism-fisheye", 2, 12),
    "SIMPLE_DIVISION": ("division", 1, 1),
    "DIVISION": ("division", 2, 1),
    "SIMPLE_FISHEYE": ("fisheye", 1, 0),
    "FISHEYE": ("fisheye", 2, 0),
    "EUCM": ("eucm", 2, 2),
    "EQUIRECTANGULAR": ("equirectangular", 0, 0),
}
"""By COLMAP's camera model: our lens model, the number of focal lengths, and of coefficients after the principal point.

A model's position in this table is its COLMAP id, which binary models contain.
"""


def is_colmap(folder: Path) -> bool:
    """Does a folder contain a COLMAP model, or a part of one?"""
    return any(is_file(folder / f"{name}.{suffix}") for name in ("cameras", "images") for suffix in ("txt", "bin"))


def read_colmap(folder: Path) -> dict[str, Calibrated]:
    """Cameras by image name; a text model takes precedence over a binary one.  Raises CalibrationError."""
    text, binary = ([folder / f"{name}.{suffix}" for name in ("cameras", "images")] for suffix in ("txt", "bin"))
    if all(map(is_file, text)):
        file, cameras, images = text[0].name, _text_cameras(text[0]), _text_images(text[1])
    elif all(map(is_file, binary)):
        file, cameras, images = binary[0].name, _binary_cameras(binary[0]), _binary_images(binary[1])
    else:
        what = "must hold cameras.txt and images.txt, or cameras.bin and images.bin (COLMAP's text or binary model)"
        raise CalibrationError(what, where=str(folder), remedy=_REMEDY)
    lenses: dict[str, dict[str, Any]] = {}
    for where, what, number, model, size, parameters in cameras:
        try:
            lenses[number] = _lens(model, *size, parameters)
            calibrated(lenses[number])
        except (IndexError, ValueError) as error:
            reason = "it lacks numbers" if isinstance(error, IndexError) else error
            raise CalibrationError(f"{what}{reason}", where=where, remedy=_REMEDY) from None
    by_image: dict[str, Calibrated] = {}
    for where, what, name, number, pose in images:
        if number not in lenses:
            raise CalibrationError(f"{what} is of camera {number}, which {file} lacks", where=where, remedy=_REMEDY)
        try:
            R = _quaternion_to_rotation(*pose[:4])
            by_image[name] = calibrated({**lenses[number], "R": R, "C": centre(R, pose[4:])})
        except (TypeError, IndexError, ValueError) as error:
            raise CalibrationError(f"{what}: {error}", where=where, remedy=_REMEDY) from None
    return by_image


_REMEDY = "have COLMAP write the model again: model_converter --output_type TXT"
_Camera = tuple[str, str, str, str, tuple[int, int], list[float]]
"""A camera: its place in the file, a prefix for messages, its id, model, size and parameters."""
_Image = tuple[str, str, str, str, list[float]]
"""An image: its place in the file, a prefix for messages, its name, the id of its camera, and its pose (qw qx qy qz and t)."""


def _text_cameras(path: Path) -> Iterator[_Camera]:
    for where, line in _lines(path):
        if line.strip():
            try:
                number, model, width, height, *parameters = line.split()
                yield where, "", number, model, (int(width), int(height)), [*map(float, parameters)]
            except ValueError:
                raise CalibrationError("not a camera line of COLMAP's text model", where=where, remedy=_REMEDY) from None


def _text_images(path: Path) -> Iterator[_Image]:
    # each image takes two lines; the second, with its 2-D points (possibly empty), is not needed
    what = "not an image line of COLMAP's text model"
    for where, line in list(_lines(path))[::2]:
        if line.strip():
            try:
                _, *pose, number, name = line.split(maxsplit=9)
                yield where, what, name.strip(), number, [*map(float, pose)]
            except ValueError:
                raise CalibrationError(what, where=where, remedy=_REMEDY) from None


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """The lines of a file that are not comments, each with its place (file and line number)."""
    try:
        lines = read_text(path).splitlines()
    except SiteError as error:
        raise CalibrationError.from_site_error(error) from None
    return ((f"{path}:{number}", line) for number, line in enumerate(lines, 1) if not line.startswith("#"))


def _binary_cameras(path: Path) -> Iterator[_Camera]:
    file = _Binary(path)
    for _ in range(file.values("<Q")[0]):
        number, model, width, height = file.values("<IiQQ")
        name = list(_LAYOUTS)[model] if 0 <= model < len(_LAYOUTS) else f"number {model}"
        _, focals, count = _LAYOUTS.get(name, ("", 0, -2))
        yield str(path), f"camera {number}: ", str(number), name, (width, height), list(file.values(f"<{focals + 2 + count}d"))


def _binary_images(path: Path) -> Iterator[_Image]:
    file = _Binary(path)
    for _ in range(file.values("<Q")[0]):
        number, *pose, camera = file.values("<I7dI")
        name = file.text()
        file.skip(_POINT_BYTES * file.values("<Q")[0])
        yield str(path), f"image {number}", name, str(camera), pose


_POINT_BYTES = 24
"""Size of a 2-D point of an image: x, y, and the id of its 3-D point."""


class _Binary:
    """Reads a file of COLMAP's binary model: little-endian numbers, each list preceded by its length."""

    def __init__(self, path: Path) -> None:
        self.path, self.at = path, 0
        try:
            self.data = read_untrusted(path)
        except Unreadable as error:
            raise CalibrationError(error.what, where=str(path)) from None

    def values(self, layout: str) -> tuple[Any, ...]:
        """The next values, in a `struct` layout."""
        start = self.at
        self.skip(struct.calcsize(layout))
        return struct.unpack_from(layout, self.data, start)

    def text(self) -> str:
        """The text up to the next zero byte."""
        start, end = self.at, self.data.find(b"\0", self.at)
        self.skip(end + 1 - start if end >= 0 else len(self.data))
        return self.data[start:end].decode(errors="surrogateescape")

    def skip(self, count: int) -> None:
        """Skip bytes.  Raises CalibrationError if the file ends before."""
        self.at += count
        if self.at > len(self.data):
            raise CalibrationError("ends too early (COLMAP's binary model)", where=str(self.path), remedy=_REMEDY)


def _lens(name: str, width: int, height: int, parameters: list[float]) -> dict[str, Any]:
    """The lens of a camera.  COLMAP's origin is the *corner* of the top-left pixel, so 0.5 is subtracted from cx and cy."""
    if name not in _LAYOUTS:
        raise ValueError(f"camera model {name} is not supported; use one of {', '.join(_LAYOUTS)}")
    model, focals, count = _LAYOUTS[name]
    if model == "equirectangular":
        parameters = [width / (2 * math.pi), height / math.pi, width / 2, height / 2]
        focals = 2
    fx, fy, cx, cy = parameters[0], parameters[focals - 1], parameters[focals], parameters[focals + 1]
    if min(fx, fy) <= 0:
        raise ValueError("a focal length must be positive")
    K = [[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, 1.0]]
    coefficients = [parameters[focals + 2 + i] for i in range(count)]
    if model == "fisheye":  # coefficients that COLMAP's model lacks are 0
        coefficients += [0.0] * (4 - count)
    model = "brown" if model == "pinhole" else model
    return {"K": K, "width": width, "height": height, "distortion": coefficients, "model": model}


def _quaternion_to_rotation(w: float, x: float, y: float, z: float) -> Matrix:
    n = math.sqrt(w * w + x * x + y * y + z * z)
    if not 1e-6 < n < 1e6:
        raise ValueError("its quaternion is zero or infinite, which is not a rotation")
    w, x, y, z = w / n, x / n, y / n, z / n
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]

"""COLMAP's models, as text (cameras.txt and images.txt) or binary (.bin), with every camera model that COLMAP has.

References
----------
https://colmap.github.io/format.html, https://colmap.github.io/cameras.html
"""

from __future__ import annotations

import math
import os
import struct
from pathlib import Path
from typing import Any, BinaryIO

from ...cache.untrusted import Unreadable, is_file, open_outside
from ..locations import CalibrationError, SiteError, read_text
from ..models import LARGEST, MOST_PIXELS_A_SIDE, Calibrated, Lens, Matrix, Placement

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
"""By COLMAP's name: our model, how many focal lengths come first, and how many coefficients after the principal point.

The order is that of COLMAP's numbers: binary models have these.
"""

_PADDED = {"brown": 5, "fisheye": 4}
"""Coefficients that COLMAP does not write are 0: so many there are of a model in all."""


def is_colmap(folder: Path) -> bool:
    """Does a folder hold a model, or a part of one?"""
    return any(is_file(folder / f"{name}.{suffix}") for name in ("cameras", "images") for suffix in ("txt", "bin"))


def read_colmap(folder: Path) -> dict[str, Calibrated]:
    """Cameras by image name; of a folder with both models the text.  Raises CalibrationError."""
    files = folder / "cameras.txt", folder / "images.txt"
    if not all(map(is_file, files)):
        binary = folder / "cameras.bin", folder / "images.bin"
        if all(map(is_file, binary)):
            return _read_binary(*binary)
        what = "must hold cameras.txt and images.txt, or cameras.bin and images.bin (COLMAP's text or binary model)"
        raise CalibrationError(what, where=str(folder), remedy="in COLMAP: model_converter --output_type TXT")
    cameras: dict[str, Lens] = {}
    for number, line in enumerate(_lines(files[0]), 1):
        if words := _words(line):
            try:
                size = _pixels(words[2]), _pixels(words[3])
                cameras[words[0]] = _intrinsics(words[1], *size, [_finite(w) for w in words[4:]])
            except (IndexError, ValueError) as error:
                why = "not a camera line of COLMAP's text model" if isinstance(error, IndexError) else str(error)
                raise CalibrationError(why, where=f"{files[0]}:{number}", remedy=_REMEDY) from None
    found: dict[str, Calibrated] = {}
    # each image takes two lines, the second being its 2-D points (possibly empty): only the first is of interest
    lines = [(n, line) for n, line in enumerate(_lines(files[1]), 1) if not line.startswith("#")]
    for number, line in lines[::2]:
        words = line.split(maxsplit=9)
        if not words:
            continue
        try:
            found[words[9].strip()] = _posed(cameras[words[8]], [_finite(w) for w in words[1:8]])
        except (IndexError, ValueError, KeyError) as error:
            why = f": {error}" if isinstance(error, ValueError) else ""
            what = f"not an image line of COLMAP's text model{why}"
            raise CalibrationError(what, where=f"{files[1]}:{number}", remedy=_REMEDY) from None
    return found


def _read_binary(cameras_file: Path, images_file: Path) -> dict[str, Calibrated]:
    cameras: dict[int, Lens] = {}
    with _Binary(cameras_file) as file:
        for _ in range(file.count()):
            number, model, width, height = file.values("<IiQQ")
            name = list(_LAYOUTS)[model] if 0 <= model < len(_LAYOUTS) else f"number {model}"
            params = file.values(f"<{_parameters(name)}d") if name in _LAYOUTS else ()
            try:
                cameras[number] = _intrinsics(name, _pixels(str(width)), _pixels(str(height)), [_finite(p) for p in params])
            except ValueError as error:
                raise file.fault(f"camera {number}: {error}") from None
    found: dict[str, Calibrated] = {}
    with _Binary(images_file) as file:
        for _ in range(file.count()):
            number, *pose, camera = file.values("<I7dI")
            name = file.name()
            file.skip(_POINT_BYTES * file.count())
            try:
                found[name] = _posed(cameras[camera], [_finite(p) for p in pose])
            except KeyError:
                raise file.fault(f"image {number} is of camera {camera}, which {cameras_file.name} lacks") from None
            except ValueError as error:
                raise file.fault(f"image {number}: {error}") from None
    return found


class _Binary:
    """A file of COLMAP's binary model: little-endian numbers one after the other, each list after its length."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.file: BinaryIO = os.fdopen(open_outside(path, _MOST_BYTES), "rb")
        except Unreadable as error:
            raise CalibrationError(error.what, where=str(path)) from None

    def __enter__(self) -> _Binary:
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def values(self, layout: str) -> tuple[Any, ...]:
        """What comes next."""
        data = self.file.read(struct.calcsize(layout))
        if len(data) < struct.calcsize(layout):
            raise self.fault("ends too early")
        return struct.unpack(layout, data)

    def count(self) -> int:
        """How long the list is that comes next."""
        return int(self.values("<Q")[0])

    def name(self) -> str:
        """Text up to a zero byte."""
        found = bytearray()
        while (byte := self.values("<c")[0]) != b"\0":
            found += byte
            if len(found) > _LONGEST_NAME:
                raise self.fault("an image's name has no end")
        return found.decode(errors="surrogateescape")

    def skip(self, count: int) -> None:
        """Leave bytes out."""
        if count > os.fstat(self.file.fileno()).st_size - self.file.tell():
            raise self.fault("ends too early")
        self.file.seek(count, os.SEEK_CUR)

    def fault(self, what: str) -> CalibrationError:
        """What is wrong where."""
        return CalibrationError(f"{what} (COLMAP's binary model)", where=str(self.path), remedy=_REMEDY_BINARY)


_MOST_BYTES = 100_000_000_000
"""Of a file with every point of every image, most of which is passed over."""
_POINT_BYTES = 24
"""Of a point of an image: x, y, and the number of its point in space."""
_LONGEST_NAME = 10_000
_REMEDY_BINARY = "have COLMAP write the model again: model_converter --output_type BIN"
_REMEDY = "have COLMAP write the model again: model_converter --output_type TXT"


def _finite(word: str | float) -> float:
    value = float(word)
    if not abs(value) < LARGEST:
        raise ValueError(f"{str(word)[:40]} is no finite number")
    return value


def _pixels(word: str) -> int:
    value = int(word) if len(word) < 20 else 0
    if not 0 < value <= MOST_PIXELS_A_SIDE:
        raise ValueError(f"{word[:40]} is no number of pixels")
    return value


def _lines(path: Path) -> list[str]:
    try:
        return read_text(path).splitlines()
    except SiteError as error:
        raise CalibrationError.from_site_error(error) from None


def _words(line: str) -> list[str]:
    return [] if line.startswith("#") else line.split()


def _parameters(name: str) -> int:
    """How many numbers a camera model has."""
    model, focals, count = _LAYOUTS[name]
    return 2 if model == "equirectangular" else focals + 2 + count


def _posed(lens: Lens, pose: list[float]) -> Calibrated:
    """A camera with its pose: qw qx qy qz, and t of x = R X + t."""
    R = _quaternion_to_rotation(*pose[:4])
    C = [-sum(R[j][i] * pose[4 + j] for j in range(3)) for i in range(3)]
    return Calibrated(lens, Placement(R, C))


def _intrinsics(name: str, width: int, height: int, p: list[float]) -> Lens:
    """COLMAP puts the origin at the top-left *corner* of the first pixel: half a pixel is taken off the principal point."""
    if name not in _LAYOUTS:
        raise ValueError(f"camera model {name} is not supported; use one of {', '.join(_LAYOUTS)}")
    model, focals, count = _LAYOUTS[name]
    if model == "equirectangular":
        p = [width / (2 * math.pi), height / math.pi, width / 2, height / 2]
        focals = 2
    fx, fy, cx, cy = p[0], p[focals - 1], p[focals], p[focals + 1]
    if min(fx, fy) <= 0:
        raise ValueError("a focal length must be positive")
    coefficients = [p[focals + 2 + i] for i in range(count)]
    K = [[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, 1.0]]
    padded = coefficients + [0.0] * (_PADDED.get(model, 0 if count else 5) - count)
    return Lens(K=K, distortion=padded, width=width, height=height, model="brown" if model == "pinhole" else model)


def _quaternion_to_rotation(w: float, x: float, y: float, z: float) -> Matrix:
    n = math.sqrt(w * w + x * x + y * y + z * z)
    if n < 1e-6:
        raise ValueError("its quaternion is zero, which is no rotation")
    w, x, y, z = w / n, x / n, y / n, z / n
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]

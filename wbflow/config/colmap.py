"""COLMAP's text model: cameras.txt and images.txt, with every camera model that COLMAP has.

References
----------
https://colmap.github.io/format.html, https://colmap.github.io/cameras.html
"""

from __future__ import annotations

import math
from pathlib import Path

from ..store.outside import is_file
from .calibrated import LARGEST, MOST_PIXELS_A_SIDE, Calibrated, CalibrationError, Matrix, text_of

_Intrinsics = tuple[Matrix, int, int, list[float] | None, str]

_LAYOUTS: dict[str, tuple[str, int, int]] = {
    "SIMPLE_PINHOLE": ("pinhole", 1, 0),
    "PINHOLE": ("pinhole", 2, 0),
    "SIMPLE_RADIAL": ("brown", 1, 1),
    "RADIAL": ("brown", 1, 2),
    "OPENCV": ("brown", 2, 4),
    "FULL_OPENCV": ("rational", 2, 8),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", 1, 1),
    "RADIAL_FISHEYE": ("fisheye", 1, 2),
    "OPENCV_FISHEYE": ("fisheye", 2, 4),
    "SIMPLE_FISHEYE": ("fisheye", 1, 0),
    "FISHEYE": ("fisheye", 2, 0),
    "FOV": ("fov", 2, 1),
    "THIN_PRISM_FISHEYE": ("thin-prism-fisheye", 2, 8),
    "RAD_TAN_THIN_PRISM_FISHEYE": ("rad-tan-thin-prism-fisheye", 2, 12),
    "SIMPLE_DIVISION": ("division", 1, 1),
    "DIVISION": ("division", 2, 1),
    "EUCM": ("eucm", 2, 2),
    "EQUIRECTANGULAR": ("equirectangular", 0, 0),
}
"""By COLMAP's name: our model, how many focal lengths come first, and how many coefficients after the principal point."""

_PADDED = {"brown": 5, "fisheye": 4}
"""Coefficients that COLMAP does not write are 0: so many there are of a model in all."""


def read_colmap(folder: Path) -> dict[str, Calibrated]:
    """Cameras by image name.  Raises CalibrationError."""
    files = folder / "cameras.txt", folder / "images.txt"
    if not all(map(is_file, files)):
        what = "must hold cameras.txt and images.txt (COLMAP's text model)"
        raise CalibrationError(what, where=str(folder), remedy="in COLMAP: model_converter --output_type TXT")
    cameras: dict[str, _Intrinsics] = {}
    for number, line in enumerate(text_of(files[0]).splitlines(), 1):
        if words := _words(line):
            try:
                size = _pixels(words[2]), _pixels(words[3])
                cameras[words[0]] = _intrinsics(words[1], *size, [_finite(w) for w in words[4:]])
            except (IndexError, ValueError) as error:
                why = "not a camera line of COLMAP's text model" if isinstance(error, IndexError) else str(error)
                raise CalibrationError(why, where=f"{files[0]}:{number}", remedy=_REMEDY) from None
    found: dict[str, Calibrated] = {}
    # each image takes two lines, the second being its 2-D points (possibly empty): only the first is of interest
    lines = [(n, line) for n, line in enumerate(text_of(files[1]).splitlines(), 1) if not line.startswith("#")]
    for number, line in lines[::2]:
        words = line.split(maxsplit=9)
        if not words:
            continue
        try:
            qw, qx, qy, qz, *t = (_finite(w) for w in words[1:8])
            K, width, height, distortion, model = cameras[words[8]]
            R = _quaternion_to_rotation(qw, qx, qy, qz)
            C = [-sum(R[j][i] * t[j] for j in range(3)) for i in range(3)]
            found[words[9].strip()] = Calibrated(K, width, height, distortion, R, C, model=model)
        except (IndexError, ValueError, KeyError) as error:
            why = f": {error}" if isinstance(error, ValueError) else ""
            what = f"not an image line of COLMAP's text model{why}"
            raise CalibrationError(what, where=f"{files[1]}:{number}", remedy=_REMEDY) from None
    return found


_REMEDY = "have COLMAP write the model again: model_converter --output_type TXT"


def _finite(word: str) -> float:
    value = float(word)
    if not abs(value) < LARGEST:
        raise ValueError(f"{word[:40]} is no number to reckon with")
    return value


def _pixels(word: str) -> int:
    value = int(word) if len(word) < 20 else 0
    if not 0 < value <= MOST_PIXELS_A_SIDE:
        raise ValueError(f"{word[:40]} is no number of pixels")
    return value


def _words(line: str) -> list[str]:
    return [] if line.startswith("#") else line.split()


def _intrinsics(name: str, width: int, height: int, p: list[float]) -> _Intrinsics:
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
    if model == "pinhole":
        return K, width, height, None, "brown"
    padded = coefficients + [0.0] * (_PADDED.get(model, 0) - count)
    return K, width, height, padded or None, model


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

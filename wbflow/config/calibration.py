"""Calibrations read from files: the JSON of camera matrices, and COLMAP's text model.  Plain lists out; no numpy needed.

Both give, for each image name, intrinsics for a stated image size and, where known, the pose (x ~ K R (X - C)).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ExitCode, WbflowError
from ..store.outside import MOST_TEXT_BYTES, Unreadable, is_file, is_folder, read_outside
from .positions import SiteError, parse_yaml

Matrix = list[list[float]]

LARGEST = 1e12
"""Of any number in a calibration: metres, pixels."""
MOST_PIXELS_A_SIDE = 1_000_000
"""Of an image."""


class CalibrationError(WbflowError, ValueError):
    """A calibration file cannot be used; the message says what and where."""

    exit_code = ExitCode.USAGE


@dataclass(frozen=True)
class Calibrated:
    """What a file says of a camera; None where it does not say."""

    K: Matrix
    """(3, 3)."""
    width: int
    height: int
    distortion: list[float] | None = None
    """k1 k2 p1 p2 k3."""
    R: Matrix | None = None
    """(3, 3), from world to camera axes."""
    C: list[float] | None = None
    """(3,), the centre in the world."""
    metric: bool = True
    """C is in metres."""
    sigma_m: float = 0.0
    """Standard deviation of C, 0 where it is exact."""
    sigma_deg: float = 0.0
    """Standard deviation of R, 0 where it is exact."""


def read_calibration(path: Path) -> dict[str, Calibrated]:
    """Cameras by image name from a JSON file, or from a folder with COLMAP's cameras.txt and images.txt.

    Raises
    ------
    CalibrationError
        Missing, unreadable, or an entry without what it needs.
    """
    if is_folder(path):
        return _read_colmap(path)
    text = _text(path)
    try:
        entries = json.loads(text)
    except json.JSONDecodeError as error:
        raise CalibrationError(f"not JSON: {error.msg}", where=f"{path}:{error.lineno}:{error.colno}", remedy=_REMEDY) from None
    except (ValueError, RecursionError):  # numbers of thousands of digits, brackets within brackets
        raise CalibrationError("not JSON that can be read", where=str(path), remedy=_REMEDY) from None
    if not isinstance(entries, dict):
        what = "must map image names to K, width, height and, where known, R and C"
        raise CalibrationError(what, where=f"{path}:1:1", remedy=_REMEDY)
    found = {}
    for name, entry in entries.items():
        try:
            found[str(name)] = _entry(str(name), entry)
        except _Faulty as fault:
            raise CalibrationError(fault.what, where=_place(path, text, fault.place), remedy=_REMEDY) from None
    return found


_REMEDY = "give K (3x3), width, height and, where known, R (3x3) and C (3 numbers): x ~ K R (X - C); see sites/README.md"


class _Faulty(Exception):
    """An entry that cannot be used."""

    def __init__(self, what: str, *place: str) -> None:
        super().__init__(what)
        self.what = what
        self.place = place


def _text(path: Path) -> str:
    try:
        data = read_outside(path, MOST_TEXT_BYTES)
        return data.decode("utf-8-sig")
    except Unreadable as error:
        raise CalibrationError(error.what, where=str(path)) from None
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        raise CalibrationError("is not UTF-8 text", where=f"{path}:{line}:{column}", remedy="save the file as UTF-8") from None


def _place(path: Path, text: str, place: tuple[str, ...]) -> str:
    """The file, with line and column of a value where they can be told (JSON is YAML, nearly)."""
    try:
        problem = parse_yaml(text, path).problem(place, "")
    except SiteError:
        return str(path)
    return f"{path}:{problem.line}:{problem.column}"


def find_camera(cameras: dict[str, Calibrated], camera: str) -> Calibrated | None:
    """The entry of a camera id: the same name, the same name without extension, or a folder of that name."""
    if camera in cameras:
        return cameras[camera]
    for name, entry in cameras.items():
        path = Path(name)
        if path.stem == camera or path.name == camera or camera in path.parent.parts:
            return entry
    return None


def _entry(name: str, entry: Any) -> Calibrated:
    def numbers(key: str, *shape: int) -> Any:
        value = entry.get(key)
        rows = value if len(shape) == 2 else [value]
        fits = isinstance(rows, list) and len(rows) == (shape[0] if len(shape) == 2 else 1)
        fits = fits and all(isinstance(r, list) and len(r) == shape[-1] and all(_is_number(v) for v in r) for r in rows)
        if not fits:
            raise _Faulty(f"{name}.{key} must be {'x'.join(map(str, shape))} numbers", name, key)
        return value

    if not isinstance(entry, dict):
        raise _Faulty(f"{name} must hold K, width and height", name)
    missing = [key for key in ("K", "width", "height") if key not in entry]
    if missing:
        raise _Faulty(f"{name} lacks {' and '.join(missing)}", name)
    size = [entry["width"], entry["height"]]
    if not all(isinstance(v, int) and not isinstance(v, bool) and 0 < v <= MOST_PIXELS_A_SIDE for v in size):
        raise _Faulty(f"{name}.width and height must be positive whole numbers of pixels", name, "width")
    R = numbers("R", 3, 3) if entry.get("R") is not None else None
    C = numbers("C", 3) if entry.get("C") is not None else None
    if R is not None and not _is_rotation(R):
        raise _Faulty(f"{name}.R is not a rotation (orthonormal rows, determinant +1)", name, "R")
    K = numbers("K", 3, 3)
    if K[0][0] <= 0 or K[1][1] <= 0 or K[2] != [0, 0, 1]:
        raise _Faulty(f"{name}.K must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths", name, "K")
    distortion = numbers("distortion", 5) if entry.get("distortion") is not None else None
    sigmas = []
    for key, of, known in (("position_sigma_m", "C", C), ("rotation_sigma_deg", "R", R)):
        sigma = entry.get(key)
        if sigma is not None and not (_is_number(sigma) and sigma >= 0):
            raise _Faulty(f"{name}.{key} must be a number, 0 or more", name, key)
        if sigma is not None and known is None:
            raise _Faulty(f"{name}.{key} says how well {of} is known, which is not given", name, key)
        sigmas.append(float(sigma or 0))
    return Calibrated(K, size[0], size[1], distortion, R, C, entry.get("metric") is not False, *sigmas)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST  # not NaN either


def _is_rotation(R: Matrix, tolerance: float = 1e-3) -> bool:
    dots = [sum(a * b for a, b in zip(R[i], R[j], strict=True)) - (i == j) for i in range(3) for j in range(3)]
    cross = [R[0][1] * R[1][2] - R[0][2] * R[1][1], R[0][2] * R[1][0] - R[0][0] * R[1][2], R[0][0] * R[1][1] - R[0][1] * R[1][0]]
    return max(map(abs, dots)) < tolerance and sum(a * b for a, b in zip(cross, R[2], strict=True)) > 0


def _read_colmap(folder: Path) -> dict[str, Calibrated]:
    files = folder / "cameras.txt", folder / "images.txt"
    if not all(map(is_file, files)):
        what = "must hold cameras.txt and images.txt (COLMAP's text model)"
        raise CalibrationError(what, where=str(folder), remedy="in COLMAP: model_converter --output_type TXT")
    cameras: dict[str, tuple[Matrix, int, int, list[float] | None]] = {}
    for number, line in enumerate(_text(files[0]).splitlines(), 1):
        if words := _words(line):
            try:
                size = _pixels(words[2]), _pixels(words[3])
                cameras[words[0]] = _colmap_intrinsics(words[1], *size, [_finite(w) for w in words[4:]])
            except (IndexError, ValueError) as error:
                why = "not a camera line of COLMAP's text model" if isinstance(error, IndexError) else str(error)
                raise CalibrationError(why, where=f"{files[0]}:{number}", remedy=_COLMAP_REMEDY) from None
    found: dict[str, Calibrated] = {}
    # each image takes two lines, the second being its 2-D points (possibly empty): only the first is of interest
    lines = [(n, line) for n, line in enumerate(_text(files[1]).splitlines(), 1) if not line.startswith("#")]
    for number, line in lines[::2]:
        words = line.split(maxsplit=9)
        if not words:
            continue
        try:
            qw, qx, qy, qz, *t = (_finite(w) for w in words[1:8])
            K, width, height, distortion = cameras[words[8]]
            R = _quaternion_to_rotation(qw, qx, qy, qz)
            C = [-sum(R[j][i] * t[j] for j in range(3)) for i in range(3)]
            found[words[9].strip()] = Calibrated(K, width, height, distortion, R, C)
        except (IndexError, ValueError, KeyError) as error:
            why = f": {error}" if isinstance(error, ValueError) else ""
            what = f"not an image line of COLMAP's text model{why}"
            raise CalibrationError(what, where=f"{files[1]}:{number}", remedy=_COLMAP_REMEDY) from None
    return found


_COLMAP_REMEDY = "have COLMAP write the model again: model_converter --output_type TXT"


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


def _colmap_intrinsics(model: str, width: int, height: int, p: list[float]) -> tuple[Matrix, int, int, list[float] | None]:
    """COLMAP puts the origin at the top-left *corner* of the first pixel: half a pixel is taken off the principal point."""
    layouts = {
        "SIMPLE_PINHOLE": (0, 0, 1, 2, []),
        "PINHOLE": (0, 1, 2, 3, []),
        "SIMPLE_RADIAL": (0, 0, 1, 2, [3]),
        "RADIAL": (0, 0, 1, 2, [3, 4]),
        "OPENCV": (0, 1, 2, 3, [4, 5, 6, 7]),
    }
    if model not in layouts:
        raise ValueError(f"camera model {model} is not supported; use one of {', '.join(layouts)}")
    fx, fy, cx, cy, coefficients = layouts[model]
    if min(p[fx], p[fy]) <= 0:
        raise ValueError("a focal length must be positive")
    K = [[p[fx], 0.0, p[cx] - 0.5], [0.0, p[fy], p[cy] - 0.5], [0.0, 0.0, 1.0]]
    distortion = ([p[i] for i in coefficients] + [0.0] * 5)[:5] if coefficients else None
    return K, width, height, distortion


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

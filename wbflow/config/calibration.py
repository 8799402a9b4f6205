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

Matrix = list[list[float]]


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
    if path.is_dir():
        return _read_colmap(path)
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise CalibrationError(f"{path} is not JSON: {error}") from None
    if not isinstance(entries, dict):
        raise CalibrationError(f"{path} must map image names to K, width, height and, where known, R and C")
    return {str(name): _entry(path, str(name), entry) for name, entry in entries.items()}


def find_camera(cameras: dict[str, Calibrated], camera: str) -> Calibrated | None:
    """The entry of a camera id: the same name, the same name without extension, or a folder of that name."""
    if camera in cameras:
        return cameras[camera]
    for name, entry in cameras.items():
        path = Path(name)
        if path.stem == camera or path.name == camera or camera in path.parent.parts:
            return entry
    return None


def _entry(path: Path, name: str, entry: Any) -> Calibrated:
    def numbers(key: str, *shape: int) -> Any:
        value = entry.get(key)
        rows = value if len(shape) == 2 else [value]
        fits = isinstance(rows, list) and len(rows) == (shape[0] if len(shape) == 2 else 1)
        fits = fits and all(isinstance(r, list) and len(r) == shape[-1] and all(_is_number(v) for v in r) for r in rows)
        if not fits:
            raise CalibrationError(f"{path}: {name}.{key} must be {'x'.join(map(str, shape))} numbers")
        return value

    if not isinstance(entry, dict):
        raise CalibrationError(f"{path}: {name} must hold K, width and height")
    missing = [key for key in ("K", "width", "height") if key not in entry]
    if missing:
        raise CalibrationError(f"{path}: {name} lacks {' and '.join(missing)}")
    size = [entry["width"], entry["height"]]
    if not all(isinstance(v, int) and v > 0 for v in size):
        raise CalibrationError(f"{path}: {name}.width and height must be positive whole numbers of pixels")
    R = numbers("R", 3, 3) if entry.get("R") is not None else None
    C = numbers("C", 3) if entry.get("C") is not None else None
    if R is not None and not _is_rotation(R):
        raise CalibrationError(f"{path}: {name}.R is not a rotation (orthonormal rows, determinant +1)")
    K = numbers("K", 3, 3)
    if K[0][0] <= 0 or K[1][1] <= 0 or K[2] != [0, 0, 1]:
        raise CalibrationError(f"{path}: {name}.K must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths")
    distortion = numbers("distortion", 5) if entry.get("distortion") is not None else None
    sigmas = []
    for key, of, known in (("position_sigma_m", "C", C), ("rotation_sigma_deg", "R", R)):
        sigma = entry.get(key)
        if sigma is not None and not (_is_number(sigma) and sigma >= 0):
            raise CalibrationError(f"{path}: {name}.{key} must be a number, 0 or more")
        if sigma is not None and known is None:
            raise CalibrationError(f"{path}: {name}.{key} says how well {of} is known, which is not given")
        sigmas.append(float(sigma or 0))
    return Calibrated(K, size[0], size[1], distortion, R, C, entry.get("metric") is not False, *sigmas)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_rotation(R: Matrix, tolerance: float = 1e-3) -> bool:
    dots = [sum(a * b for a, b in zip(R[i], R[j], strict=True)) - (i == j) for i in range(3) for j in range(3)]
    cross = [R[0][1] * R[1][2] - R[0][2] * R[1][1], R[0][2] * R[1][0] - R[0][0] * R[1][2], R[0][0] * R[1][1] - R[0][1] * R[1][0]]
    return max(map(abs, dots)) < tolerance and sum(a * b for a, b in zip(cross, R[2], strict=True)) > 0


def _read_colmap(folder: Path) -> dict[str, Calibrated]:
    cameras: dict[str, tuple[Matrix, int, int, list[float] | None]] = {}
    try:
        camera_lines = (folder / "cameras.txt").read_text().splitlines()
        image_lines = (folder / "images.txt").read_text().splitlines()
    except OSError as error:
        raise CalibrationError(f"{folder} must hold cameras.txt and images.txt (COLMAP's text model): {error.strerror}") from None
    for number, line in enumerate(camera_lines, 1):
        if words := _words(line):
            try:
                cameras[words[0]] = _colmap_intrinsics(words[1], int(words[2]), int(words[3]), [float(w) for w in words[4:]])
            except (IndexError, ValueError) as error:
                raise CalibrationError(f"{folder / 'cameras.txt'}:{number}: {error}") from None
    found: dict[str, Calibrated] = {}
    # each image takes two lines, the second being its 2-D points (possibly empty): only the first is of interest
    lines = [(n, line) for n, line in enumerate(image_lines, 1) if not line.startswith("#")]
    for number, line in lines[::2]:
        words = line.split(maxsplit=9)
        if not words:
            continue
        try:
            qw, qx, qy, qz, *t = (float(w) for w in words[1:8])
            K, width, height, distortion = cameras[words[8]]
            R = _quaternion_to_rotation(qw, qx, qy, qz)
            C = [-sum(R[j][i] * t[j] for j in range(3)) for i in range(3)]
            found[words[9].strip()] = Calibrated(K, width, height, distortion, R, C)
        except (IndexError, ValueError, KeyError):
            raise CalibrationError(f"{folder / 'images.txt'}:{number}: not an image line of COLMAP's text model") from None
    return found


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
    K = [[p[fx], 0.0, p[cx] - 0.5], [0.0, p[fy], p[cy] - 0.5], [0.0, 0.0, 1.0]]
    distortion = ([p[i] for i in coefficients] + [0.0] * 5)[:5] if coefficients else None
    return K, width, height, distortion


def _quaternion_to_rotation(w: float, x: float, y: float, z: float) -> Matrix:
    n = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / n, x / n, y / n, z / n
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]

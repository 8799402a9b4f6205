"""Calibrations read from files: the JSON of camera matrices, COLMAP's models, and what OpenCV, ROS and Kalibr write.

All give, for each image or camera name, intrinsics for a stated image size and, where known, the pose (x ~ K R (X - C)).  Plain
lists out; no numpy needed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..cache.untrusted import is_file, is_folder
from .calibrated import Calibrated, CalibrationError, is_number, is_rotation, is_size, lens_fault, text_of
from .camera_files import document_of, read_camera_file
from .colmap import is_colmap, read_colmap
from .locations import SiteError, parse_yaml

__all__ = ["Calibrated", "CalibrationError", "find_camera", "read_calibration"]

SUFFIXES = {".yaml", ".yml", ".json"}
"""Of files with one camera each, in a folder of such."""


def read_calibration(path: Path) -> dict[str, Calibrated]:
    """Cameras by name, from a file, from a COLMAP model (a folder), or from a folder with a file for each camera.

    Raises
    ------
    CalibrationError
        Missing, unreadable, or an entry without what it needs.
    """
    if is_folder(path):
        return _read_folder(path)
    text = text_of(path)
    if path.suffix.lower() == ".json" or text.lstrip().startswith(("{", "[")):
        return _read_json(path, text)
    found = read_camera_file(document_of(path, text))
    if found is None:
        what = "holds no calibration: neither OpenCV's camera_matrix, nor ROS's camera_info, nor Kalibr's cam0"
        raise CalibrationError(what, where=f"{path}:1:1", remedy=_REMEDY)
    return found


def find_camera(cameras: dict[str, Calibrated], camera: str) -> Calibrated | None:
    """The entry of a camera id: the same name, the same name without extension, or a folder of that name."""
    if camera in cameras:
        return cameras[camera]
    for name, entry in cameras.items():
        path = Path(name)
        if path.stem == camera or path.name == camera or camera in path.parent.parts:
            return entry
    return None


_REMEDY = "give K (3x3), width, height and, where known, R (3x3) and C (3 numbers): x ~ K R (X - C); see sites/README.md"


class _Faulty(Exception):
    """An entry that cannot be used."""

    def __init__(self, what: str, *place: str) -> None:
        super().__init__(what)
        self.what = what
        self.place = place


def _read_folder(folder: Path) -> dict[str, Calibrated]:
    if is_colmap(folder):
        return read_colmap(folder)
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and is_file(file))
    if not files:
        return read_colmap(folder)  # which says what is missing
    found: dict[str, Calibrated] = {}
    for file in files:
        inside = read_calibration(file)
        # a file for one camera is called as the camera is, whatever the program that wrote it calls it
        found |= {file.stem: next(iter(inside.values()))} if len(inside) == 1 else inside
    return found


def _read_json(path: Path, text: str) -> dict[str, Calibrated]:
    try:
        entries = json.loads(text)
    except json.JSONDecodeError as error:
        raise CalibrationError(f"not JSON: {error.msg}", where=f"{path}:{error.lineno}:{error.colno}", remedy=_REMEDY) from None
    except (ValueError, RecursionError):  # numbers of thousands of digits, brackets within brackets
        raise CalibrationError("not JSON that can be read", where=str(path), remedy=_REMEDY) from None
    if not isinstance(entries, dict):
        what = "must map image names to K, width, height and, where known, R and C"
        raise CalibrationError(what, where=f"{path}:1:1", remedy=_REMEDY)
    if not all(isinstance(entry, dict) and "K" in entry for entry in entries.values()):
        foreign = read_camera_file(document_of(path, text))
        if foreign is not None:
            return foreign
    found = {}
    for name, entry in entries.items():
        try:
            found[str(name)] = _entry(str(name), entry)
        except _Faulty as fault:
            raise CalibrationError(fault.what, where=_place(path, text, fault.place), remedy=_REMEDY) from None
    return found


def _place(path: Path, text: str, place: tuple[str, ...]) -> str:
    """The file, with line and column of a value where they can be told (JSON is YAML, nearly)."""
    try:
        problem = parse_yaml(text, path).problem(place, "")
    except SiteError:
        return str(path)
    return f"{path}:{problem.line}:{problem.column}"


def _entry(name: str, entry: Any) -> Calibrated:
    def numbers(key: str, *shape: int) -> Any:
        value = entry.get(key)
        rows = value if len(shape) == 2 else [value]
        fits = isinstance(rows, list) and len(rows) == (shape[0] if len(shape) == 2 else 1)
        fits = fits and all(isinstance(r, list) and len(r) == shape[-1] and all(map(is_number, r)) for r in rows)
        if not fits:
            raise _Faulty(f"{name}.{key} must be {'x'.join(map(str, shape))} numbers", name, key)
        return value

    if not isinstance(entry, dict):
        raise _Faulty(f"{name} must hold K, width and height", name)
    missing = [key for key in ("K", "width", "height") if key not in entry]
    if missing:
        raise _Faulty(f"{name} lacks {' and '.join(missing)}", name)
    size = [entry["width"], entry["height"]]
    if not all(map(is_size, size)):
        raise _Faulty(f"{name}.width and height must be positive whole numbers of pixels", name, "width")
    R = numbers("R", 3, 3) if entry.get("R") is not None else None
    C = numbers("C", 3) if entry.get("C") is not None else None
    if R is not None and not is_rotation(R):
        raise _Faulty(f"{name}.R is not a rotation (orthonormal rows, determinant +1)", name, "R")
    K = numbers("K", 3, 3)
    if K[0][0] <= 0 or K[1][1] <= 0 or K[2] != [0, 0, 1]:
        raise _Faulty(f"{name}.K must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths", name, "K")
    model, distortion = _lens(name, entry)
    sigmas = []
    for key, of, known in (("position_sigma_m", "C", C), ("rotation_sigma_deg", "R", R)):
        sigma = entry.get(key)
        if sigma is not None and not (is_number(sigma) and sigma >= 0):
            raise _Faulty(f"{name}.{key} must be a number, 0 or more", name, key)
        if sigma is not None and known is None:
            raise _Faulty(f"{name}.{key} says how well {of} is known, which is not given", name, key)
        sigmas.append(float(sigma or 0))
    return Calibrated(K, size[0], size[1], distortion, R, C, entry.get("metric") is not False, sigmas[0], sigmas[1], model)


def _lens(name: str, entry: dict[str, Any]) -> tuple[str, list[float] | None]:
    """Model and coefficients."""
    model, distortion = entry.get("model", "brown"), entry.get("distortion")
    if distortion is not None and not (isinstance(distortion, list) and all(map(is_number, distortion))):
        raise _Faulty(f"{name}.distortion must be a list of numbers", name, "distortion")
    what, remedy = lens_fault(model, distortion) if isinstance(model, str) else ("model must be a word", "")
    if what:
        raise _Faulty(f"{name}.{what if remedy == '' else f'distortion: {what}; {remedy}'}", name, "distortion")
    if model == "brown" and distortion is not None and len(distortion) < 5:
        distortion = distortion + [0.0] * (5 - len(distortion))
    return model, distortion

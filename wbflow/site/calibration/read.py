"""Calibrations read from files: wbflow's own JSON, what OpenCV, ROS and Kalibr write, COLMAP's models, and folders with a file
for each camera.

All give, for each image or camera name, a lens and, where known, the placement (x ~ K R (X - C)).  Pixel centres are whole
numbers in all of them, as they are here.  Plain lists out; no numpy needed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ...cache.untrusted import is_file, is_folder
from ..locations import CalibrationError, Location, SiteError, parse_yaml, read_text
from ..models import Calibrated, Placement, lens_fault
from ..rotations import rotation_fault
from .camera_files import Faulty, check_K, document_of, is_number, is_size, lens_of, read_camera_file
from .colmap import is_colmap, read_colmap

SUFFIXES = {".yaml", ".yml", ".json"}
"""Of files with one camera each, in a folder of such."""
OWN_REMEDY = "give K (3x3), width, height and, where known, R (3x3) and C (3 numbers): x ~ K R (X - C); see sites/README.md"


def read_calibration(path: Path) -> dict[str, Calibrated]:
    """Cameras by name, from a file, from a COLMAP model (a folder), or from a folder with a file for each camera.

    Raises
    ------
    CalibrationError
        Missing, unreadable, or an entry without what it needs.
    """
    if is_folder(path):
        return _read_folder(path)
    try:
        text = read_text(path)
    except SiteError as error:
        raise CalibrationError.from_site_error(error) from None
    if path.suffix.lower() == ".json" or text.lstrip().startswith(("{", "[")):
        return _read_json(path, text)
    found = read_camera_file(document_of(path, text))
    if found is None:
        what = "holds no calibration: neither OpenCV's camera_matrix, nor ROS's camera_info, nor Kalibr's cam0"
        raise CalibrationError(what, where=f"{path}:1:1", remedy=OWN_REMEDY)
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
        raise CalibrationError(
            f"not JSON: {error.msg}", where=f"{path}:{error.lineno}:{error.colno}", remedy=OWN_REMEDY
        ) from None
    except (ValueError, RecursionError):  # numbers of thousands of digits, brackets within brackets
        raise CalibrationError("not JSON that can be read", where=str(path), remedy=OWN_REMEDY) from None
    if not isinstance(entries, dict):
        what = "must map image names to K, width, height and, where known, R and C"
        raise CalibrationError(what, where=f"{path}:1:1", remedy=OWN_REMEDY)
    if not all(isinstance(entry, dict) and "K" in entry for entry in entries.values()):
        foreign = read_camera_file(document_of(path, text))
        if foreign is not None:
            return foreign
    found = {}
    for name, entry in entries.items():
        try:
            found[str(name)] = _entry(str(name), entry)
        except Faulty as fault:
            raise CalibrationError(fault.what, where=_mark(path, text, fault.location), remedy=OWN_REMEDY) from None
    return found


def _mark(path: Path, text: str, location: Location) -> str:
    """The file, with line and column of a value where they can be found (JSON is YAML, nearly)."""
    try:
        return parse_yaml(text, path).problem(location, "").mark
    except SiteError:
        return str(path)


def _entry(name: str, entry: Any) -> Calibrated:
    def numbers(key: str, *shape: int) -> Any:
        value = entry.get(key)
        rows = value if len(shape) == 2 else [value]
        fits = isinstance(rows, list) and len(rows) == (shape[0] if len(shape) == 2 else 1)
        fits = fits and all(isinstance(r, list) and len(r) == shape[-1] and all(map(is_number, r)) for r in rows)
        if not fits:
            raise Faulty(f"{name}.{key} must be {'x'.join(map(str, shape))} numbers", (name, key))
        return value

    if not isinstance(entry, dict):
        raise Faulty(f"{name} must hold K, width and height", (name,))
    missing = [key for key in ("K", "width", "height") if key not in entry]
    if missing:
        raise Faulty(f"{name} lacks {' and '.join(missing)}", (name,))
    size = [entry["width"], entry["height"]]
    if not all(map(is_size, size)):
        raise Faulty(f"{name}.width and height must be positive whole numbers of pixels", (name, "width"))
    R = numbers("R", 3, 3) if entry.get("R") is not None else None
    C = numbers("C", 3) if entry.get("C") is not None else None
    if R is not None and (fault := rotation_fault(R)):
        raise Faulty(f"{name}.R {fault}", (name, "R"))
    K = numbers("K", 3, 3)
    check_K(K, f"{name}.K", (name, "K"))
    model, distortion = _own_lens(name, entry)
    sigmas = []
    for key, of, known in (("position_sigma_m", "C", C), ("rotation_sigma_deg", "R", R)):
        sigma = entry.get(key)
        if sigma is not None and not (is_number(sigma) and sigma >= 0):
            raise Faulty(f"{name}.{key} must be a number, 0 or more", (name, key))
        if sigma is not None and known is None:
            raise Faulty(f"{name}.{key} says how well {of} is known, which is not given", (name, key))
        sigmas.append(float(sigma or 0))
    return Calibrated(
        lens_of(K, size[0], size[1], distortion, model), Placement(R, C, sigmas[0], sigmas[1], entry.get("metric") is not False)
    )


def _own_lens(name: str, entry: dict[str, Any]) -> tuple[str, list[float]]:
    """Model and coefficients."""
    model, distortion = entry.get("model", "brown"), entry.get("distortion")
    if distortion is not None and not (isinstance(distortion, list) and all(map(is_number, distortion))):
        raise Faulty(f"{name}.distortion must be a list of numbers", (name, "distortion"))
    if not isinstance(model, str):
        raise Faulty(f"{name}.model must be a word", (name, "model"))
    what, remedy = lens_fault(model, distortion)
    if what:
        raise Faulty(f"{name}.distortion: {what}; {remedy}", (name, "distortion"))
    return model, distortion or []

"""Calibrations read from wbflow's own JSON, files of OpenCV, ROS and Kalibr, COLMAP's models, and folders with one file per
camera.  All give cameras by image or camera name."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

from ...cache.untrusted import is_file, is_folder
from ..yaml_document import Document, Problem, SiteError, parse_yaml, read_text
from .calibrated import REMEDY, Calibrated, Faulty, calibrated
from .colmap import is_colmap, read_colmap
from .kalibr import read_chain
from .opencv import MATRIX_KEYS, read_camera
from .values import text_of

_SUFFIXES = {".yaml", ".yml", ".json"}
"""Suffixes of the files in a folder with one calibration file per camera."""
_OWN_REMEDY = "give K (3x3), width, height and, where known, R (3x3) and C (3 numbers): x ~ K R (X - C); see sites/README.md"


def read_calibration(path: Path) -> dict[str, Calibrated]:
    """Cameras by name, from a file, a COLMAP model (a folder), or a folder with one file per camera.

    Raises SiteError for missing or unreadable files, and for incomplete entries.
    """
    if is_folder(path):
        return _read_folder(path)
    text = read_text(path)
    if path.suffix.lower() == ".json" or text.lstrip().startswith(("{", "[")):
        return _read_json(path, text)
    cameras = _cameras_in(_parse_document(path, text))
    if cameras is None:
        what = "holds no calibration: neither OpenCV's camera_matrix, nor ROS's camera_info, nor Kalibr's cam0"
        raise SiteError(Problem(path, what, _OWN_REMEDY, 1, 1))
    return cameras


def find_camera(cameras: dict[str, Calibrated], camera: str) -> Calibrated | None:
    """The entry of a camera id: its name, its file name (with or without extension) or one of its folders equals the id."""
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
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES and is_file(file))
    if not files:
        return read_colmap(folder)  # it reports what is missing
    cameras: dict[str, Calibrated] = {}
    for file in files:
        entries = read_calibration(file)
        # a file with one camera has the camera's name; a name inside it comes from the calibration program
        cameras |= {file.stem: next(iter(entries.values()))} if len(entries) == 1 else entries
    return cameras


def _read_json(path: Path, text: str) -> dict[str, Calibrated]:
    try:
        entries = json.loads(text)
    except json.JSONDecodeError as error:
        raise SiteError(Problem(path, f"not JSON: {error.msg}", _OWN_REMEDY, error.lineno, error.colno)) from None
    except (ValueError, RecursionError):  # numbers of thousands of digits, brackets within brackets
        raise SiteError(Problem(path, "not JSON that can be read", _OWN_REMEDY)) from None
    if not isinstance(entries, dict):
        what = "must map image names to K, width, height and, where known, R and C"
        raise SiteError(Problem(path, what, _OWN_REMEDY, 1, 1))
    if not all(isinstance(entry, dict) and "K" in entry for entry in entries.values()):
        foreign = _cameras_in(_parse_document(path, text))
        if foreign is not None:
            return foreign
    cameras = {}
    for name, entry in entries.items():
        try:
            if not isinstance(entry, dict):
                raise Faulty(f"{name} must hold K, width and height", (name,))
            cameras[name] = calibrated(entry, location=(name,))
        except Faulty as fault:
            raise SiteError(_problem_in_json(path, text, fault)) from None
    return cameras


def _problem_in_json(path: Path, text: str, fault: Faulty) -> Problem:
    """The problem, with line and column if these can be found by parsing the JSON as YAML (nearly a superset)."""
    try:
        place = parse_yaml(text, path).place(fault.location)
    except SiteError:
        place = 0, 0
    return Problem(path, fault.what, _OWN_REMEDY, *place)


def _parse_document(path: Path, text: str) -> Document:
    """A YAML or JSON file, without OpenCV's own first line and tags, which YAML parsers reject.  Raises SiteError."""
    if text.lstrip().startswith("<"):
        raise SiteError(Problem(path, "is XML, which is not read", "save it as .yaml or .json"))
    text = re.sub(r"\A%YAML[:\s]\s*1\.[0-9]+[^\n]*", "# YAML", text)  # the line stays, for the locations of errors
    text = re.sub(r"!!opencv-[\w-]+", "", text)
    text = re.sub(r"\n---\s*\Z", "\n", text)  # `ros2 topic echo` ends each message with it
    try:
        return parse_yaml(text, path)
    except SiteError as error:
        raise SiteError(replace(error.problems[0], remedy=REMEDY)) from None


def _cameras_in(document: Document) -> dict[str, Calibrated] | None:
    """The cameras of a file of OpenCV, ROS or Kalibr; None if it is of another kind.  Raises SiteError."""
    data = document.data
    if not isinstance(data, dict):
        return None
    try:
        if any(isinstance(entry, dict) and "camera_model" in entry and "intrinsics" in entry for entry in data.values()):
            return read_chain(data)
        if any(isinstance(data.get(key), dict | list) for key in MATRIX_KEYS):
            return {text_of(data.get("camera_name")) or document.path.stem: read_camera(data)}
    except Faulty as fault:
        raise SiteError(Problem(document.path, fault.what, fault.remedy, *document.place(fault.location))) from None
    return None

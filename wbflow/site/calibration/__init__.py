"""Calibrations read from files: wbflow's own JSON, what OpenCV, ROS and Kalibr write, COLMAP's models, and folders with a file
for each camera.  All give a camera for each image or camera name.

References
----------
OpenCV: samples/cpp/tutorial_code/calib3d/camera_calibration; cv::FileStorage; opencv_contrib, ccalib/samples/omni_calibration
ROS: sensor_msgs/CameraInfo, camera_calibration_parsers; REP 104 (regions of interest)
Kalibr: github.com/ethz-asl/kalibr/wiki/yaml-formats, wiki/supported-models
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...cache.untrusted import is_file, is_folder
from ..yaml_document import CalibrationError, Document, Location, SiteError, parse_yaml, read_text
from .calibrated import REMEDY, Calibrated, Faulty, Matrix, calibrated, centre, product, rotation_fault
from .colmap import is_colmap, read_colmap

SUFFIXES = {".yaml", ".yml", ".json"}
"""Of files with one camera each, in a folder of such."""
OWN_REMEDY = "give K (3x3), width, height and, where known, R (3x3) and C (3 numbers): x ~ K R (X - C); see sites/README.md"


def read_calibration(path: Path) -> dict[str, Calibrated]:
    """Cameras by name, from a file, from a COLMAP model (a folder), or from a folder with a file for each camera.

    Raises CalibrationError for what is missing or unreadable, and for an entry without what it needs.
    """
    if is_folder(path):
        return _read_folder(path)
    try:
        text = read_text(path)
    except SiteError as error:
        raise CalibrationError.from_site_error(error) from None
    if path.suffix.lower() == ".json" or text.lstrip().startswith(("{", "[")):
        return _read_json(path, text)
    found = _camera_file(_document_of(path, text))
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
        foreign = _camera_file(_document_of(path, text))
        if foreign is not None:
            return foreign
    found = {}
    for name, entry in entries.items():
        try:
            if not isinstance(entry, dict):
                raise Faulty(f"{name} must hold K, width and height", (name,))
            found[str(name)] = calibrated(entry, location=(name,))
        except Faulty as fault:
            raise CalibrationError(fault.what, where=_mark(path, text, fault.location), remedy=OWN_REMEDY) from None
    return found


def _mark(path: Path, text: str, location: Location) -> str:
    """The file, with line and column of a value where they can be found (JSON is YAML, nearly)."""
    try:
        return parse_yaml(text, path).problem(location, "").mark
    except SiteError:
        return str(path)


_K = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix", "mtx", "K", "k")
_D = ("distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "distCoeffs", "dist", "distortion", "D", "d")
_WIDTH = ("image_width", "image_Width", "width")
_HEIGHT = ("image_height", "image_Height", "height")
_SIZE = ("image_size", "imageSize", "resolution")
_MODEL = ("distortion_model", "camera_model", "model")
_XI = ("xi", "Xi")

_NAMES = {
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
"""What others call our models."""

_KALIBR = {"pinhole": ("", 0), "omni": ("omni", 1), "eucm": ("eucm", 2), "ds": ("double-sphere", 2)}
"""Kalibr's projections: our model ("" for that of their distortion), and how many intrinsics come before fu, fv, pu, pv."""


def _document_of(path: Path, text: str) -> Document:
    """A YAML or JSON file, with OpenCV's first line and tags, which no other program knows.  Raises CalibrationError."""
    if text.lstrip().startswith("<"):
        raise CalibrationError("is XML, which is not read", where=str(path), remedy="save it as .yaml or .json")
    text = re.sub(r"\A%YAML[:\s]\s*1\.[0-9]+[^\n]*", "# YAML", text)  # the line stays, for the locations of errors
    text = re.sub(r"!!opencv-[\w-]+", "", text)
    text = re.sub(r"\n---\s*\Z", "\n", text)  # `ros2 topic echo` ends each message with it
    try:
        return parse_yaml(text, path)
    except SiteError as error:
        raise CalibrationError.from_site_error(error, REMEDY) from None


def _camera_file(document: Document) -> dict[str, Calibrated] | None:
    """The cameras of a file of OpenCV, ROS or Kalibr; None where it is of none of them.  Raises CalibrationError."""
    data = document.data
    if not isinstance(data, dict):
        return None
    try:
        if any(isinstance(entry, dict) and "camera_model" in entry and "intrinsics" in entry for entry in data.values()):
            return _kalibr(data)
        if any(isinstance(data.get(key), dict | list) for key in _K):
            return {_text(data.get("camera_name")) or document.path.stem: _single(data)}
    except Faulty as fault:
        where = document.problem(fault.location, "").mark
        raise CalibrationError(fault.what, where=where, remedy=fault.remedy) from None
    return None


def _single(data: dict[str, Any]) -> Calibrated:
    """OpenCV and ROS: one camera, K and D by one of their names."""
    key, bent, xi = _key(data, _K), _key(data, _D), _key(data, _XI)
    assert key
    if bent is None:
        raise Faulty(f"lacks the distortion ({', '.join(_D[:3])} or D)", (), "add it; zeros where there is none")
    K, distortion = _rows(_numbers(data[key], key), 3), _numbers(data[bent], bent)
    model = _model(data, len(distortion))
    if xi is not None:  # as cv2.omnidir's files have it, beside k1 k2 p1 p2
        model, distortion = "omni", _numbers(data[xi], xi) + distortion
    size = _cut(data, K, _size(data))
    return calibrated({"K": K, **size, "distortion": distortion, "model": model}, {"K": key, "distortion": bent})


def _cut(data: dict[str, Any], K: Matrix, size: dict[str, int]) -> dict[str, int]:
    """The size of pictures that are a part of the sensor (ROS's region of interest), to whose corner K is moved."""
    roi = data.get("roi")
    names = ("x_offset", "y_offset", "width", "height")
    if not isinstance(roi, dict) or not any(roi.get(name) for name in names):
        return size  # all zero: the whole sensor
    x, y, across, down = (roi.get(name, 0) for name in names)
    if not all(isinstance(value, int) and value >= 0 for value in (x, y, across, down)):
        raise Faulty("roi must be a part of the picture, in whole pixels", ("roi",))
    if x + across > size["width"] or y + down > size["height"]:
        raise Faulty(f"roi reaches beyond the {size['width']}x{size['height']} pixels of the camera", ("roi",))
    K[0][2] -= x
    K[1][2] -= y
    return {"width": across, "height": down}


def _model(data: dict[str, Any], count: int) -> str:
    """Return the model that a file names, else the one that its flags and its number of coefficients imply."""
    key = _key(data, _MODEL)
    named = _text(data.get(key, "")).lower().replace("-", "_") if key else ""
    fisheye = data.get("fisheye_model") or "fisheye" in _text(data.get("flags")).lower()
    model = _NAMES.get(named, named.replace("_", "-")) or ("fisheye" if fisheye else "brown")
    return "rational" if model == "brown" and count >= 8 else model


def _kalibr(data: dict[str, Any]) -> dict[str, Calibrated]:
    """A chain of cameras; each says how the one before it lies, so that the first one is the world."""
    found: dict[str, Calibrated] = {}
    R: Matrix | None = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    t = [0.0, 0.0, 0.0]
    for k, (name, entry) in enumerate(data.items()):
        if not isinstance(entry, dict):
            continue
        if k and R is not None:
            R, t = _chained(name, entry, R, t)
        pose = {"R": R, "C": centre(R, t)} if R and len(data) > 1 else {}
        found[str(name)] = camera = _kalibr_camera(str(name), entry, pose)
        if topic := _text(entry.get("rostopic")).strip("/"):
            found[topic] = camera
    return found


def _chained(name: str, entry: dict[str, Any], R: Matrix, t: list[float]) -> tuple[Matrix | None, list[float]]:
    """The pose of a camera, x = R X + t, from that of the one before it; None where the file does not say."""
    if "T_cn_cnm1" not in entry:
        return None, t
    T = _rows(_numbers(entry["T_cn_cnm1"], "T_cn_cnm1", (name,)), 4)
    turn = [row[:3] for row in T[:3]]
    if [*map(len, T)] != [4] * 4 or rotation_fault(turn):
        raise Faulty(f"{name}.T_cn_cnm1 must be 4x4: a rotation and a translation", (name, "T_cn_cnm1"))
    return product(turn, R), [sum(row[k] * t[k] for k in range(3)) + row[3] for row in T[:3]]


def _kalibr_camera(name: str, entry: dict[str, Any], pose: dict[str, Any]) -> Calibrated:
    projection = _text(entry.get("camera_model")).lower()
    if projection not in _KALIBR:
        raise Faulty(f"{name}.camera_model must be one of {', '.join(_KALIBR)}", (name, "camera_model"))
    named, first = _KALIBR[projection]
    intrinsics = _numbers(entry.get("intrinsics"), "intrinsics", (name,))
    if len(intrinsics) != first + 4:
        what = f"{name}.intrinsics of a {projection} camera has {first + 4} numbers, not {len(intrinsics)}"
        raise Faulty(what, (name, "intrinsics"))
    bent = _text(entry.get("distortion_model")).lower() or "none"
    distortion = [] if bent == "none" else _numbers(entry.get("distortion_coeffs", []), "distortion_coeffs", (name,))
    model = "brown" if bent == "none" else _NAMES.get(bent, bent)
    if named:
        if model != "brown" or (named != "omni" and any(distortion)):
            what = f"{name}: {projection} with {bent} distortion is not known"
            remedy = f"calibrate with {projection}-{'radtan' if named == 'omni' else 'none'}"
            raise Faulty(what, (name, "distortion_model"), remedy)
        model = named
        distortion = [*intrinsics[:first], *([*distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5] if named == "omni" else [])]
    fx, fy, cx, cy = intrinsics[first:]
    K = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    fields = {"K": K, **_size(entry, (name,)), "distortion": distortion, "model": model, **pose}
    return calibrated(fields, {"K": "intrinsics", "distortion": "distortion_coeffs"}, (name,))


def _size(data: dict[str, Any], location: Location = ()) -> dict[str, Any]:
    """Width and height of the pictures that it is for."""
    keys = _key(data, _WIDTH), _key(data, _HEIGHT)
    if keys[0] and keys[1]:
        return {"width": data[keys[0]], "height": data[keys[1]]}
    size = data[key] if (key := _key(data, _SIZE)) else []
    if not isinstance(size, list) or len(size) != 2:
        what = " ".join([*map(str, location), "lacks the size of the pictures"])
        raise Faulty(what, location, "add image_width and image_height, in pixels")
    return {"width": size[0], "height": size[1]}


def _rows(flat: list[float], width: int) -> Matrix:
    return [flat[i : i + width] for i in range(0, len(flat), width)]


def _numbers(value: Any, key: str, location: Location = ()) -> list[float]:
    """All numbers of a matrix: nested lists, or OpenCV's and ROS's rows, cols and data."""
    if isinstance(value, dict):
        rows, columns = value.get("rows"), value.get("cols")
        flat = list(_flat(value.get("data")))
        if isinstance(rows, int) and isinstance(columns, int) and rows * columns != len(flat):
            raise Faulty(f"{key} says {rows} x {columns}, and holds {len(flat)} numbers", (*location, key))
    else:
        flat = list(_flat(value))
    try:
        return [float(str(number)) for number in flat]  # also words: YAML 1.1 takes 1e-05 for one; but no truth
    except (TypeError, ValueError, OverflowError):
        raise Faulty(f"{key} must hold numbers", (*location, key)) from None


def _flat(value: Any) -> Iterable[Any]:
    if isinstance(value, list):
        for item in value:
            yield from _flat(item)
    else:
        yield value


def _key(data: dict[str, Any], names: tuple[str, ...]) -> str | None:
    return next((name for name in names if data.get(name) is not None), None)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""

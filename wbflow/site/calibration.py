"""Calibrations read from files: wbflow's own JSON, what OpenCV (FileStorage), ROS (camera_info) and Kalibr (camchain) write,
COLMAP's models, and folders with a file for each camera.

All give, for each image or camera name, a lens and, where known, the placement (x ~ K R (X - C)).  Pixel centres are whole
numbers in all of them, as they are here.  Plain lists out; no numpy needed.

References
----------
OpenCV: samples/cpp/tutorial_code/calib3d/camera_calibration; cv::FileStorage; opencv_contrib, ccalib/samples/omni_calibration
ROS: sensor_msgs/CameraInfo, camera_calibration_parsers; REP 104 (regions of interest)
Kalibr: github.com/ethz-asl/kalibr/wiki/yaml-formats, wiki/supported-models
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..cache.untrusted import is_file, is_folder
from .colmap import is_colmap, read_colmap
from .locations import CalibrationError, Document, Location, SiteError, parse_yaml, read_text
from .models import LARGEST, MOST_PIXELS_A_SIDE, Calibrated, Lens, Matrix, Placement, lens_fault
from .rotations import rotation_fault

__all__ = ["Calibrated", "CalibrationError", "find_camera", "read_calibration"]

SUFFIXES = {".yaml", ".yml", ".json"}
"""Of files with one camera each, in a folder of such."""
REMEDY = "give the file that OpenCV, ROS, Kalibr, COLMAP or wbflow wrote; see sites/README.md"
OWN_REMEDY = "give K (3x3), width, height and, where known, R (3x3) and C (3 numbers): x ~ K R (X - C); see sites/README.md"

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

_KALIBR = {"pinhole": 0, "omni": 1, "eucm": 2, "ds": 2}
"""Kalibr's projections, and how many of their intrinsics come before fu, fv, pu, pv."""


class _Faulty(Exception):
    """A value that cannot be used, and where it is."""

    def __init__(self, what: str, location: Location = (), remedy: str = REMEDY) -> None:
        super().__init__(what)
        self.what, self.location, self.remedy = what, location, remedy


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
    found = _read_camera_file(_document(path, text))
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
        foreign = _read_camera_file(_document(path, text))
        if foreign is not None:
            return foreign
    found = {}
    for name, entry in entries.items():
        try:
            found[str(name)] = _entry(str(name), entry)
        except _Faulty as fault:
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
        fits = fits and all(isinstance(r, list) and len(r) == shape[-1] and all(map(_is_number, r)) for r in rows)
        if not fits:
            raise _Faulty(f"{name}.{key} must be {'x'.join(map(str, shape))} numbers", (name, key))
        return value

    if not isinstance(entry, dict):
        raise _Faulty(f"{name} must hold K, width and height", (name,))
    missing = [key for key in ("K", "width", "height") if key not in entry]
    if missing:
        raise _Faulty(f"{name} lacks {' and '.join(missing)}", (name,))
    size = [entry["width"], entry["height"]]
    if not all(map(_is_size, size)):
        raise _Faulty(f"{name}.width and height must be positive whole numbers of pixels", (name, "width"))
    R = numbers("R", 3, 3) if entry.get("R") is not None else None
    C = numbers("C", 3) if entry.get("C") is not None else None
    if R is not None and (fault := rotation_fault(R)):
        raise _Faulty(f"{name}.R {fault}", (name, "R"))
    K = numbers("K", 3, 3)
    _check_K(K, f"{name}.K", (name, "K"))
    model, distortion = _own_lens(name, entry)
    sigmas = []
    for key, of, known in (("position_sigma_m", "C", C), ("rotation_sigma_deg", "R", R)):
        sigma = entry.get(key)
        if sigma is not None and not (_is_number(sigma) and sigma >= 0):
            raise _Faulty(f"{name}.{key} must be a number, 0 or more", (name, key))
        if sigma is not None and known is None:
            raise _Faulty(f"{name}.{key} says how well {of} is known, which is not given", (name, key))
        sigmas.append(float(sigma or 0))
    return Calibrated(
        _lens(K, size[0], size[1], distortion, model), Placement(R, C, sigmas[0], sigmas[1], entry.get("metric") is not False)
    )


def _own_lens(name: str, entry: dict[str, Any]) -> tuple[str, list[float]]:
    """Model and coefficients."""
    model, distortion = entry.get("model", "brown"), entry.get("distortion")
    if distortion is not None and not (isinstance(distortion, list) and all(map(_is_number, distortion))):
        raise _Faulty(f"{name}.distortion must be a list of numbers", (name, "distortion"))
    if not isinstance(model, str):
        raise _Faulty(f"{name}.model must be a word", (name, "model"))
    what, remedy = lens_fault(model, distortion)
    if what:
        raise _Faulty(f"{name}.distortion: {what}; {remedy}", (name, "distortion"))
    return model, distortion or []


def _check_K(K: Matrix, name: str, location: Location) -> None:
    if K[0][0] <= 0 or K[1][1] <= 0 or K[2] != [0, 0, 1]:
        raise _Faulty(f"{name} must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths", location)


def _lens(K: Matrix, width: int, height: int, distortion: list[float], model: str) -> Lens:
    """A lens; coefficients that a short list of "brown" leaves out are 0."""
    if model == "brown" or not distortion:
        distortion = distortion + [0.0] * (5 - len(distortion))
    return Lens(K=K, distortion=distortion, width=width, height=height, model=model)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST  # not NaN either


def _is_size(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value <= MOST_PIXELS_A_SIDE


def _document(path: Path, text: str) -> Document:
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


def _read_camera_file(document: Document) -> dict[str, Calibrated] | None:
    """The cameras of a file of OpenCV, ROS or Kalibr; None where it is of none of them.  Raises CalibrationError."""
    data = document.data
    if not isinstance(data, dict):
        return None
    try:
        if any(isinstance(entry, dict) and "camera_model" in entry and "intrinsics" in entry for entry in data.values()):
            return _kalibr(data)
        if any(isinstance(data.get(key), dict | list) for key in _K):
            return {_text(data.get("camera_name")) or document.path.stem: _single(data)}
    except _Faulty as fault:
        where = document.problem(fault.location, "").mark
        raise CalibrationError(fault.what, where=where, remedy=fault.remedy) from None
    return None


def _single(data: dict[str, Any]) -> Calibrated:
    """OpenCV and ROS: one camera, K and D by one of their names."""
    width, height = _size(data)
    key = _key(data, _K)
    assert key
    flat = _numbers(data[key], key)
    if len(flat) != 9:
        raise _Faulty(f"{key} must hold 3x3 numbers, not {len(flat)}", (key,))
    K = [flat[0:3], flat[3:6], flat[6:9]]
    _check_K(K, key, (key,))
    found = _key(data, _D)
    if found is None:
        raise _Faulty(f"lacks the distortion ({', '.join(_D[:3])} or D)", (), "add it; zeros where there is none")
    distortion = _numbers(data[found], found)
    model = _model(data, len(distortion))
    if (key := _key(data, _XI)) is not None:  # as cv2.omnidir's files have it, beside k1 k2 p1 p2
        model, distortion = "omni", _numbers(data[key], key) + distortion
    width, height = _cut(data, K, width, height)
    return _checked(K, width, height, distortion, model, found)


def _cut(data: dict[str, Any], K: Matrix, width: int, height: int) -> tuple[int, int]:
    """The size of pictures that are a part of the sensor (ROS's region of interest), to whose corner K is moved."""
    roi = data.get("roi")
    names = ("x_offset", "y_offset", "width", "height")
    if not isinstance(roi, dict) or not any(roi.get(name) for name in names):
        return width, height  # all zero: the whole sensor
    x, y, across, down = (roi.get(name, 0) for name in names)
    if not (_is_size(across) and _is_size(down) and all(v == 0 or _is_size(v) for v in (x, y))):
        raise _Faulty("roi must be a part of the picture, in whole pixels", ("roi",))
    if x + across > width or y + down > height:
        raise _Faulty(f"roi reaches beyond the {width}x{height} pixels of the camera", ("roi",))
    K[0][2] -= x
    K[1][2] -= y
    return across, down


def _model(data: dict[str, Any], count: int) -> str:
    """The model that a file names, or that its number of coefficients and its flags tell."""
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
            turned = _chained(name, entry, R, t)
            R, t = turned if turned else (None, t)
        camera = _kalibr_camera(str(name), entry)
        if R is not None and len(data) > 1:
            C = [-sum(R[j][i] * t[j] for j in range(3)) for i in range(3)]
            camera = dataclasses.replace(camera, placement=Placement(R, C))
        found[str(name)] = camera
        if topic := _text(entry.get("rostopic")).strip("/"):
            found[topic] = camera
    return found


def _chained(name: str, entry: dict[str, Any], R: Matrix, t: list[float]) -> tuple[Matrix, list[float]] | None:
    """The pose of a camera, x = R X + t, from that of the one before it; None where the file does not say."""
    if "T_cn_cnm1" not in entry:
        return None
    T = _numbers(entry["T_cn_cnm1"], "T_cn_cnm1", (name,))
    rows = [T[4 * i : 4 * i + 3] for i in range(3)]
    if len(T) != 16 or rotation_fault(rows):
        raise _Faulty(f"{name}.T_cn_cnm1 must be 4x4: a rotation and a translation", (name, "T_cn_cnm1"))
    turned = [[sum(rows[i][k] * R[k][j] for k in range(3)) for j in range(3)] for i in range(3)]
    return turned, [sum(rows[i][k] * t[k] for k in range(3)) + T[4 * i + 3] for i in range(3)]


def _kalibr_camera(name: str, entry: dict[str, Any]) -> Calibrated:
    projection = _text(entry.get("camera_model")).lower()
    if projection not in _KALIBR:
        raise _Faulty(f"{name}.camera_model must be one of {', '.join(_KALIBR)}", (name, "camera_model"))
    intrinsics = _numbers(entry.get("intrinsics"), "intrinsics", (name,))
    first = _KALIBR[projection]
    if len(intrinsics) != first + 4:
        what = f"{name}.intrinsics of a {projection} camera has {first + 4} numbers, not {len(intrinsics)}"
        raise _Faulty(what, (name, "intrinsics"))
    fx, fy, cx, cy = intrinsics[first:]
    if min(fx, fy) <= 0:
        raise _Faulty(f"{name}.intrinsics: focal lengths must be positive", (name, "intrinsics"))
    bent = _text(entry.get("distortion_model")).lower() or "none"
    given = _numbers(entry.get("distortion_coeffs", []), "distortion_coeffs", (name,))
    model, distortion = _NAMES.get(bent, bent), given
    if bent == "none":
        model, distortion = "brown", []
    if model == "brown":
        distortion = distortion + [0.0] * (5 - len(distortion))
    if projection != "pinhole":
        if model != "brown" or (projection != "omni" and any(distortion)):
            what = f"{name}: {projection} with {bent} distortion is not known"
            raise _Faulty(
                what, (name, "distortion_model"), f"calibrate with {'omni-radtan' if first == 1 else projection + '-none'}"
            )
        model = {"omni": "omni", "eucm": "eucm", "ds": "double-sphere"}[projection]
        distortion = intrinsics[:first] + (distortion if projection == "omni" else [])
    K = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    width, height = _size(entry, (name,))
    return _checked(K, width, height, distortion, model, "distortion_coeffs", (name,))


def _checked(
    K: Matrix, width: int, height: int, distortion: list[float], model: str, key: str, location: Location = ()
) -> Calibrated:
    what, remedy = lens_fault(model, distortion)
    if what:
        raise _Faulty(".".join([*map(str, location), f"{key}: {what}"]), (*location, key), remedy)
    return Calibrated(_lens(K, width, height, distortion, model))


def _size(data: dict[str, Any], location: Location = ()) -> tuple[int, int]:
    """Width and height of the pictures that it is for."""
    keys = _key(data, _WIDTH), _key(data, _HEIGHT)
    if keys[0] and keys[1]:
        size = [data[keys[0]], data[keys[1]]]
    elif key := _key(data, _SIZE):
        size = data[key]
    else:
        what = " ".join([*map(str, location), "lacks the size of the pictures"])
        raise _Faulty(what, location, "add image_width and image_height, in pixels")
    if not isinstance(size, list) or len(size) != 2 or not all(map(_is_size, size)):
        raise _Faulty(
            "width and height must be positive whole numbers of pixels", (*location, keys[0] or _key(data, _SIZE) or "")
        )
    return size[0], size[1]


def _numbers(value: Any, key: str, location: Location = ()) -> list[float]:
    """All numbers of a matrix: nested lists, or OpenCV's and ROS's rows, cols and data."""
    if isinstance(value, dict):
        rows, columns = value.get("rows"), value.get("cols")
        flat = list(_flat(value.get("data")))
        if isinstance(rows, int) and isinstance(columns, int) and rows * columns != len(flat):
            raise _Faulty(f"{key} says {rows} x {columns}, and holds {len(flat)} numbers", (*location, key))
    else:
        flat = list(_flat(value))
    if not all(map(_is_number, flat)):
        raise _Faulty(f"{key} must hold numbers", (*location, key))
    return [float(number) for number in flat]


def _flat(value: Any) -> Iterable[Any]:
    if isinstance(value, list):
        for item in value:
            yield from _flat(item)
    elif isinstance(value, str):  # YAML 1.1 takes 1e-05 for a word
        try:
            yield float(value)
        except ValueError:
            yield value
    else:
        yield value


def _key(data: dict[str, Any], names: tuple[str, ...]) -> str | None:
    return next((name for name in names if data.get(name) is not None), None)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""

"""Calibrations of single cameras and rigs as OpenCV (FileStorage), ROS (camera_info) and Kalibr (camchain) write them.

References
----------
OpenCV: samples/cpp/tutorial_code/calib3d/camera_calibration; cv::FileStorage; opencv_contrib, ccalib/samples/omni_calibration
ROS: sensor_msgs/CameraInfo, camera_calibration_parsers; REP 104 (regions of interest)
Kalibr: github.com/ethz-asl/kalibr/wiki/yaml-formats, wiki/supported-models
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..locations import CalibrationError, Document, Location, SiteError, parse_yaml
from ..models import LARGEST, MOST_PIXELS_A_SIDE, Calibrated, Lens, Matrix, Placement, lens_fault
from ..rotations import rotation_fault

REMEDY = "give the file that OpenCV, ROS, Kalibr, COLMAP or wbflow wrote; see sites/README.md"

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


class Faulty(Exception):
    """A value that cannot be used, and where it is."""

    def __init__(self, what: str, location: Location = (), remedy: str = REMEDY) -> None:
        super().__init__(what)
        self.what, self.location, self.remedy = what, location, remedy


def check_K(K: Matrix, name: str, location: Location) -> None:
    if K[0][0] <= 0 or K[1][1] <= 0 or K[2] != [0, 0, 1]:
        raise Faulty(f"{name} must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths", location)


def lens_of(K: Matrix, width: int, height: int, distortion: list[float], model: str) -> Lens:
    """Return a lens.

    Parameters
    ----------
    K : matrix
        3x3, pixels.
    width, height : int
        Pixels.
    distortion : list of float
        Coefficients of the model; those that a short list of "brown" leaves out are 0.
    model : str
        Name of the lens model.
    """
    if model == "brown" or not distortion:
        distortion = distortion + [0.0] * (5 - len(distortion))
    return Lens(K=K, distortion=distortion, width=width, height=height, model=model)


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST  # not NaN either


def is_size(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value <= MOST_PIXELS_A_SIDE


def document_of(path: Path, text: str) -> Document:
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


def read_camera_file(document: Document) -> dict[str, Calibrated] | None:
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
    width, height = _size(data)
    key = _key(data, _K)
    assert key
    flat = _numbers(data[key], key)
    if len(flat) != 9:
        raise Faulty(f"{key} must hold 3x3 numbers, not {len(flat)}", (key,))
    K = [flat[0:3], flat[3:6], flat[6:9]]
    check_K(K, key, (key,))
    found = _key(data, _D)
    if found is None:
        raise Faulty(f"lacks the distortion ({', '.join(_D[:3])} or D)", (), "add it; zeros where there is none")
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
    if not (is_size(across) and is_size(down) and all(v == 0 or is_size(v) for v in (x, y))):
        raise Faulty("roi must be a part of the picture, in whole pixels", ("roi",))
    if x + across > width or y + down > height:
        raise Faulty(f"roi reaches beyond the {width}x{height} pixels of the camera", ("roi",))
    K[0][2] -= x
    K[1][2] -= y
    return across, down


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
        raise Faulty(f"{name}.T_cn_cnm1 must be 4x4: a rotation and a translation", (name, "T_cn_cnm1"))
    turned = [[sum(rows[i][k] * R[k][j] for k in range(3)) for j in range(3)] for i in range(3)]
    return turned, [sum(rows[i][k] * t[k] for k in range(3)) + T[4 * i + 3] for i in range(3)]


def _kalibr_camera(name: str, entry: dict[str, Any]) -> Calibrated:
    projection = _text(entry.get("camera_model")).lower()
    if projection not in _KALIBR:
        raise Faulty(f"{name}.camera_model must be one of {', '.join(_KALIBR)}", (name, "camera_model"))
    intrinsics = _numbers(entry.get("intrinsics"), "intrinsics", (name,))
    first = _KALIBR[projection]
    if len(intrinsics) != first + 4:
        what = f"{name}.intrinsics of a {projection} camera has {first + 4} numbers, not {len(intrinsics)}"
        raise Faulty(what, (name, "intrinsics"))
    fx, fy, cx, cy = intrinsics[first:]
    if min(fx, fy) <= 0:
        raise Faulty(f"{name}.intrinsics: focal lengths must be positive", (name, "intrinsics"))
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
            raise Faulty(
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
        raise Faulty(".".join([*map(str, location), f"{key}: {what}"]), (*location, key), remedy)
    return Calibrated(lens_of(K, width, height, distortion, model))


def _size(data: dict[str, Any], location: Location = ()) -> tuple[int, int]:
    """Width and height of the pictures that it is for."""
    keys = _key(data, _WIDTH), _key(data, _HEIGHT)
    if keys[0] and keys[1]:
        size = [data[keys[0]], data[keys[1]]]
    elif key := _key(data, _SIZE):
        size = data[key]
    else:
        what = " ".join([*map(str, location), "lacks the size of the pictures"])
        raise Faulty(what, location, "add image_width and image_height, in pixels")
    if not isinstance(size, list) or len(size) != 2 or not all(map(is_size, size)):
        raise Faulty("width and height must be positive whole numbers of pixels", (*location, keys[0] or _key(data, _SIZE) or ""))
    return size[0], size[1]


def _numbers(value: Any, key: str, location: Location = ()) -> list[float]:
    """All numbers of a matrix: nested lists, or OpenCV's and ROS's rows, cols and data."""
    if isinstance(value, dict):
        rows, columns = value.get("rows"), value.get("cols")
        flat = list(_flat(value.get("data")))
        if isinstance(rows, int) and isinstance(columns, int) and rows * columns != len(flat):
            raise Faulty(f"{key} says {rows} x {columns}, and holds {len(flat)} numbers", (*location, key))
    else:
        flat = list(_flat(value))
    if not all(map(is_number, flat)):
        raise Faulty(f"{key} must hold numbers", (*location, key))
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

"""One camera from a mapping of keys: wbflow's own JSON, OpenCV's files, ROS's camera_info, and what people write by hand.

They differ in the names of the keys; what the keys mean is the same.

References
----------
OpenCV: samples/cpp/tutorial_code/calib3d/camera_calibration; cv::FileStorage; opencv_contrib, ccalib/samples/omni_calibration
ROS: sensor_msgs/CameraInfo, camera_calibration_parsers; REP 104 (regions of interest)
"""

from __future__ import annotations

from typing import Any

from .calibrated import Calibrated, Faulty, Matrix, calibrated
from .entry import Entry
from .pose import POSE_KEYS, pose_of
from .values import MODEL_NAMES, numbers_of, rows_of, size_of, text_of

MATRIX_KEYS = ("camera_matrix", "intrinsic_matrix", "camera_intrinsics", "intrinsic", "intrinsics", "mtx", "K", "k")
FOCAL_KEYS = ("fx", "fl_x", "focal_length_x")
_FOCAL_Y_KEYS = ("fy", "fl_y", "focal_length_y")
_CENTRE_X_KEYS = ("cx", "ppx", "principal_point_x")
_CENTRE_Y_KEYS = ("cy", "ppy", "principal_point_y")
_DISTORTION_KEYS = (
    *("distortion_coefficients", "distortion_coeffs", "dist_coeffs", "dist_coefs", "dist_coef", "dist", "distortion"),
    *("coeffs", "D", "d"),
)
_COEFFICIENT_KEYS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Coefficients that are given one by one, in OpenCV's order."""
_FISHEYE_COEFFICIENT_KEYS = ("k1", "k2", "k3", "k4")
_MODEL_KEYS = ("distortion_model", "lens_model", "camera_model", "model")
_ROS_KEYS = ("header", "binning_x", "binning_y", "roi", "rectification_matrix", "projection_matrix")
UNIT_KEYS = ("unit", "units", "length_unit")
"""Keys for the unit of lengths."""
_KNOWN_KEYS = (
    *("K", "camera_matrix", "fx", "fy", "cx", "cy", "width", "height", "image_width", "image_height", "distortion", "model"),
    *("distortion_coefficients", "dist", "D", "position_sigma_m", "rotation_sigma_deg", "metric", *POSE_KEYS),
)
_REMEDY = "leave it out, or give what it says as K, width, height, model, distortion, R, C or t; see sites/README.md"


def is_camera(data: Any) -> bool:
    """Does a mapping look like a camera: does it have a camera matrix or focal lengths?"""
    return isinstance(data, dict) and Entry(data).has(*MATRIX_KEYS, *FOCAL_KEYS)


def read_camera(entry: Entry, needs_distortion: bool = False) -> Calibrated:
    """The camera of an entry.  Raises Faulty if something in it cannot be used, is contradictory, or is not understood.

    needs_distortion: refuse an entry without distortion: programs always write it, so it may be under an unknown name.
    """
    entry.unfold("intrinsics", "intrinsic", "camera_intrinsics", "extrinsics", "extrinsic", "pose")
    _refuse_other_units(entry)
    if _is_camera_info(entry):
        # the rotation and projection of *rectified* images, which are no pose of the camera
        entry.ignore("header", "rectification_matrix", "projection_matrix", "R", "r", "P", "p")
        _refuse_binning(entry)
        pose = {}
    else:
        pose = pose_of(entry)
    # each step reads its keys, so that in the end only those are unread that nothing understands
    matrix_key, K = _camera_matrix(entry)
    size = _region_size(entry, K, size_of(entry))
    model, distortion_key, distortion = _distortion(entry)
    if distortion is None and needs_distortion and model != "pinhole":
        entry.finish(_KNOWN_KEYS, _REMEDY)
        what = f"lacks the distortion ({', '.join(_DISTORTION_KEYS[:3])} or D)"
        raise Faulty(what, entry.location, "add it; zeros where there is none")
    fields: dict[str, Any] = {"K": K, **size, "model": model, **pose}
    if distortion is not None:
        fields["distortion"] = distortion
    for name in ("position_sigma_m", "rotation_sigma_deg", "metric"):
        key = entry.key((name,))
        if key is not None:
            fields[name] = entry[key]
    entry.finish(_KNOWN_KEYS, _REMEDY)
    return calibrated(fields, {"K": matrix_key, "distortion": distortion_key}, entry.location)


def _refuse_other_units(entry: Entry) -> None:
    """Refuse a camera whose lengths are stated to be in another unit than metres."""
    key = entry.key(UNIT_KEYS)
    if key is not None and text_of(entry[key]).lower() not in {"m", "metre", "metres", "meter", "meters"}:
        raise entry.fault(key, f"is {entry[key]}, and lengths are metres here", "write positions in metres, and remove it")


def _is_camera_info(entry: Entry) -> bool:
    """Is this ROS's message or its YAML file?  There R is the rectification of a stereo pair, not the camera's rotation."""
    return entry.has(*_ROS_KEYS) or (entry.has("P", "p") and entry.has("D", "d"))


def _refuse_binning(entry: Entry) -> None:
    """Refuse a ROS camera that joins pixels: its calibration is of the whole sensor, its pictures are smaller."""
    for name in ("binning_x", "binning_y"):
        key = entry.key((name,))
        if key is not None and entry[key] not in (0, 1):
            raise entry.fault(key, "above 1 means pictures smaller than the calibration's", "calibrate pictures without binning")


def _camera_matrix(entry: Entry) -> tuple[str, Matrix]:
    """The camera matrix (rows as given; checked later) and its key, from a matrix or from focal lengths and centre."""
    matrix_key = entry.key(MATRIX_KEYS)
    focal_key = entry.key(FOCAL_KEYS)
    if matrix_key is not None and focal_key is not None:
        raise entry.fault(focal_key, f"and {matrix_key} are both given", "keep one of them")
    if matrix_key is not None:
        numbers = numbers_of(entry, matrix_key)
        if len(numbers) != 9:
            remedy = "write [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
            if len(numbers) > 9:
                remedy = f"write decimals with a point, not a comma (240.5, not 240,5); {remedy}"
            raise entry.fault(matrix_key, f"must be 3x3 numbers, not {len(numbers)}", remedy)
        return matrix_key, rows_of(numbers, 3)
    if focal_key is None:
        remedy = "add the camera matrix, K: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], in pixels"
        raise Faulty(f"{entry.name} lacks K".lstrip(), entry.location, remedy)
    values = []
    for alternatives in (FOCAL_KEYS, _FOCAL_Y_KEYS, _CENTRE_X_KEYS, _CENTRE_Y_KEYS):
        key = entry.key(alternatives)
        if key is None:
            what = f"{entry.name} lacks {alternatives[0]}".lstrip()
            raise Faulty(what, entry.location, "give fx, fy, cx and cy, in pixels")
        numbers = numbers_of(entry, key)
        if len(numbers) != 1:
            raise entry.fault(key, "must be a number of pixels")
        values.append(numbers[0])
    fx, fy, cx, cy = values
    return focal_key, [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]


def _region_size(entry: Entry, K: Matrix, size: dict[str, int]) -> dict[str, int]:
    """The size of images that are a part of the sensor (ROS's region of interest); K is shifted in place to their corner."""
    roi = entry.value("roi")
    names = ("x_offset", "y_offset", "width", "height")
    if not isinstance(roi, dict) or not any(roi.get(name) for name in names):
        return size  # all zero: the whole sensor
    x, y, width, height = (roi.get(name, 0) for name in names)
    if not all(isinstance(value, int) and value >= 0 for value in (x, y, width, height)):
        raise entry.fault("roi", "must be a part of the picture, in whole pixels")
    if x + width > size["width"] or y + height > size["height"]:
        raise entry.fault("roi", f"reaches beyond the {size['width']}x{size['height']} pixels of the camera")
    # the principal point is counted from the corner of the region
    K[0][2] -= x
    K[1][2] -= y
    return {"width": width, "height": height}


def _distortion(entry: Entry) -> tuple[str, str, list[float] | None]:
    """The lens model, the key of the distortion, and its coefficients; None without any."""
    key = entry.key(_DISTORTION_KEYS)
    coefficients = None if key is None else _coefficients(entry, key)
    separate = _separate_coefficients(entry)
    if separate is not None and key is not None:
        raise entry.fault(key, f"and {separate[0]} are both given", "keep one of them")
    model = _lens_model(entry, key, len(coefficients or []))
    if separate is not None:
        key, by_name = separate
        coefficients, model = _in_order(entry, by_name, model)
    xi_key = entry.key(("xi",))
    if xi_key is not None:  # files of cv2.omnidir have xi in addition to k1 k2 p1 p2
        model = "omni"
        coefficients = numbers_of(entry, xi_key) + (coefficients or [])
    return model, key or "distortion", coefficients


def _coefficients(entry: Entry, key: str) -> list[float]:
    """The coefficients that a key has as a list or a matrix.  Raises Faulty."""
    value = entry[key]
    if not isinstance(value, list | dict):
        raise entry.fault(key, "must be a list of numbers")
    if value == []:
        return []
    return numbers_of(entry, key)


def _separate_coefficients(entry: Entry) -> tuple[str, dict[str, float]] | None:
    """Coefficients that have a key each, or one for the radial and one for the tangential ones; None without any."""
    by_name: dict[str, float] = {}
    first_key = ""
    for name in _COEFFICIENT_KEYS:
        key = entry.key((name,))
        if key is not None:
            numbers = numbers_of(entry, key)
            if len(numbers) != 1:
                raise entry.fault(key, "must be a number")
            by_name[name] = numbers[0]
            first_key = first_key or key
    for group, names in (("radial_distortion", ("k1", "k2", "k3")), ("tangential_distortion", ("p1", "p2"))):
        key = entry.key((group,))
        if key is not None:
            numbers = numbers_of(entry, key)
            if by_name.keys() & set(names) or len(numbers) > len(names):
                raise entry.fault(key, f"must be {', '.join(names)}, and stand alone")
            by_name |= dict(zip(names, numbers, strict=False))  # fewer than all: the others are 0
            first_key = first_key or key
    if not by_name:
        return None
    return first_key, by_name


def _in_order(entry: Entry, by_name: dict[str, float], model: str) -> tuple[list[float], str]:
    """Coefficients in the order of their model, and the model: rational if there are more than brown has."""
    names: tuple[str, ...]
    if model == "fisheye":
        names = _FISHEYE_COEFFICIENT_KEYS
    elif any(by_name.get(name) for name in ("k4", "k5", "k6")):
        if model not in {"brown", "rational"} or "k5" not in by_name:
            # k4 alone: the fourth of a fisheye, or of a longer polynomial, which OpenCV does not have
            remedy = "add distortion_model: fisheye, or give k1 to k6, p1 and p2 of a rational lens"
            raise entry.fault(entry.key(("k4", "k5", "k6")) or "k4", "does not say which lens model it is of", remedy)
        model = "rational"
        names = _COEFFICIENT_KEYS
    else:
        names = _COEFFICIENT_KEYS[:5]
    surplus = [name for name, value in by_name.items() if name not in names and value]
    if surplus:
        raise entry.fault(surplus[0], f"is no coefficient of a {model} lens", f"its coefficients are {', '.join(names)}")
    return [by_name.get(name, 0.0) for name in names], model


def _lens_model(entry: Entry, distortion_key: str | None, count: int) -> str:
    """Return the lens model that a file names, else the one that its flags, keys and number of coefficients imply."""
    stated: dict[str, str] = {}
    for name in _MODEL_KEYS:
        key = entry.key((name,))
        if key is not None:
            if not isinstance(entry[key], str):
                raise entry.fault(key, "must be a word")
            stated[key] = _wbflow_model(entry[key])
    projection_key = entry.key(("camera_model",))
    if projection_key in stated and stated[projection_key] == "pinhole":
        # the projection is meant, which any distortion model can follow
        del stated[projection_key]
    # several keys may name the model, as long as they agree
    first, *others = [*stated] or [""]
    for other in others:
        if stated[other] != stated[first]:
            raise entry.fault(other, f"is {entry[other]}, but {first} is {entry[first]}", "keep the right one of them")
    flags = text_of(entry.value("flags")).lower()
    is_fisheye = bool(entry.value("fisheye_model", "is_fisheye", "fisheye")) or "fisheye" in flags
    model = stated.get(first, "")
    if not model:
        model = "fisheye" if is_fisheye else "brown"
    # OpenCV and ROS give no other name to a lens with a denominator; in wbflow's own files, such a lens may be called brown
    is_own = first == "model" or (not stated and distortion_key == "distortion")
    if model == "brown" and count >= 8 and not is_own:
        return "rational"
    return model


def _wbflow_model(name: str) -> str:
    """wbflow's name of a lens model."""
    known = MODEL_NAMES.get(name.lower().replace("-", "_").replace(" ", "_").removeprefix("distortion."))
    return known or name.lower().replace("_", "-")

"""Calibration files of OpenCV and ROS: one camera each, with K and D under one of several names.

References
----------
OpenCV: samples/cpp/tutorial_code/calib3d/camera_calibration; cv::FileStorage; opencv_contrib, ccalib/samples/omni_calibration
ROS: sensor_msgs/CameraInfo, camera_calibration_parsers; REP 104 (regions of interest)
"""

from __future__ import annotations

from typing import Any

from .calibrated import Calibrated, Faulty, Matrix, calibrated
from .values import MODEL_NAMES, first_key, numbers_of, rows_of, size_of, text_of

MATRIX_KEYS = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix", "mtx", "K", "k")
_DIST_KEYS = ("distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "distCoeffs", "dist", "distortion", "D", "d")
_MODEL_KEYS = ("distortion_model", "camera_model", "model")


def read_camera(data: dict[str, Any]) -> Calibrated:
    """The one camera of a file.  Raises Faulty if something in it cannot be used."""
    key, distortion_key, xi_key = first_key(data, MATRIX_KEYS), first_key(data, _DIST_KEYS), first_key(data, ("xi", "Xi"))
    assert key
    if distortion_key is None:
        raise Faulty(f"lacks the distortion ({', '.join(_DIST_KEYS[:3])} or D)", (), "add it; zeros where there is none")
    K, distortion = rows_of(numbers_of(data[key], key), 3), numbers_of(data[distortion_key], distortion_key)
    model = _lens_model(data, len(distortion))
    if xi_key is not None:  # files of cv2.omnidir have xi in addition to k1 k2 p1 p2
        model, distortion = "omni", numbers_of(data[xi_key], xi_key) + distortion
    size = _region_size(data, K, size_of(data))
    return calibrated({"K": K, **size, "distortion": distortion, "model": model}, {"K": key, "distortion": distortion_key})


def _region_size(data: dict[str, Any], K: Matrix, size: dict[str, int]) -> dict[str, int]:
    """The size of images that are a part of the sensor (ROS's region of interest); K is shifted in place to their corner."""
    roi = data.get("roi")
    names = ("x_offset", "y_offset", "width", "height")
    if not isinstance(roi, dict) or not any(roi.get(name) for name in names):
        return size  # all zero: the whole sensor
    x, y, width, height = (roi.get(name, 0) for name in names)
    if not all(isinstance(value, int) and value >= 0 for value in (x, y, width, height)):
        raise Faulty("roi must be a part of the picture, in whole pixels", ("roi",))
    if x + width > size["width"] or y + height > size["height"]:
        raise Faulty(f"roi reaches beyond the {size['width']}x{size['height']} pixels of the camera", ("roi",))
    K[0][2] -= x
    K[1][2] -= y
    return {"width": width, "height": height}


def _lens_model(data: dict[str, Any], count: int) -> str:
    """Return the lens model that a file names, else the one that its flags and number of coefficients imply."""
    key = first_key(data, _MODEL_KEYS)
    model_name = text_of(data.get(key, "")).lower().replace("-", "_") if key else ""
    fisheye = data.get("fisheye_model") or "fisheye" in text_of(data.get("flags")).lower()
    model = MODEL_NAMES.get(model_name, model_name.replace("_", "-")) or ("fisheye" if fisheye else "brown")
    return "rational" if model == "brown" and count >= 8 else model

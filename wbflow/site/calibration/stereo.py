"""Stereo calibrations of OpenCV: two lenses, and the pose of the second camera relative to the first.

References
----------
OpenCV: samples/cpp/stereo_calib.cpp (intrinsics.yml and extrinsics.yml); cv::stereoCalibrate
"""

from __future__ import annotations

import math
from typing import Any

from .calibrated import Calibrated
from .camera_entry import UNIT_KEYS, read_camera
from .entry import Entry, plain

_LENS_KEYS = {
    "camera_matrix": ("M{}", "K{}", "camera_matrix_{}", "cam_matrix_{}", "mtx{}", "A{}"),
    "distortion_coefficients": ("D{}", "dist_coeffs_{}", "distortion_coefficients_{}", "dist{}"),
}
"""The keys of each camera, with its number in place of the braces."""
_RECTIFICATION = ("R1", "R2", "P1", "P2", "Q", "E", "F", "roi1", "roi2", "valid_roi1", "valid_roi2")
"""Rectifications, and matrices that follow from the poses."""
_NAMES = ("left", "right")
_REMEDY = "leave it out; a stereo file holds M1, D1, M2, D2, R, T, image_width and image_height"


def is_stereo(data: dict[str, Any]) -> bool:
    """Does a file hold the two lenses of a stereo calibration?"""
    entry = Entry(data)
    return all(entry.has(*_names("camera_matrix", number)) for number in (1, 2))


def read_stereo(data: dict[str, Any]) -> dict[str, Calibrated]:
    """The cameras `left` and `right`; the axes of the left one become the world's (x_right = R x_left + T).

    Without R and T, only the lenses are known.  OpenCV gives T in the unit of the board's squares, and does not write which: it
    is taken as metres, which is doubted unless somebody has added `unit: m`.  Raises Faulty.
    """
    whole = Entry(data)
    unit_key = whole.key(UNIT_KEYS)
    cameras: dict[str, Calibrated] = {}
    # the file has one size for both cameras, and one pose: the right camera's
    size = {}
    pose = {}
    for key, value in data.items():
        if plain(str(key)) in _SIZE_KEYS:
            size[key] = value
        elif key in {"R", "T", "t"}:
            pose[key] = value
    for number, name in enumerate(_NAMES, 1):
        own = {}
        for lens_key in _LENS_KEYS:
            key_in_file = whole.key(_names(lens_key, number))
            if key_in_file is not None:
                own[lens_key] = whole[key_in_file]
        own |= size
        if number == 2:
            own |= pose
            if unit_key is not None:
                own[unit_key] = whole[unit_key]
        elif "R" in pose:  # the left camera is the world's origin
            own |= {"R": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "C": [0.0, 0.0, 0.0]}
        cameras[name] = read_camera(Entry(own, (), name), needs_distortion=True)
    whole.ignore(*size, *pose, *_RECTIFICATION)
    whole.finish((), _REMEDY)
    right = cameras["right"]
    if right.C is not None and unit_key is None:
        doubt = f"T of a stereo calibration has no unit: {math.hypot(*right.C):g} is taken as the metres between the two cameras"
        cameras["right"] = right.model_copy(update={"doubt": doubt})
    return cameras


_SIZE_KEYS = {plain(key) for key in ("image_width", "image_height", "width", "height", "image_size", "img_size", "size")}


def _names(lens_key: str, number: int) -> tuple[str, ...]:
    return tuple(name.format(number) for name in _LENS_KEYS[lens_key])

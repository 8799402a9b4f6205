"""Cameras of radiance fields: `transforms.json` of NeRF, instant-ngp and nerfstudio, and `cameras.json` of Gaussian splatting.

References
----------
docs.nerf.studio/quickstart/data_conventions.html; github.com/NVlabs/instant-ngp, docs/nerf_dataset_tips.md
github.com/graphdeco-inria/gaussian-splatting, utils/camera_utils.py (camera_to_JSON)
"""

from __future__ import annotations

import math
from typing import Any

from .calibrated import Calibrated, Faulty, calibrated, rotation_fault
from .camera_entry import read_camera
from .entry import Entry
from .pose import turned_axes
from .values import numbers_of, rows_of, text_of

_IRRELEVANT_KEYS = (
    # how a trainer places and splits the scene; the matrices in the file are not changed by it
    *("aabb_scale", "scale", "offset", "applied_transform", "orientation_override", "ply_file_path", "from_na", "up"),
    *("train_filenames", "val_filenames", "test_filenames", "enable_depth_loading", "integer_depth_scale"),
    # of a frame
    *("sharpness", "colmap_im_id", "mask_path", "depth_file_path", "depth_path", "semantic_path", "normal_path", "time"),
)
_LENS_KEYS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2", "camera_model", "is_fisheye")
_REMEDY = "leave it out, if the cameras do not depend on it; see sites/README.md for what is read"
_SPLATTING_KEYS = {"img_name", "position", "rotation", "fx", "fy", "width", "height"}


def is_transforms(data: dict[str, Any]) -> bool:
    """Is this the content of a transforms.json?"""
    frames = data.get("frames")
    return isinstance(frames, list) and any(isinstance(frame, dict) and "transform_matrix" in frame for frame in frames)


def read_transforms(data: dict[str, Any]) -> dict[str, Calibrated]:
    """Cameras by file name.

    The matrices are camera to world, with the axes of OpenGL: x right, y up, z backward.  The origin of pixels is the corner of
    the first one, as in COLMAP.  Lengths are taken for metres, as in all calibrations.  Raises Faulty.
    """
    whole = Entry(data)
    scale = whole.value("applied_scale")
    if scale not in (None, 1, 1.0):
        raise whole.fault("applied_scale", f"is {scale}: lengths are no metres", "divide the translations by it, and remove it")
    # what all frames have in common stands beside them; a frame's own value takes precedence
    shared = {key: value for key, value in data.items() if key in _LENS_KEYS or key.startswith("camera_angle_")}
    whole.ignore(*shared, "frames", *_IRRELEVANT_KEYS)
    whole.finish(_LENS_KEYS, _REMEDY)
    cameras: dict[str, Calibrated] = {}
    for number, frame in enumerate(data["frames"]):
        location = ("frames", number)
        if not isinstance(frame, dict):
            raise Faulty(f"frames.{number} must hold file_path and transform_matrix", location)
        name = text_of(frame.get("file_path")).replace("\\", "/").removeprefix("./")
        if not name or name in cameras:
            what = f"frames.{number} has {'the same file_path as another' if name else 'no file_path'}"
            raise Faulty(what, location, "give the name of its picture")
        own = {**shared, **frame}
        del own["file_path"]
        values = _with_focal_lengths(own, location, name)
        if "transform_matrix" in values:
            values["convention"] = "opengl"
        entry = Entry(values, location, name)
        entry.ignore(*_IRRELEVANT_KEYS)
        cameras[name] = read_camera(entry)
    return cameras


def _with_focal_lengths(values: dict[str, Any], location: tuple[str | int, ...], name: str) -> dict[str, Any]:
    """The keys of a frame with fl_x, fl_y, cx and cy in wbflow's pixels, from what of them or of the field of view is given."""
    entry = Entry(values, location, name)
    angles = {axis: entry.value(f"camera_angle_{axis}") for axis in "xy"}
    completed = {key: value for key, value in values.items() if not key.startswith("camera_angle_")}
    for axis, size_key in (("x", "w"), ("y", "h")):
        size = _number(entry, size_key)
        if size is None:
            raise Faulty(f"{name} lacks the size of the pictures", location, "add w and h, in pixels")
        centre = _number(entry, f"c{axis}")
        if centre is None:
            centre = size / 2
        # the origin is the corner of the first pixel, wbflow's is its middle
        completed[f"c{axis}"] = centre - 0.5
        if _number(entry, f"fl_{axis}") is None and angles[axis] is not None:
            angle = _number(entry, f"camera_angle_{axis}")
            if angle is None or not 0 < angle < math.pi:
                raise entry.fault(f"camera_angle_{axis}", "must be an angle in radians, between 0 and 3.14")
            completed[f"fl_{axis}"] = size / (2 * math.tan(angle / 2))
    if completed.get("fl_y") is None and completed.get("fl_x") is not None:
        completed["fl_y"] = completed["fl_x"]  # square pixels, as these programs take it
    return completed


def _number(entry: Entry, key: str) -> float | None:
    """The number of a key; None if there is none.  Raises Faulty for anything else than a number."""
    if entry.value(key) is None:
        return None
    numbers = numbers_of(entry, key)
    if len(numbers) != 1:
        raise entry.fault(key, "must be a number")
    return float(numbers[0])


def is_splatting(entries: list[Any]) -> bool:
    """Is this the content of Gaussian splatting's cameras.json?"""
    return bool(entries) and all(isinstance(entry, dict) and entry.keys() >= _SPLATTING_KEYS for entry in entries)


def read_splatting(entries: list[dict[str, Any]]) -> dict[str, Calibrated]:
    """Cameras by image name: the centre, and the camera's axes as columns (x right, y down, z forward).  Raises Faulty.

    These pinholes have no principal point of their own: it is the middle of the picture.
    """
    cameras: dict[str, Calibrated] = {}
    for number, data in enumerate(entries):
        name = str(data["img_name"])
        entry = Entry(data, (number,), name)
        numbers = numbers_of(entry, "rotation")
        rotation = rows_of(numbers, 3)
        if len(numbers) != 9:
            raise entry.fault("rotation", "must be 3x3 numbers")
        fault = rotation_fault(rotation)
        if fault:
            raise entry.fault("rotation", fault)
        width = _number(entry, "width")
        height = _number(entry, "height")
        fx = _number(entry, "fx")
        fy = _number(entry, "fy")
        if width is None or height is None or fx is None or fy is None or name in cameras:
            raise Faulty(f"{name} must have width, height, fx, fy, and a name of its own", (number,))
        fields = {
            "K": [[fx, 0.0, width / 2 - 0.5], [0.0, fy, height / 2 - 0.5], [0.0, 0.0, 1.0]],
            "width": int(width),
            "height": int(height),
            "R": turned_axes(rotation, 1.0),
            "C": numbers_of(entry, "position"),
        }
        entry.ignore(*_SPLATTING_KEYS)
        entry.finish(_SPLATTING_KEYS, _REMEDY)
        cameras[name] = calibrated(fields, location=(number,))
    return cameras

"""Kalibr's camera chains (camchain.yaml).

References
----------
github.com/ethz-asl/kalibr/wiki/yaml-formats, wiki/supported-models
"""

from __future__ import annotations

from typing import Any

from .calibrated import Calibrated, Faulty, Matrix, Vector, calibrated, centre, product, turned
from .entry import Entry
from .pose import rigid_matrix
from .values import MODEL_NAMES, numbers_of, size_of, text_of

_PROJECTIONS = {"pinhole": ("", 0), "omni": ("omni", 1), "eucm": ("eucm", 2), "ds": ("double-sphere", 2)}
"""By Kalibr's projection: our lens model ("": see the distortion model), and the number of intrinsics before fu, fv, pu, pv."""
_IRRELEVANT = ("cam_overlaps", "timeshift_cam_imu", "T_cam_imu")
"""Which cameras see the same, and where and when an inertial sensor is: nothing about the cameras among themselves."""
_REMEDY = (
    "leave it out; keys of a camera are camera_model, intrinsics, distortion_model, distortion_coeffs, resolution, T_cn_cnm1"
)


def is_chain(data: dict[str, Any]) -> bool:
    """Is this the content of a camchain file?"""
    for entry in data.values():
        if isinstance(entry, dict) and "camera_model" in entry and "intrinsics" in entry:
            return True
    return False


def read_chain(data: dict[str, Any]) -> dict[str, Calibrated]:
    """A chain of cameras: each has a pose relative to the one before it, so the first camera's axes become the world's.

    A camera with a `rostopic` is in the result twice, as the topic's name is often what a site calls it.
    """
    cameras: dict[str, Calibrated] = {}
    R: Matrix | None = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    t = [0.0, 0.0, 0.0]
    for name, value in data.items():
        if not isinstance(value, dict):
            raise Faulty(f"{name} is no camera of a chain", (name,), "leave it out")
        entry = Entry(value, (name,), str(name))
        is_first = not cameras
        if is_first and entry.has("T_cn_cnm1"):
            raise entry.fault("T_cn_cnm1", "is relative to a camera before the first", "give the whole chain, or leave it out")
        if not is_first and R is not None:
            R, t = _next_pose(entry, R, t)
        pose = {}
        if R and len(data) > 1:  # a single camera has no pose
            pose = {"R": R, "C": centre(R, t)}
        topic = text_of(entry.value("rostopic")).strip("/")
        camera = _camera(entry, pose)
        cameras[str(name)] = camera
        if topic:
            cameras[topic] = camera
    return cameras


def _next_pose(entry: Entry, R: Matrix, t: Vector) -> tuple[Matrix | None, Vector]:
    """The pose of a camera, x = R X + t, from the pose of the one before it; R is None if the file lacks it."""
    if entry.value("T_cn_cnm1") is None:
        if entry.has("T_cam_imu"):
            what = "is given without T_cn_cnm1, so the poses of the cameras among themselves are not stated"
            raise entry.fault("T_cam_imu", what, "give the camchain with T_cn_cnm1, or leave T_cam_imu out")
        return None, t
    rotation, translation = rigid_matrix(entry, "T_cn_cnm1")
    # x_n = rotation (R X + t) + translation
    moved = [a + b for a, b in zip(turned(rotation, t), translation, strict=True)]
    return product(rotation, R), moved


def _camera(entry: Entry, pose: dict[str, Any]) -> Calibrated:
    """A camera of a chain.  pose: its R and C, if known.  Raises Faulty."""
    # 1. projection and intrinsics
    projection = text_of(entry.value("camera_model")).lower()
    if projection not in _PROJECTIONS:
        raise entry.fault("camera_model", f"must be one of {', '.join(_PROJECTIONS)}")
    lens_model, offset = _PROJECTIONS[projection]
    intrinsics: list[float] = []
    intrinsics_key = entry.key(("intrinsics",))
    if intrinsics_key is not None:
        intrinsics = numbers_of(entry, intrinsics_key)
    if len(intrinsics) != offset + 4:
        raise entry.fault("intrinsics", f"of a {projection} camera has {offset + 4} numbers, not {len(intrinsics)}")
    # 2. distortion
    distortion_type = text_of(entry.value("distortion_model")).lower() or "none"
    coefficients_key = entry.key(("distortion_coeffs",))
    distortion = []
    if distortion_type != "none" and coefficients_key is not None and entry[coefficients_key] != []:
        distortion = numbers_of(entry, coefficients_key)
    model = "brown"
    if distortion_type != "none":
        model = MODEL_NAMES.get(distortion_type, distortion_type)
    if lens_model:
        # of the projections other than the pinhole, only the omnidirectional one has a distortion that is known here
        if model != "brown" or (lens_model != "omni" and any(distortion)):
            what = f"{entry.name}: {projection} with {distortion_type} distortion is not known"
            remedy = f"calibrate with {projection}-{'radtan' if lens_model == 'omni' else 'none'}"
            raise Faulty(what, (*entry.location, "distortion_model"), remedy)
        model = lens_model
        if lens_model == "omni":
            distortion = [*distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
        else:
            distortion = []  # zeros, which these models have no place for
        # the parameters of the projection come first
        distortion = [*intrinsics[:offset], *distortion]
    # 3. the camera
    fx, fy, cx, cy = intrinsics[offset:]
    K = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    fields = {"K": K, **size_of(entry), "distortion": distortion, "model": model, **pose}
    entry.ignore(*_IRRELEVANT)
    entry.finish(("camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "resolution", "T_cn_cnm1"), _REMEDY)
    return calibrated(fields, {"K": "intrinsics", "distortion": "distortion_coeffs"}, entry.location)

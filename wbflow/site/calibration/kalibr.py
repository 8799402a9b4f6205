"""Kalibr's camera chains (camchain.yaml).

References
----------
github.com/ethz-asl/kalibr/wiki/yaml-formats, wiki/supported-models
"""

from __future__ import annotations

from typing import Any

from .calibrated import Calibrated, Faulty, Matrix, calibrated, centre, product, rotation_fault
from .values import MODEL_NAMES, numbers_of, rows_of, size_of, text_of

_PROJECTIONS = {"pinhole": ("", 0), "omni": ("omni", 1), "eucm": ("eucm", 2), "ds": ("double-sphere", 2)}
"""By Kalibr's projection: our lens model ("": see the distortion model), and the number of intrinsics before fu, fv, pu, pv."""


def read_chain(data: dict[str, Any]) -> dict[str, Calibrated]:
    """A chain of cameras: each has a pose relative to the one before it, so the first camera's axes become the world's."""
    cameras: dict[str, Calibrated] = {}
    R: Matrix | None = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    t = [0.0, 0.0, 0.0]
    for k, (name, entry) in enumerate(data.items()):
        if not isinstance(entry, dict):
            continue
        if k and R is not None:
            R, t = _next_pose(name, entry, R, t)
        pose = {"R": R, "C": centre(R, t)} if R and len(data) > 1 else {}
        cameras[str(name)] = camera = _camera(str(name), entry, pose)
        if topic := text_of(entry.get("rostopic")).strip("/"):
            cameras[topic] = camera
    return cameras


def _next_pose(name: str, entry: dict[str, Any], R: Matrix, t: list[float]) -> tuple[Matrix | None, list[float]]:
    """The pose of a camera, x = R X + t, from the pose of the one before it; R is None if the file lacks it."""
    if "T_cn_cnm1" not in entry:
        return None, t
    T = rows_of(numbers_of(entry["T_cn_cnm1"], "T_cn_cnm1", (name,)), 4)
    rotation = [row[:3] for row in T[:3]]
    if [*map(len, T)] != [4] * 4 or rotation_fault(rotation):
        raise Faulty(f"{name}.T_cn_cnm1 must be 4x4: a rotation and a translation", (name, "T_cn_cnm1"))
    return product(rotation, R), [sum(row[k] * t[k] for k in range(3)) + row[3] for row in T[:3]]


def _camera(name: str, entry: dict[str, Any], pose: dict[str, Any]) -> Calibrated:
    projection = text_of(entry.get("camera_model")).lower()
    if projection not in _PROJECTIONS:
        raise Faulty(f"{name}.camera_model must be one of {', '.join(_PROJECTIONS)}", (name, "camera_model"))
    lens_model, offset = _PROJECTIONS[projection]
    intrinsics = numbers_of(entry.get("intrinsics"), "intrinsics", (name,))
    if len(intrinsics) != offset + 4:
        what = f"{name}.intrinsics of a {projection} camera has {offset + 4} numbers, not {len(intrinsics)}"
        raise Faulty(what, (name, "intrinsics"))
    distortion_type = text_of(entry.get("distortion_model")).lower() or "none"
    distortion = [] if distortion_type == "none" else numbers_of(entry.get("distortion_coeffs", []), "distortion_coeffs", (name,))
    model = "brown" if distortion_type == "none" else MODEL_NAMES.get(distortion_type, distortion_type)
    if lens_model:
        if model != "brown" or (lens_model != "omni" and any(distortion)):
            what = f"{name}: {projection} with {distortion_type} distortion is not known"
            remedy = f"calibrate with {projection}-{'radtan' if lens_model == 'omni' else 'none'}"
            raise Faulty(what, (name, "distortion_model"), remedy)
        model = lens_model
        distortion = [*intrinsics[:offset], *([*distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5] if lens_model == "omni" else [])]
    fx, fy, cx, cy = intrinsics[offset:]
    K = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    fields = {"K": K, **size_of(entry, (name,)), "distortion": distortion, "model": model, **pose}
    return calibrated(fields, {"K": "intrinsics", "distortion": "distortion_coeffs"}, (name,))

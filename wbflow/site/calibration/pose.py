"""The pose of a camera, from any of the forms in which programs write it.

All become R and C of x ~ K R (X - C): world axes to camera axes (x right, y down, z forward), and the camera's centre.
"""

from __future__ import annotations

import math
from typing import Any

from .calibrated import Faulty, Matrix, Vector, centre, quaternion_rotation, rotation_fault
from .entry import Entry
from .values import numbers_of, rows_of, text_of

_ROTATION_KEYS = ("R", "rotation_matrix", "rmat")
_VECTOR_KEYS = ("rvec", "rotation_vector")
_TRANSLATION_KEYS = ("t", "T", "tvec", "translation_vector")
_CENTRE_KEYS = ("C", "position", "camera_center", "camera_centre", "camera_position")
_WORLD_TO_CAMERA_KEYS = ("w2c", "world_to_camera", "world2camera", "world2cam", "world_to_cam", "T_cam_world", "cam_from_world")
_CAMERA_TO_WORLD_KEYS = (
    *("c2w", "camera_to_world", "camera2world", "cam2world", "cam_to_world", "T_world_cam", "world_from_cam"),
    "transform_matrix",  # NeRF's files have it; there the convention is known (nerf.py)
)
_AMBIGUOUS_KEYS = (
    "rotation",
    "translation",
    "extrinsic",
    "extrinsics",
    "extrinsic_matrix",
    "pose",
    "transform",
    "orientation",
    "quaternion",
    "quat",
    "q",
    "P",
)
"""Keys that programs use for either direction, for either convention, or for numbers in either order."""
_CONVENTION_KEYS = ("convention", "camera_convention")
_CONVENTIONS = {"opencv": 1.0, "opengl": -1.0}
"""By the convention of a camera's axes: the sign of its y and z axes relative to OpenCV's (x right, y down, z forward)."""

POSE_KEYS = (*_ROTATION_KEYS, *_VECTOR_KEYS, "qvec", *_TRANSLATION_KEYS, *_CENTRE_KEYS, "w2c", "c2w", "convention")
_WHAT_TO_WRITE = (
    "write what it is: R and t (x = R X + t), R and C (the camera's centre), rvec and tvec, w2c (4x4, world to camera), or c2w "
    "(4x4, camera to world) with convention: opencv (x right, y down, z forward) or opengl (x right, y up, z backward)"
)
_SAME_PLACE = 1e-3
"""Largest distance between two centres that are given for one camera and still agree, metres."""


def pose_of(entry: Entry) -> dict[str, Any]:
    """R (3x3) and C (3 numbers) of a camera as far as its entry has them.

    Raises Faulty for a pose that is incomplete, contradicts itself, or can be understood in more than one way.
    """
    for name in _AMBIGUOUS_KEYS:
        key = entry.key((name,))
        if key is not None:
            raise entry.fault(key, "can be understood in more than one way", _WHAT_TO_WRITE)
    from_matrix = _from_matrix(entry)
    from_rotation = _from_rotation(entry)
    if from_matrix and from_rotation:
        raise Faulty(f"{entry.name} states its pose twice".lstrip(), entry.location, "keep one of the two")
    return from_matrix or from_rotation


def _from_matrix(entry: Entry) -> dict[str, Any]:
    """The pose from a 4x4 (or 3x4) matrix of either direction; {} if the entry has none."""
    convention_key = entry.key(_CONVENTION_KEYS)
    to_camera = entry.key(_WORLD_TO_CAMERA_KEYS)
    to_world = entry.key(_CAMERA_TO_WORLD_KEYS)
    if to_camera is None and to_world is None:
        if convention_key is not None:
            raise entry.fault(convention_key, "is of no matrix: there is neither w2c nor c2w", _WHAT_TO_WRITE)
        return {}
    if to_camera is not None and to_world is not None:
        raise Faulty(f"{entry.name} states its pose twice".lstrip(), entry.location, "keep one of the two")
    sign = 1.0
    if convention_key is not None:
        convention = text_of(entry[convention_key]).lower()
        if convention not in _CONVENTIONS:
            raise entry.fault(convention_key, "is not known", f"write one of {', '.join(_CONVENTIONS)}")
        sign = _CONVENTIONS[convention]
    if to_camera is not None:
        rotation, translation = rigid_matrix(entry, to_camera)
        # the rows of the rotation are the camera's axes
        R = [rotation[0], [sign * v for v in rotation[1]], [sign * v for v in rotation[2]]]
        t = [translation[0], sign * translation[1], sign * translation[2]]
        return {"R": R, "C": centre(R, t)}
    assert to_world is not None
    # both conventions are frequent in this direction, and the wrong one would turn all cameras round
    if convention_key is None:
        raise entry.fault(to_world, "does not say which way the camera's axes point", _WHAT_TO_WRITE)
    rotation, position = rigid_matrix(entry, to_world)
    return {"R": turned_axes(rotation, sign), "C": position}


def turned_axes(rotation: Matrix, sign: float) -> Matrix:
    """R from the rotation of a camera-to-world matrix, whose columns are the camera's axes.  sign: of its y and z axes."""
    x_axis, y_axis, z_axis = zip(*rotation, strict=True)
    return [list(x_axis), [sign * v for v in y_axis], [sign * v for v in z_axis]]


def rigid_matrix(entry: Entry, key: str) -> tuple[Matrix, Vector]:
    """The rotation (3x3) and translation of a 4x4 or 3x4 matrix.  Raises Faulty if it is none of a rigid motion."""
    numbers = numbers_of(entry, key)
    rows = rows_of(numbers, 4)
    if len(numbers) not in {12, 16} or (len(numbers) == 16 and rows[3] != [0, 0, 0, 1]):
        raise entry.fault(key, "must be 4x4: a rotation and a translation, and 0 0 0 1 below", _WHAT_TO_WRITE)
    rotation = [row[:3] for row in rows[:3]]
    fault = rotation_fault(rotation)
    if fault:
        raise entry.fault(key, f"does not begin with a rotation: it {fault}", _WHAT_TO_WRITE)
    return rotation, [row[3] for row in rows[:3]]


def _from_rotation(entry: Entry) -> dict[str, Any]:
    """The pose from a rotation, and a translation or a centre; {} if the entry has none of them."""
    R = _rotation(entry)
    C = _vector(entry, _CENTRE_KEYS)
    translation_key = entry.key(_TRANSLATION_KEYS)
    if translation_key is not None:
        t = _vector(entry, _TRANSLATION_KEYS)
        if R is None or t is None:
            raise entry.fault(translation_key, "needs a rotation: C = -R^T t", _WHAT_TO_WRITE)
        try:
            from_translation = centre(R, t)
        except (TypeError, IndexError):
            raise entry.fault(translation_key, "needs a rotation of 3x3 numbers", _WHAT_TO_WRITE) from None
        # files of some programs have both; then they must agree
        if C is not None and not math.dist(C, from_translation) <= _SAME_PLACE:
            what = f"contradicts the centre: -R^T t is {_shown(from_translation)}, not {_shown(C)}"
            raise entry.fault(translation_key, what, "keep the right one of them")
        if C is None:
            C = from_translation
    pose: dict[str, Any] = {}
    if R is not None:
        pose["R"] = R
    if C is not None:
        pose["C"] = C
    return pose


def _rotation(entry: Entry) -> Matrix | None:
    """The rotation of an entry as a matrix, a rotation vector (axis times angle in radians) or COLMAP's quaternion."""
    matrix_key = entry.key(_ROTATION_KEYS)
    vector_key = entry.key(_VECTOR_KEYS)
    quaternion_key = entry.key(("qvec",))
    stated = [key for key in (matrix_key, vector_key, quaternion_key) if key is not None]
    if len(stated) > 1:
        raise entry.fault(stated[1], f"and {stated[0]} are both given", "keep one of them")
    if matrix_key is not None:
        numbers = numbers_of(entry, matrix_key)
        if len(numbers) != 9:
            raise entry.fault(matrix_key, "must be 3x3 numbers")
        R = rows_of(numbers, 3)
        fault = rotation_fault(R)
        if fault:
            raise entry.fault(matrix_key, fault)
        return R
    if vector_key is not None:
        vector = _vector(entry, _VECTOR_KEYS)
        assert vector is not None
        if math.hypot(*vector) > 2 * math.pi:
            what = f"turns by {math.hypot(*vector):.1f} rad, more than a full turn, as degrees would"
            raise entry.fault(vector_key, what, "give it in radians: the axis times the angle, as cv2.Rodrigues does")
        return _rotation_of_vector(vector)
    if quaternion_key is not None:
        quaternion = numbers_of(entry, quaternion_key)
        if len(quaternion) != 4:
            raise entry.fault(quaternion_key, "must be 4 numbers: w, x, y, z, as COLMAP writes them")
        try:
            return quaternion_rotation(quaternion)
        except ValueError as error:
            raise entry.fault(quaternion_key, f"is not a rotation: {error}") from None
    return None


def _vector(entry: Entry, names: tuple[str, ...]) -> Vector | None:
    """The three numbers of the key that is one of these names; None if there is none.  Raises Faulty."""
    key = entry.key(names)
    if key is None:
        return None
    numbers = numbers_of(entry, key)
    if len(numbers) != 3 or not all(math.isfinite(number) for number in numbers):
        raise entry.fault(key, "must be 3 numbers")
    return numbers


def _rotation_of_vector(vector: Vector) -> Matrix:
    """The rotation about an axis by its length in radians (Rodrigues' formula: R = I + sin a [k] + (1 - cos a) [k]^2)."""
    angle = math.hypot(*vector)
    if angle < 1e-12:  # it has no axis
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    x, y, z = (component / angle for component in vector)
    c = math.cos(angle)
    s = math.sin(angle)
    v = 1 - c
    return [
        [c + x * x * v, x * y * v - z * s, x * z * v + y * s],
        [y * x * v + z * s, c + y * y * v, y * z * v - x * s],
        [z * x * v - y * s, z * y * v + x * s, c + z * z * v],
    ]


def _shown(point: Vector) -> str:
    return f"[{', '.join(f'{value:.3f}' for value in point)}]"

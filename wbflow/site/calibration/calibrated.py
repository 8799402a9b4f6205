"""A camera's lens and placement, and the checks that all calibrations pass, whichever program wrote them.

Rotations, in whatever form they are given, become R: world axes (z up) to camera axes (x right, y down, z forward).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationError, ValidationInfo, field_validator

from wbflow_stages.contracts import stated
from wbflow_stages.contracts.stated import LensModel

from ...errors import Location

Vector = list[float]
Matrix = list[Vector]

Lens = stated.Lens[Matrix, Vector]
Placement = stated.Placement[Matrix, Vector]

_MOST_MAGNITUDE = 1e12
"""Limit on the magnitude of any number in a calibration (metres, pixels): larger ones, and NaN, are refused."""
_MOST_PIXELS_A_SIDE = 1_000_000
"""Largest width or height of an image in a calibration."""


def lens_fault(model: str, distortion: list[float] | None) -> str:
    """What is wrong with the model or coefficients of a lens, and how to fix it; "" if nothing is."""
    if model not in tuple(LensModel):
        return f"{model!r} is not a known lens model; use one of {', '.join(LensModel)}"
    known = LensModel(model)
    count = len(distortion or [])
    states_zeros = known.counts == (0,) and not any(distortion or [])  # some programs write zeros for a pinhole
    if count in known.counts or states_zeros:
        return ""
    expected = f"{' or '.join(map(str, known.counts))} coefficients"
    if known.order:
        expected += f" ({known.order})"
    return f"a {model} lens has {expected}, not {count}; give them in that order, or another model"


def _check_number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < _MOST_MAGNITUDE:  # or NaN
        raise ValueError
    return value


Number = Annotated[float, PlainValidator(_check_number)]
"""A number kept as it is written (int or float), so that digests computed from it do not change."""
Vector3 = Annotated[list[Number], Field(min_length=3, max_length=3)]
Matrix3 = Annotated[list[Vector3], Field(min_length=3, max_length=3)]
Pixels = Annotated[int, Field(gt=0, le=_MOST_PIXELS_A_SIDE)]
Sigma = Annotated[Number, Field(ge=0)]

_REQUIREMENTS = {
    "K": "must be 3x3 numbers",
    "R": "must be 3x3 numbers",
    "C": "must be 3 numbers",
    "width": "must be a positive whole number of pixels",
    "height": "must be a positive whole number of pixels",
    "distortion": "must be a list of numbers",
    "model": "must be a word",
    "position_sigma_m": "must be a number, 0 or more",
    "rotation_sigma_deg": "must be a number, 0 or more",
}
"""The requirement on each field of `Calibrated`, for error messages."""


class Calibrated(BaseModel):
    """A camera in wbflow's own form, as in cameras.json; files of other programs are converted to it.

    Pixel centres have integer coordinates.
    """

    model_config = ConfigDict(strict=True, frozen=True, defer_build=True)

    K: Matrix3
    width: Pixels
    height: Pixels
    model: str = "brown"
    distortion: Annotated[list[Number] | None, Field(validate_default=True)] = None
    R: Matrix3 | None = None
    C: Vector3 | None = None
    position_sigma_m: Sigma | None = None
    rotation_sigma_deg: Sigma | None = None
    metric: Any = True
    doubt: str = ""
    """What a person should confirm about the pose, which the file leaves open; "" if nothing."""

    @field_validator("K")
    @classmethod
    def _check_camera_matrix(cls, K: Matrix) -> Matrix:
        if K[0][2] == 0 == K[1][2] and K[2][0] > 0 and K[2][1] > 0:
            raise ValueError("must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]]; this is transposed, as MATLAB writes it")
        if K[0][0] <= 0 or K[1][1] <= 0 or K[2] != [0, 0, 1]:
            raise ValueError("must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths")
        return K

    @field_validator("R")
    @classmethod
    def _check_rotation(cls, R: Matrix | None) -> Matrix | None:
        fault = rotation_fault(R) if R else ""
        if fault:
            raise ValueError(fault)
        return R

    @field_validator("distortion")
    @classmethod
    def _check_distortion(cls, distortion: list[float] | None, info: ValidationInfo) -> list[float] | None:
        if "model" not in info.data:
            return distortion  # the model has a fault of its own
        fault = lens_fault(info.data["model"], distortion)
        if fault:
            raise ValueError(f"does not fit: {fault}")
        return distortion

    @field_validator("position_sigma_m", "rotation_sigma_deg")
    @classmethod
    def _check_sigma(cls, sigma: float | None, info: ValidationInfo) -> float | None:
        quantity = "C" if info.field_name == "position_sigma_m" else "R"
        # a faulty C or R is not among the data: it has a problem of its own
        if sigma is not None and info.data.get(quantity, ()) is None:
            raise ValueError(f"is the uncertainty of {quantity}, which is not given")
        return sigma

    @property
    def lens(self) -> Lens:
        """The camera's lens; coefficients missing from a short "brown" list are 0."""
        coefficients = self.distortion or []
        if self.model == "brown" or not coefficients:
            coefficients = coefficients + [0.0] * (5 - len(coefficients))
        return Lens(K=self.K, distortion=coefficients, width=self.width, height=self.height, model=self.model)

    @property
    def placement(self) -> Placement:
        """The camera's pose; an uncertainty that is not stated is 0, which means exact."""
        sigma_m = float(self.position_sigma_m or 0)
        sigma_deg = float(self.rotation_sigma_deg or 0)
        return Placement(self.R, self.C, sigma_m, sigma_deg, metric=self.metric is not False)


REMEDY = "give the file that OpenCV, ROS, Kalibr, COLMAP, Metashape, Pix4D or wbflow wrote; see sites/README.md"


class Faulty(ValueError):
    """A value that cannot be used, with its location in the file."""

    def __init__(self, what: str, location: Location = (), remedy: str = REMEDY) -> None:
        super().__init__(what)
        self.what = what
        self.location = location
        self.remedy = remedy


def calibrated(fields: Mapping[str, Any], shown: Mapping[str, str] | None = None, location: Location = ()) -> Calibrated:
    """Check the fields of a camera.  Raises Faulty if one is missing or cannot be used.

    shown: the names of fields in the camera's file, if they differ.  location: the camera's location in its file.
    """
    try:
        return Calibrated.model_validate(fields)
    except ValidationError as error:
        # one at a time: a file of a program that is not understood would have a fault in every field
        first = error.errors()[0]
        field_name = str(first["loc"][0])
        name = (shown or {}).get(field_name, field_name)
        if first["type"] == "missing":
            raise Faulty(" ".join([*map(str, location), f"lacks {name}"]), location) from None
        cause = str(first.get("ctx", {}).get("error", "")) or _REQUIREMENTS[field_name]
        what = ".".join([*map(str, location), f"{name} {cause}"])
        raise Faulty(what, (*location, name)) from None


def look_at(position: Vector, target: Vector) -> Matrix:
    """R of an upright camera that looks from `position` at `target`.

    Raises ValueError if the two points coincide, or if the camera would look straight up or down (its roll would be undefined).
    """
    forward = _unit([t - p for t, p in zip(target, position, strict=True)])
    # right and down from world up (0, 0, 1): the camera is upright
    right = _cross(forward, [0.0, 0.0, 1.0])
    if math.hypot(*right) < 1e-6:  # its length is the sine of the angle between the two
        raise ValueError("looks straight up or down, so which way is up in the image is unknown: give a rotation instead")
    right = _unit(right)
    return [right, _cross(forward, right), forward]


def yaw_pitch_roll(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Matrix:
    """R from angles: yaw 0 looks along +y, 90 along +x; pitch up is positive; roll is clockwise seen from behind the camera."""
    yaw = math.radians(yaw_deg)
    pitch = math.radians(pitch_deg)
    roll = math.radians(roll_deg)
    forward = [math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)]
    level = [math.cos(yaw), -math.sin(yaw), 0.0]  # to the right without roll
    down = _cross(forward, level)
    right = [math.cos(roll) * a + math.sin(roll) * b for a, b in zip(level, down, strict=True)]
    return [right, _cross(forward, right), forward]


_ROTATION_TOLERANCE = 1e-3
"""How far the products of the rows of a rotation may be from 0 and 1: files have as few as four digits."""


def rotation_fault(R: Matrix) -> str:
    """What is wrong with a rotation matrix; "" if nothing is."""
    for i in range(3):
        for j in range(3):
            expected = 1.0 if i == j else 0.0
            if not abs(_dot(R[i], R[j]) - expected) < _ROTATION_TOLERANCE:  # or NaN
                return "is not a rotation matrix (rows of unit length, at right angles)"
    if _dot(_cross(R[0], R[1]), R[2]) < 0:
        return "is a mirror, not a rotation (its determinant is -1)"
    return ""


def quaternion_rotation(quaternion: Sequence[float]) -> Matrix:
    """The rotation of a quaternion w, x, y, z of any length but 0 and infinity.  Raises ValueError."""
    w, x, y, z = quaternion
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not 1e-6 < length < 1e6:
        raise ValueError("its quaternion is zero or infinite, which is not a rotation")
    w /= length
    x /= length
    y /= length
    z /= length
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def centre(R: Matrix, t: Vector) -> Vector:
    """The centre of the camera x = R X + t: C = -R^T t."""
    return [-value for value in turned(list(zip(*R, strict=True)), t)]


def turned(R: Sequence[Sequence[float]], x: Sequence[float]) -> Vector:
    """The product of a matrix and a vector."""
    return [_dot(row, x) for row in R]


def product(A: Sequence[Sequence[float]], B: Sequence[Sequence[float]]) -> Matrix:
    """The product of two matrices."""
    columns = list(zip(*B, strict=True))
    return [turned(columns, row) for row in A]


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _cross(a: Vector, b: Vector) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _unit(v: Vector) -> Vector:
    length = math.hypot(*v)
    if length < 1e-9:
        raise ValueError("looks at its own position")
    return [x / length for x in v]

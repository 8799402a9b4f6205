"""What a calibration file says of a camera, and what is the same in all kinds of such files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..cache.untrusted import MOST_TEXT_BYTES, Unreadable, read_outside
from ..errors import ExitCode, WbflowError

Matrix = list[list[float]]

LARGEST = 1e12
"""Of any number in a calibration: metres, pixels."""
MOST_PIXELS_A_SIDE = 1_000_000
"""Of an image."""

COEFFICIENTS = {
    "pinhole": (0,),
    "brown": (0, 1, 2, 3, 4, 5, 8, 12, 14),
    "rational": (8, 12, 14),
    "fisheye": (1, 2, 3, 4),
    "division": (1,),
    "fov": (1,),
    "eucm": (2,),
    "omni": (1, 3, 5, 6),
    "double-sphere": (2,),
    "thin-prism-fisheye": (8,),
    "rad-tan-thin-prism-fisheye": (12,),
    "equirectangular": (0,),
}
"""How many numbers the distortion of a lens model has (`wbflow_stages.core.lenses`)."""

ORDERS = {
    "brown": "k1 k2 p1 p2 k3, and further ones as OpenCV orders them",
    "rational": "k1 k2 p1 p2 k3 k4 k5 k6",
    "fisheye": "k1 k2 k3 k4",
    "division": "k",
    "fov": "omega",
    "eucm": "alpha beta",
    "omni": "xi k1 k2 p1 p2",
    "double-sphere": "xi alpha",
    "thin-prism-fisheye": "k1 k2 p1 p2 k3 k4 sx1 sy1",
    "rad-tan-thin-prism-fisheye": "k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3",
}
"""What they are."""


class CalibrationError(WbflowError, ValueError):
    """A calibration file cannot be used; the message says what and where."""

    exit_code = ExitCode.USAGE


@dataclass(frozen=True)
class Calibrated:
    """What a file says of a camera; None where it does not say."""

    K: Matrix
    """(3, 3)."""
    width: int
    height: int
    distortion: list[float] | None = None
    """Coefficients of `model`: of "brown" k1 k2 p1 p2 k3."""
    R: Matrix | None = None
    """(3, 3), from world to camera axes."""
    C: list[float] | None = None
    """(3,), the centre in the world."""
    metric: bool = True
    """C is in metres."""
    sigma_m: float = 0.0
    """Standard deviation of C, 0 where it is exact."""
    sigma_deg: float = 0.0
    """Standard deviation of R, 0 where it is exact."""
    model: str = "brown"
    """How the lens bends light: a key of `COEFFICIENTS`."""


def lens_fault(model: str, distortion: list[float] | None) -> tuple[str, str]:
    """What is wrong with the coefficients of a lens, and what to do; both empty where nothing is."""
    counts = COEFFICIENTS.get(model)
    if counts is None:
        return f"{model!r} is no lens model that is known", f"use one of {', '.join(COEFFICIENTS)}"
    count = len(distortion or [])
    if count in counts or (model in {"pinhole", "equirectangular"} and not any(distortion or [])):
        return "", ""
    wanted = " or ".join(map(str, counts))
    order = f" ({ORDERS[model]})" if model in ORDERS else ""
    return f"a {model} lens has {wanted} coefficients{order}, not {count}", "give them in that order, or another model"


def is_number(value: Any) -> bool:
    """One to reckon with."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST  # not NaN either


def is_size(value: Any) -> bool:
    """A side of an image, pixels."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value <= MOST_PIXELS_A_SIDE


def is_rotation(R: Matrix, tolerance: float = 1e-3) -> bool:
    """Rows of unit length at right angles, no mirror."""
    dots = [sum(a * b for a, b in zip(R[i], R[j], strict=True)) - (i == j) for i in range(3) for j in range(3)]
    cross = [R[0][1] * R[1][2] - R[0][2] * R[1][1], R[0][2] * R[1][0] - R[0][0] * R[1][2], R[0][0] * R[1][1] - R[0][1] * R[1][0]]
    return max(map(abs, dots)) < tolerance and sum(a * b for a, b in zip(cross, R[2], strict=True)) > 0


def text_of(path: Path) -> str:
    """A file's text.  Raises CalibrationError."""
    try:
        data = read_outside(path, MOST_TEXT_BYTES)
        return data.decode("utf-8-sig")
    except Unreadable as error:
        raise CalibrationError(error.what, where=str(path)) from None
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        column = error.start - data.rfind(b"\n", 0, error.start)
        raise CalibrationError("is not UTF-8 text", where=f"{path}:{line}:{column}", remedy="save the file as UTF-8") from None

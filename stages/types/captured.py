"""Captured files, and what the site states about its cameras."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..contracts import stated
from ..contracts.short_repr import Record
from .arrays import Float64s, Uint8s


@dataclass(frozen=True)
class Capture(Record):
    """One captured file, image or video, as it is on disk."""

    name: str
    data: Uint8s
    """(n,) uint8, the encoded bytes."""

    @classmethod
    def of_pixels(cls, name: str, pixels: Uint8s) -> Capture:
        """A picture in memory as a file that holds exactly its pixels (PNG).  pixels: (h, w, 3) uint8 RGB, or (h, w) uint8."""
        import cv2  # here, so that types alone do not load it

        channels = np.ascontiguousarray(pixels[..., ::-1]) if pixels.ndim == 3 else pixels
        _, encoded = cv2.imencode(".png", channels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        return cls(name, np.asarray(encoded, dtype=np.uint8).ravel())


@dataclass(frozen=True)
class Lens(stated.Lens[Float64s, Float64s]):
    """Intrinsics as the site states them, as arrays."""

    distortion: Float64s = field(default_factory=lambda: np.array(stated.NO_DISTORTION))

    @classmethod
    def of_arrays(cls, K: object, distortion: object, hfov_deg: float | None) -> Lens:
        """A lens from what a program states, in OpenCV's model; None: unknown.

        K: (3, 3) pixels; distortion: (n,) k1 k2 p1 p2 k3 and further ones.  Raises ValueError if a shape or a value is wrong.
        """
        matrix = None if K is None else _numbers("K", K)
        if matrix is not None:
            if matrix.shape != (3, 3) or matrix[2].tolist() != [0, 0, 1] or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
                given = matrix.tolist() if matrix.size <= 9 else matrix.shape
                raise ValueError(f"K is {given}; [[fx, s, cx], [0, fy, cy], [0, 0, 1]] in pixels is needed")
        if hfov_deg is not None and not 0 < hfov_deg < 180:
            raise ValueError(f"hfov_deg is {hfov_deg}; a horizontal field of view between 0 and 180 degrees is needed")
        if distortion is None:
            return cls(K=matrix, hfov_deg=hfov_deg)
        coefficients = _numbers("distortion", distortion)
        counts = stated.LensModel.BROWN.counts
        if coefficients.ndim != 1 or coefficients.size not in counts:
            raise ValueError(f"distortion is {coefficients.shape}; (n,) is needed, n one of {', '.join(map(str, counts))}")
        missing = max(0, len(stated.NO_DISTORTION) - coefficients.size)
        return cls(matrix, np.pad(coefficients, (0, missing)), hfov_deg)


def _numbers(name: str, value: object) -> Float64s:
    """An argument as an array of finite numbers.  Raises ValueError."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is a {type(value).__name__} that is no array of numbers") from None
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name} has values that are not finite")
    return numbers


Placement = stated.Placement[Float64s, Float64s]
"""The pose of a camera as the site states it, as arrays."""


@dataclass(frozen=True)
class Privacy(Record):
    """Polygons of a capture whose content must not be seen."""

    corners: Float64s = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) corners of all polygons, one polygon after the other, in pixels of the upright capture; or as shares of width and
    height, if all corners of a polygon lie between 0 and 1."""
    counts: Float64s = field(default_factory=lambda: np.zeros(0))
    """(polygons,) number of corners of each polygon."""

"""Undistortion of captures to pinhole images: with the lens's own K, or as a view of what a wider lens sees."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import radians, tan

import cv2
import numpy as np

from ..core.cameras import scaled_intrinsics
from ..core.lenses import WIDEST_DEG, lens_pixels, sides_deg
from ..types import Bools, Float32s, Float64s, Lens, Uint8s, View
from .files import BadCapture, wrong_size


@dataclass(frozen=True)
class CapturePinhole:
    """Size and intrinsics of captures, and of the undistorted pinhole image that is made of them.

    For a `pinhole` or `brown` lens that image has the K and size of the captures, and pixels without a source are black.
    Otherwise it covers exactly what the lens sees, up to `WIDEST_DEG` or in the window of one view among several, at the scale
    of the lens's centre.
    """

    width: int
    """Width of captures, pixels."""
    height: int
    K: Float64s | None
    """(3, 3) of the undistorted image, None if unknown; a guess from the field of view unless `focal_known`."""
    focal_known: bool
    lens: Lens
    size: tuple[int, int]
    """(width, height) of the undistorted image, at the scale of captures."""

    @classmethod
    def of(cls, image: Uint8s, lens: Lens, name: str, whole_field: bool = False) -> CapturePinhole:
        """The pinhole for a capture.

        Raises BadCapture if its size differs from that of the lens, or if the lens sees nothing in the direction of the view.

        Parameters
        ----------
        image : (h, w, 3) uint8, as captured.
        lens : the lens, as far as it is known.
        name : of the capture, for messages.
        whole_field : for a brown lens: cover all that it sees (up to `WIDEST_DEG`) instead of what fits its own K and size.
        """
        height, width = image.shape[:2]
        if lens.width and lens.height and (width, height) != (lens.width, lens.height):
            raise wrong_size(name, width, height, lens)
        K, known = _intrinsics(lens, width, height)
        if lens.K is None or not _changes_intrinsics(lens, whole_field):
            return cls(width, height, K, known, lens, (width, height))
        return cls(width, height, *_covering_pinhole(lens, width, height, name))

    @property
    def keeps_intrinsics(self) -> bool:
        """Does the undistorted image have the captures' own K and size?"""
        return self.lens.K is None or self.K is self.lens.K

    def undistort(self, image: Uint8s, nearest: bool = False) -> Uint8s:
        """Undistort (h, w, ...) of the captures' size; pixels without a source become 0."""
        if self.K is None or (self.keeps_intrinsics and not np.any(self.lens.distortion)):
            return image
        # of a mask in a view of another size, pixels that mix with the black outside count as not seen
        filtering = cv2.INTER_LINEAR
        if nearest and self.keeps_intrinsics:
            filtering = cv2.INTER_NEAREST
        undistorted = cv2.remap(image, *self._maps, filtering, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray(undistorted, dtype=np.uint8)

    def working_size(self, resolution: int | None) -> tuple[int, int]:
        """(width, height) of the frame, at the scale of captures resized to a long side of `resolution`."""
        width, height = working_size(self.width, self.height, resolution)
        if self.size == (self.width, self.height):
            return width, height
        scale = max(width, height) / max(self.width, self.height)
        return max(1, round(self.size[0] * scale)), max(1, round(self.size[1] * scale))

    def view(self, width: int, height: int) -> View:
        """The `View` of a frame of this size."""
        K = None
        if self.K is not None:
            K = scaled_intrinsics(self.K, width / self.size[0], height / self.size[1])
        known = self.focal_known and K is not None
        if not self.keeps_intrinsics:
            return View(width, height, K, known, self.width, self.height, lens=self.lens)
        distortion = np.zeros(5) if K is None else self.lens.distortion
        return View(width, height, K, known, self.width, self.height, distortion)

    def loss_notes(self) -> tuple[str, ...]:
        """A note on the part of the lens's field that no pinhole shows; () if there is none."""
        if self.keeps_intrinsics or self.K is None or self.lens.turn is not None:
            return ()
        left, right, upper, lower = sides_deg(self.lens, self.width, self.height)
        width_deg = left + right
        height_deg = upper + lower
        if max(width_deg, height_deg) < WIDEST_DEG + 2:
            return ()
        used = f"{min(width_deg, WIDEST_DEG):.0f} x {min(height_deg, WIDEST_DEG):.0f}"
        return (f"the lens sees {width_deg:.0f} x {height_deg:.0f} degrees; only the {used} in its middle are used",)

    @cached_property
    def _maps(self) -> tuple[Float32s, Float32s]:
        """Column and row in the capture of each pixel of the undistorted image."""
        assert self.K is not None
        if self.keeps_intrinsics:
            maps = cv2.initUndistortRectifyMap(self.K, self.lens.distortion, None, self.K, self.size, cv2.CV_32FC1)
            return np.asarray(maps[0], np.float32), np.asarray(maps[1], np.float32)
        width, height = self.size
        x = np.empty((height, width), np.float32)
        y = np.empty((height, width), np.float32)
        to_rays = np.linalg.inv(self.K).T  # transposed: pixels are rows here
        for first in range(0, height, _ROWS_AT_ONCE):
            rows = np.arange(first, min(first + _ROWS_AT_ONCE, height))
            pixels = np.stack([*np.meshgrid(np.arange(width), rows), np.ones((len(rows), width))], axis=-1)
            rays: Float64s = pixels.reshape(-1, 3).astype(np.float64) @ to_rays
            sources = lens_pixels(self.lens, _in_lens_axes(self.lens, rays))
            # pixels that the lens does not see are mapped to far outside the capture
            x[rows] = np.nan_to_num(sources[:, 0], nan=-1e4).reshape(len(rows), width)
            y[rows] = np.nan_to_num(sources[:, 1], nan=-1e4).reshape(len(rows), width)
        return x, y


def working_size(width: int, height: int, resolution: int | None) -> tuple[int, int]:
    """(width, height) in pixels of an image scaled down to a long side of `resolution`; it is never enlarged."""
    if resolution is not None and resolution < 1:
        raise ValueError(f"resolution is {resolution}, at least 1 pixel is needed")
    if resolution is None or resolution >= max(width, height):
        return width, height
    scale = resolution / max(width, height)
    return max(1, round(width * scale)), max(1, round(height * scale))


_ROWS_AT_ONCE = 128
"""Rows of the maps that are computed at once, to bound memory."""
_GRID_DEG = 0.25
"""Angular step of the search for the limits of a view."""


def _changes_intrinsics(lens: Lens, whole_field: bool) -> bool:
    """Does the undistorted image get another K and size than the lens's own?"""
    if lens.model == "brown":
        return whole_field and bool(np.any(lens.distortion))
    return lens.model != "pinhole"


def _in_lens_axes(lens: Lens, rays: Float64s) -> Float64s:
    """Rays (n, 3) of a view in the axes of its lens."""
    if lens.turn is None:
        return rays
    return rays @ lens.turn


def _intrinsics(lens: Lens, width: int, height: int) -> tuple[Float64s | None, bool]:
    """K of the captured image, and whether its focal length is known rather than guessed from a field of view."""
    if lens.K is not None:
        return lens.K, True
    if lens.hfov_deg is None:
        return None, False
    f = 0.5 * width / tan(0.5 * radians(lens.hfov_deg))
    return np.array([[f, 0.0, 0.5 * (width - 1)], [0.0, f, 0.5 * (height - 1)], [0.0, 0.0, 1.0]]), False


def _covering_pinhole(lens: Lens, width: int, height: int, name: str) -> tuple[Float64s, bool, Lens, tuple[int, int]]:
    """K, True as it is known, the lens, and the size of the view."""
    # 1. which directions on a grid of angles the lens sees
    x_tangents = _tangents(lens, 0)
    y_tangents = _tangents(lens, 2)
    x, y = np.meshgrid(x_tangents, y_tangents)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    pixels = lens_pixels(lens, _in_lens_axes(lens, rays))
    visible = np.all((pixels > -0.5) & (pixels < (width - 0.5, height - 0.5)), axis=1).reshape(x.shape)
    if not visible.any():
        raise BadCapture(f"{name}: according to its intrinsics, the lens sees nothing in front of it")

    # 2. the pinhole that covers them, at the scale of the lens's centre
    left, right = _covered(x_tangents, visible.any(axis=0))
    upper, lower = _covered(y_tangents, visible.any(axis=1))
    f = _central_scale(lens)
    size = (max(1, round(f * (right - left))), max(1, round(f * (lower - upper))))
    K = np.array([[f, 0.0, -f * left - 0.5], [0.0, f, -f * upper - 0.5], [0.0, 0.0, 1.0]])
    return K, True, lens, size


def _covered(tangents: Float64s, visible: Bools) -> tuple[float, float]:
    """The first and the last of the tangents along an axis that a view covers: a step beyond those that are visible."""
    steps = np.flatnonzero(visible)
    return tangents[max(steps[0] - 1, 0)], tangents[min(steps[-1] + 1, len(tangents) - 1)]


def _tangents(lens: Lens, start: int) -> Float64s:
    """Tangents of the angles along one axis of a view, from one end to the other."""
    low = -0.5 * WIDEST_DEG
    high = 0.5 * WIDEST_DEG
    if lens.window is not None:
        low, high = np.rad2deg(np.arctan(lens.window[start : start + 2]))
    return np.asarray(np.tan(np.deg2rad(np.arange(low, high + 1e-9, _GRID_DEG))), dtype=np.float64)


def _central_scale(lens: Lens) -> float:
    """Pixels of the capture per radian at the centre of the lens."""
    step = 1e-4  # radians
    x = lens_pixels(lens, np.array([[step, 0, 1], [-step, 0, 1], [0, step, 1], [0, -step, 1]]))
    # the determinant of the Jacobian is the scale of areas
    scale = np.sqrt(abs(np.linalg.det(np.array([x[0] - x[1], x[2] - x[3]]) / (2 * step))))
    if not np.isfinite(scale):
        raise BadCapture("the lens sees nothing on its own axis: are its coefficients right?")
    return float(scale)

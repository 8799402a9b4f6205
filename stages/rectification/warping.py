"""Moving points and images between a frame and its rectified image, whatever the method of rectification.

`side` is 1 for the left image and 2 for the right one.  Points are (n, 2) float64 (x, y), pixel centres at integers.  For a frame
with residual lens distortion, points are in the undistorted frame; images are sampled in the distorted one.
"""

from __future__ import annotations

from typing import Literal, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from ..core.epipolar import apply_homography
from ..core.residual_distortion import distorted_pixels
from ..types import INVALID, Bools, Disparity, Float32s, Float64s, PolarRows, Rectification

Side = Literal[1, 2]
Pixels = TypeVar("Pixels", np.uint8, np.float32)
_COARSE_PX = 2.0
"""A frame is smoothed first if rectified pixels lie farther apart in it than this, pixels: its camera sees
finer than its partner."""
_SAMPLE_STEP = 16
"""The distance is measured at every so-manieth rectified pixel, along rows and columns."""
_OUTSIDE = -1e4
"""Coordinate far outside any frame, pixels, for rectified pixels that show nothing."""
_FARTHEST = 1e6
"""Largest coordinate that is passed to OpenCV, pixels: outside any frame, and within the range of its integers."""


def rectified_size(rectification: Rectification, side: Side) -> tuple[int, int]:
    """(width, height) of one rectified image."""
    return rectification.size1 if side == 1 else rectification.size2


def to_rectified(rectification: Rectification, side: Side, x: Float64s) -> Float64s:
    """Where points (n, 2) of a frame lie in its rectified image; the result may lie outside it."""
    polar, H = _maps(rectification, side)
    if polar is None:
        return apply_homography(H, x)
    ray = x - polar.epipole
    radius = np.hypot(ray[:, 0], ray[:, 1])
    column = polar.direction * radius - polar.start_px
    row = _row_of_angle(polar, np.arctan2(ray[:, 1], ray[:, 0]))
    return np.column_stack([column, row])


def from_rectified(rectification: Rectification, side: Side, x: Float64s) -> Float64s:
    """The exact inverse of `to_rectified`: where points (n, 2) of a rectified image lie in the frame."""
    polar, H = _maps(rectification, side)
    if polar is None:
        return apply_homography(np.asarray(np.linalg.inv(H), dtype=np.float64), x)
    radius = polar.direction * (x[:, 0] + polar.start_px)
    angle = _angle_of_row(polar, x[:, 1])
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(polar.epipole + radius[:, None] * direction)


def warp(rectification: Rectification, side: Side, image: npt.NDArray[Pixels]) -> npt.NDArray[Pixels]:
    """Resample an image (h, w) or (h, w, 3) of the frame, uint8 or float32, by linear interpolation; 0 outside the frame."""
    return _smoothed_and_resampled(image, _source_of_pixels(rectification, side))


def warp_with_mask(
    rectification: Rectification, side: Side, image: npt.NDArray[Pixels], mask: Bools
) -> tuple[npt.NDArray[Pixels], Bools]:
    """`warp`, and (h, w) bool: True where all the pixels that it reads lie inside the frame and its mask.

    Parameters
    ----------
    rectification, side : how the frames are resampled, and the side of the frame.
    image, mask : (h, w) or (h, w, 3) of that side, and (h, w) pixels of it that may be used.
    """
    source = _source_of_pixels(rectification, side)
    visible = _resampled(mask.astype(np.float32), source) > 0.9999  # a mean of ones, whatever its rounding
    return _smoothed_and_resampled(image, source), np.asarray(visible)


def _smoothed_and_resampled(image: npt.NDArray[Pixels], source: tuple[Float32s, Float32s]) -> npt.NDArray[Pixels]:
    """The image resampled, smoothed first if it has finer detail than the rectified pixels can show."""
    step = _step_px(source, image.shape[1], image.shape[0])
    if step > _COARSE_PX:
        # a pixel itself has a blur of half a pixel: variances add up to that of a pixel `step` times as large
        sigma = 0.5 * np.sqrt(step**2 - 1)
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), dtype=image.dtype)
    return _resampled(image, source)


def _step_px(source: tuple[Float32s, Float32s], width: int, height: int) -> float:
    """Median distance from one rectified pixel to the next, in pixels of the frame."""
    x, y = source
    # samples, without the last row and column, which have no next ones
    rows = slice(0, max(x.shape[0] - 1, 0), _SAMPLE_STEP)
    columns = slice(0, max(x.shape[1] - 1, 0), _SAMPLE_STEP)
    inside = ((x > 0) & (x < width - 1) & (y > 0) & (y < height - 1))[rows, columns]
    if not inside.any():
        return 1.0
    right_x = np.roll(x, -1, 1)[rows, columns] - x[rows, columns]
    right_y = np.roll(y, -1, 1)[rows, columns] - y[rows, columns]
    down_x = np.roll(x, -1, 0)[rows, columns] - x[rows, columns]
    down_y = np.roll(y, -1, 0)[rows, columns] - y[rows, columns]
    steps = np.maximum(np.hypot(right_x, right_y), np.hypot(down_x, down_y))
    return float(np.median(steps[inside]))


def _resampled(image: npt.NDArray[Pixels], source: tuple[Float32s, Float32s]) -> npt.NDArray[Pixels]:
    return np.asarray(cv2.remap(image, *source, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), dtype=image.dtype)


def resampling(rectification: Rectification, side: Side, x: Float64s) -> tuple[Float64s, Float64s, Float64s]:
    """Area, longer and shorter side (n,) that pixels of a frame at points x (n, 2) get in the rectified image; areas are negative
    if it is mirrored.  These are the determinant and the singular values of the Jacobian."""
    polar, H = _maps(rectification, side)
    if polar is None:
        return _resampling_by_homography(H, x)
    ray_x, ray_y = (x - polar.epipole).T
    k = np.floor(_row_of_angle(polar, np.arctan2(ray_y, ray_x))).astype(np.int64)
    k = np.clip(k, 0, len(polar.angles) - 2)
    # pixels keep their length along a row; the other singular value is that across the row
    rows_per_px = polar.direction / (np.hypot(ray_x, ray_y) * (polar.angles[k + 1] - polar.angles[k]))
    across = np.abs(rows_per_px)
    return rows_per_px, np.maximum(across, 1), np.minimum(across, 1)


def _resampling_by_homography(H: Float64s, x: Float64s) -> tuple[Float64s, Float64s, Float64s]:
    """`resampling` by a homography (3, 3)."""
    u, v, w = (a * x[:, 0] + b * x[:, 1] + c for a, b, c in H)
    inverse = 1 / w
    u = u * inverse
    v = v * inverse
    # the Jacobian [[a, b], [c, d]]
    a = (H[0, 0] - u * H[2, 0]) * inverse
    b = (H[0, 1] - u * H[2, 1]) * inverse
    c = (H[1, 0] - v * H[2, 0]) * inverse
    d = (H[1, 1] - v * H[2, 1]) * inverse
    # singular values of a 2x2 matrix: their sum and their difference in closed form
    singular_sum = np.sqrt((a + d) ** 2 + (c - b) ** 2)
    singular_difference = np.sqrt((a - d) ** 2 + (c + b) ** 2)
    longer = 0.5 * (singular_sum + singular_difference)
    shorter = 0.5 * np.abs(singular_sum - singular_difference)
    return a * d - b * c, longer, shorter


def disparity_px(disparity: Disparity, side: Side) -> Float32s:
    """(h, w) float32 disparity of one view in pixels, nan where unknown.  A pixel x of the left view lies at x - d in the right
    one; a pixel x of the right view lies at x + d in the left one."""
    stored = disparity.left if side == 1 else disparity.right
    values = stored.astype(np.float32) / 16 + disparity.offset_px
    return np.where(stored == INVALID, np.float32(np.nan), values).astype(np.float32)


def _maps(rectification: Rectification, side: Side) -> tuple[PolarRows | None, Float64s]:
    """How one side is resampled: its polar rows, or None and its homography (3, 3)."""
    if side == 1:
        polar = rectification.polar1
        H = rectification.H1
    else:
        polar = rectification.polar2
        H = rectification.H2
    if polar is None and H is None:
        raise ValueError("a rectification needs a homography or polar rows for each image")
    if H is None:
        H = np.eye(3)  # not used beside polar rows
    return polar, H


def _row_of_angle(polar: PolarRows, angle: Float64s) -> Float64s:
    """Fractional row of each angle; the circle is cut opposite to the middle of the rows' range."""
    # a table that ascends, whatever the direction of the rows
    sign = 1.0 if polar.angles[-1] > polar.angles[0] else -1.0
    table = sign * polar.angles
    middle = 0.5 * (table[0] + table[-1])
    unwrapped = middle + (sign * angle - middle + np.pi) % (2 * np.pi) - np.pi
    k = np.clip(np.searchsorted(table, unwrapped) - 1, 0, len(table) - 2)  # the end segments extrapolate
    return np.asarray(k + (unwrapped - table[k]) / (table[k + 1] - table[k]), dtype=np.float64)


def _angle_of_row(polar: PolarRows, row: Float64s) -> Float64s:
    """Angle of each fractional row, the inverse of `_row_of_angle`."""
    k = np.clip(np.floor(row).astype(np.int64), 0, len(polar.angles) - 2)
    return np.asarray(polar.angles[k] + (row - k) * (polar.angles[k + 1] - polar.angles[k]), dtype=np.float64)


def _source_of_pixels(rectification: Rectification, side: Side) -> tuple[Float32s, Float32s]:
    """Frame coordinates (h, w) of every pixel of the rectified image, float32; far outside the frame where there is none."""
    x, y = _undistorted_source(rectification, side)
    distortion = rectification.bend1 if side == 1 else rectification.bend2
    if distortion is None:
        return x, y
    return distorted_pixels(distortion, x, y)


def _undistorted_source(rectification: Rectification, side: Side) -> tuple[Float32s, Float32s]:
    """As `_source_of_pixels`, in the undistorted frame."""
    width, height = rectified_size(rectification, side)
    polar, H = _maps(rectification, side)
    columns = np.arange(width, dtype=np.float64)
    rows = np.arange(height, dtype=np.float64)
    if polar is None:
        inverse = np.linalg.inv(H)
        corners = np.array([[0.0, width - 1.0, width - 1.0, 0.0], [0.0, 0.0, height - 1.0, height - 1.0], [1.0, 1.0, 1.0, 1.0]])
        # the sign of a homography is free: this one makes z positive in most of the image
        inverse = inverse * np.sign(np.median(inverse[2] @ corners))
        x, y, z = (inverse[k, 0] * columns + (inverse[k, 1] * rows + inverse[k, 2])[:, None] for k in range(3))
        with np.errstate(divide="ignore", invalid="ignore"):
            visible = z > 0
            return _clipped_or_outside(x / z, visible), _clipped_or_outside(y / z, visible)
    radius = polar.direction * (columns + polar.start_px)
    angle = _angle_of_row(polar, rows)[:, None]
    visible = np.broadcast_to(radius >= 0, (height, width))
    x = polar.epipole[0] + radius * np.cos(angle)
    y = polar.epipole[1] + radius * np.sin(angle)
    return _clipped_or_outside(x, visible), _clipped_or_outside(y, visible)


def _clipped_or_outside(x: Float64s, visible: Bools) -> Float32s:
    """(h, w) coordinates, float32, that OpenCV can resample by."""
    return np.where(visible, np.clip(x, _OUTSIDE, _FARTHEST), _OUTSIDE).astype(np.float32)

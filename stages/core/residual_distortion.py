"""Residual distortion of lenses without stated coefficients: solved together with the poses, removed in all later stages.

Frames are made before the distortion of such a lens is known.  If its solved k1 and k2 (`Camera.radial`) move a corner by more
than a pixel, the frame is undistorted whenever a later stage loads it; the points of pairs are undistorted likewise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from ..types import Camera, Float32s, Float64s, Frame
from .on_demand import OnDemand

UNDISTORTED_PX = 1.0
"""A frame counts as undistorted if the solved distortion moves its corners by at most this, in pixels."""


def without_distortion(camera: Camera, x: Float64s) -> Float64s:
    """(n, 2) undistorted pixels of pixels (n, 2) of the frame; none lies beyond the radius at which the model folds over."""
    if not any(camera.radial):
        return x
    centre = camera.K[:2, 2]
    f = camera.K[[0, 1], [0, 1]]
    distorted = (x - centre) / f
    radius = np.linalg.norm(distorted, axis=1)
    undistorted = radius.copy()
    k1, k2 = camera.radial
    fold = _fold(k1, k2)
    # Newton's method; the slope is bounded, as the model folds over outside the image, or inside it while k1, k2 are a wild guess
    for _ in range(20):
        square = undistorted**2
        slope = np.maximum(1 + 3 * k1 * square + 5 * k2 * square**2, 0.2)
        error = undistorted * (1 + k1 * square + k2 * square**2) - radius
        undistorted = np.clip(undistorted - error / slope, 0, fold)
    factor = undistorted / np.maximum(radius, 1e-12)
    return np.asarray(centre + f * distorted * factor[:, None], dtype=np.float64)


def _fold(k1: float, k2: float) -> float:
    """Normalised radius beyond which the distorted radius shrinks again (the model folds over); infinity if it never does."""
    squares = np.roots([5 * k2, 3 * k1, 1.0])  # squared radii at which the slope of the distorted radius is 0
    positive = [square.real for square in squares if square.imag == 0 and square.real > 0]
    return float(np.sqrt(min(positive))) if positive else np.inf


def residual_px(camera: Camera) -> float:
    """Largest displacement of a corner of the frame by the solved distortion, pixels."""
    right = camera.width - 1.0
    bottom = camera.height - 1.0
    corners = np.array([[0.0, 0.0], [0.0, bottom], [right, 0.0], [right, bottom]])
    return float(np.linalg.norm(without_distortion(camera, corners) - corners, axis=1).max())


def residual_distortion(camera: Camera | None) -> Float64s | None:
    """(6,) fx fy cx cy k1 k2 of a camera whose frame is distorted; None if it counts as undistorted (`UNDISTORTED_PX`)."""
    if camera is None or not any(camera.radial) or residual_px(camera) <= UNDISTORTED_PX:
        return None
    K = camera.K
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *camera.radial])


def distorted_pixels(distortion: Float64s, x: Float64s | Float32s, y: Float64s | Float32s) -> tuple[Float32s, Float32s]:
    """Pixels in the distorted frame of pixels x, y of the undistorted one; far outside where the model folds over."""
    # numbers of 64 bits: with Python's own, pixels of 32 bits would stay of 32 bits
    fx, fy, cx, cy, k1, k2 = np.asarray(distortion, dtype=np.float64)
    a = (x - cx) / fx
    b = (y - cy) / fy
    square = a * a + b * b
    # slope of the distorted radius: beyond the fold, points would come back into the image
    unfolded = 1 + square * (3 * k1 + 5 * k2 * square) > 0
    factor = np.where(unfolded, 1 + square * (k1 + k2 * square), np.nan)
    return _remap_pixels(cx + fx * a * factor), _remap_pixels(cy + fy * b * factor)


def _remap_pixels(pixels: Float64s) -> Float32s:
    """Pixels as OpenCV's remap takes them: float32, without nan, and not so large that they overflow its integers."""
    return np.asarray(np.nan_to_num(pixels, nan=-1e4).clip(-1e4, 1e6), dtype=np.float32)


def undistorted_points(camera: Camera | None, x: Float64s) -> Float64s:
    """(n, 2) undistorted pixels of pixels of a frame as it is; unchanged if the frame counts as undistorted."""
    if camera is None or residual_distortion(camera) is None:
        return x
    return without_distortion(camera, x)


def undistorted_frame(frame: Frame, camera: Camera | None) -> Frame:
    """The undistorted frame; the frame itself if it counts as undistorted."""
    distortion = residual_distortion(camera)
    if distortion is None:
        return frame
    height, width = frame.mask.shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    maps = distorted_pixels(distortion, x, y)
    image = cv2.remap(frame.image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    mask = cv2.remap(frame.mask.astype(np.float32), *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    # a pixel may be used if all four that it was interpolated from may
    return replace(frame, image=np.asarray(image, np.uint8), mask=np.asarray(mask > 0.9999, np.bool_))


def undistorted_frames(frames: Mapping[str, Frame], cameras: Mapping[str, Camera]) -> Mapping[str, Frame]:
    """Undistorted frames by camera, each made on access."""
    distorted = [name for name, camera in cameras.items() if name in frames and residual_distortion(camera) is not None]
    if not distorted:
        return frames
    return OnDemand(frames, lambda name: undistorted_frame(frames[name], cameras.get(name)))

"""What a lens that nobody stated still bends in a frame: found with the poses, and taken out for all that comes after them.

Frames are made before anything is known of such a lens.  What its solved k1 and k2 (`Camera.radial`) move by a pixel and more is
straightened when the frame is looked at again; points of pairs are moved likewise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from ..types import Camera, Float32s, Float64s, Frame
from .on_demand import OnDemand

STRAIGHT_PX = 1.0
"""A frame whose corners a lens moves by no more than this is taken for straight."""


def without_distortion(camera: Camera, x: Float64s) -> Float64s:
    """(n, 2) pixels of the frame, moved to where a pinhole would have them; none beyond where the lens folds over."""
    if not any(camera.radial):
        return x
    centre, f = camera.K[:2, 2], camera.K[[0, 1], [0, 1]]
    distorted = (x - centre) / f
    radius = np.linalg.norm(distorted, axis=1)
    straight = radius.copy()
    k1, k2 = camera.radial
    fold = _fold(k1, k2)
    # Newton; the slope is bounded, since the model folds over outside the image, or in it if it is a wild guess
    for _ in range(20):
        square = straight**2
        slope = np.maximum(1 + 3 * k1 * square + 5 * k2 * square**2, 0.2)
        straight = np.clip(straight - (straight * (1 + k1 * square + k2 * square**2) - radius) / slope, 0, fold)
    return np.asarray(centre + f * distorted * (straight / np.maximum(radius, 1e-12))[:, None], dtype=np.float64)


def _fold(k1: float, k2: float) -> float:
    """The distance from the axis from which on what lies farther out is imaged farther in; infinity where there is none."""
    squares = np.roots([5 * k2, 3 * k1, 1.0])  # of the distances where the slope of the image is 0
    ahead = [square.real for square in squares if square.imag == 0 and square.real > 0]
    return float(np.sqrt(min(ahead))) if ahead else np.inf


def residual_px(camera: Camera) -> float:
    """How far the solved distortion moves the corners of the frame."""
    corners = np.array([[x, y] for x in (0.0, camera.width - 1.0) for y in (0.0, camera.height - 1.0)])
    return float(np.linalg.norm(without_distortion(camera, corners) - corners, axis=1).max())


def residual_distortion(camera: Camera | None) -> Float64s | None:
    """(6,) fx fy cx cy k1 k2 of a camera whose frame is bent; None where it is straight."""
    if camera is None or not any(camera.radial) or residual_px(camera) <= STRAIGHT_PX:
        return None
    K = camera.K
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *camera.radial])


def distorted_pixels(bend: Float64s, x: Float64s | Float32s, y: Float64s | Float32s) -> tuple[Float32s, Float32s]:
    """Where in a bent frame the pixels x, y of the straight one are; far outside where the lens folds over."""
    fx, fy, cx, cy, k1, k2 = (np.float64(number) for number in bend)
    a, b = (x - cx) / fx, (y - cy) / fy
    square = a * a + b * b
    unfolded = 1 + square * (3 * k1 + 5 * k2 * square) > 0
    factor = np.where(unfolded, 1 + square * (k1 + k2 * square), np.nan)
    there = (np.nan_to_num(of, nan=-1e4).clip(-1e4, 1e6) for of in (cx + fx * a * factor, cy + fy * b * factor))
    u, v = (of.astype(np.float32) for of in there)
    return u, v


def straight_points(camera: Camera | None, x: Float64s) -> Float64s:
    """(n, 2) pixels of a frame as it is, moved to where the straight frame has them."""
    return x if camera is None or residual_distortion(camera) is None else without_distortion(camera, x)


def straight_frame(frame: Frame, camera: Camera | None) -> Frame:
    """The frame as a pinhole would show it: itself where it is straight."""
    bend = residual_distortion(camera)
    if bend is None:
        return frame
    height, width = frame.mask.shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    maps = distorted_pixels(bend, x, y)
    image = cv2.remap(frame.image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    mask = cv2.remap(frame.mask.astype(np.float32), *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return replace(frame, image=np.asarray(image, np.uint8), mask=np.asarray(mask > 0.9999, np.bool_))


def straight_frames(frames: Mapping[str, Frame], cameras: Mapping[str, Camera]) -> Mapping[str, Frame]:
    """Frames by camera as pinholes would show them, each made when it is asked for."""
    if not any(name in frames and residual_distortion(camera) is not None for name, camera in cameras.items()):
        return frames
    return OnDemand(frames, lambda name: straight_frame(frames[name], cameras.get(name)))

"""Solved cameras in the form that a site file's `calibration` reads."""

from __future__ import annotations

import json
from typing import Any

from ..core.cameras import camera_id
from ..types import Camera, Poses


def calibration(poses: Poses) -> dict[str, Any]:
    """Cameras of the main component by id, as JSON data, in pixels of the original captures."""
    entries: dict[str, Any] = {}
    for name, camera in poses.main_cameras().items():
        entries.setdefault(camera_id(name, camera), _entry(camera, poses.metric))
    return entries


def calibration_file(poses: Poses) -> bytes:
    """`calibration` as the bytes of a file."""
    return json.dumps(calibration(poses)).encode()


def _entry(camera: Camera, metric: bool) -> dict[str, Any]:
    """One camera: K and size of its captures, and their distortion, whether it was known or solved."""
    width = camera.captured_width or camera.width
    height = camera.captured_height or camera.height
    R = camera.R
    lens = camera.lens
    if lens is not None and lens.K is not None:
        # as it was stated: the frames were made from it
        K = lens.K.tolist()
        if lens.turn is not None:
            R = lens.turn.T @ camera.R  # the camera's own axes
    else:
        K = camera.K.tolist()
        for row, scale in ((0, width / camera.width), (1, height / camera.height)):
            # pixel centres are whole numbers, so the principal point moves by half a pixel
            K[row] = [K[row][0] * scale, K[row][1] * scale, (K[row][2] + 0.5) * scale - 0.5]
    entry: dict[str, Any] = {"K": K, "R": R.tolist(), "C": camera.C.tolist(), "width": width, "height": height}

    if lens is not None and lens.K is not None:
        entry["model"] = lens.model
        entry["distortion"] = lens.distortion.tolist()
    else:
        distortion = camera.distortion.tolist()
        if not any(distortion):
            distortion = [*camera.radial, 0.0, 0.0, 0.0]  # solved
        if any(distortion):
            entry["distortion"] = distortion

    if not metric:
        entry["metric"] = False
    return entry

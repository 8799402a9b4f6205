"""Solved cameras in the form that a site file's `calibration` reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from ..contracts.observation_figures import ObservedCamera
from ..core.cameras import camera_id
from ..types import Camera, Lens, ObservedPoses, Placement, Poses


def calibration(poses: Poses) -> dict[str, Any]:
    """Cameras of the main component by id, as JSON data, in pixels of the original captures."""
    entries: dict[str, Any] = {}
    for name, camera in poses.main_cameras().items():
        entries.setdefault(camera_id(name, camera), _entry(camera, poses.metric))
    return entries


def calibration_file(poses: Poses) -> bytes:
    """`calibration` as the bytes of a file."""
    return json.dumps(calibration(poses)).encode()


def observed_calibration_file(observed: ObservedPoses, lenses: Mapping[str, Lens]) -> bytes:
    """The cameras that observations have placed, with standard deviations, as the bytes of a calibration file.

    A camera without a stated K is left out: the format has no poses without lenses.

    lenses: as the site states them, by id.
    """
    entries = {}
    for name, placement in observed.placements.items():
        lens = lenses.get(name, Lens())
        if lens.K is not None and placement.R is not None and placement.C is not None:
            entry = _observed_entry(lens, placement, observed.focal_scales.get(name, 1.0), observed.metric)
            # in the world: the frame's own errors, which the placements leave out, belong to that
            figures = observed.cameras.get(name, ObservedCamera())
            entry["position_sigma_m"] = figures.sigma_m or placement.sigma_m
            entry["rotation_sigma_deg"] = figures.sigma_deg or placement.sigma_deg
            entries[name] = entry
    return json.dumps(entries).encode()


def _observed_entry(lens: Lens, placement: Placement, focal_scale: float, metric: bool) -> dict[str, Any]:
    assert lens.K is not None and placement.R is not None and placement.C is not None
    K = lens.K.copy()
    K[:2, :2] *= focal_scale
    entry: dict[str, Any] = {"K": K.tolist(), "R": placement.R.tolist(), "C": placement.C.tolist()}
    entry |= {"width": lens.width, "height": lens.height, "model": lens.model, "distortion": list(map(float, lens.distortion))}
    if not metric:
        entry["metric"] = False
    return entry


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

"""A cloud as the columns of a table, and back; and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..types import Cloud, Float64s

if TYPE_CHECKING:
    import open3d


Columns = Mapping[str, npt.NDArray[Any]]
"""Columns (n,) of a table by name."""


def cloud_columns(cloud: Cloud) -> dict[str, npt.NDArray[Any]]:
    """Columns by name: x y z (metres), nx ny nz, red green blue, confidence, views, sigma_mm.

    Positions are float32, or float64 where the coordinates are so large (UTM) that float32 would add to the points' own error.
    """
    points = cloud.points.astype("f8" if _needs_float64(cloud) else "f4")
    return {
        "x": points[:, 0],
        "y": points[:, 1],
        "z": points[:, 2],
        "nx": cloud.normals[:, 0],
        "ny": cloud.normals[:, 1],
        "nz": cloud.normals[:, 2],
        "red": cloud.colors[:, 0],
        "green": cloud.colors[:, 1],
        "blue": cloud.colors[:, 2],
        "confidence": cloud.confidence,
        "views": cloud.views,
        "sigma_mm": cloud.sigma_mm,
    }


def _needs_float64(cloud: Cloud) -> bool:
    """Is a step of float32, at the farthest coordinate, more than a tenth of the points' median error?"""
    if not len(cloud.points):
        return False
    farthest = max(abs(float(cloud.points.min())), abs(float(cloud.points.max())))
    step = float(np.spacing(np.float32(farthest)))
    return farthest > 0 and step > 0.1 * float(np.median(cloud.sigma_mm)) / 1000.0


def cloud_of(columns: Columns) -> Cloud:
    """The cloud that was passed to `cloud_columns`, with positions as they were stored."""
    return Cloud(
        points=np.column_stack([columns["x"], columns["y"], columns["z"]]),
        normals=np.column_stack([columns["nx"], columns["ny"], columns["nz"]]),
        colors=np.column_stack([columns["red"], columns["green"], columns["blue"]]),
        confidence=columns["confidence"],
        views=columns["views"],
        sigma_mm=columns["sigma_mm"],
    )


def point_cloud(cloud: Cloud) -> open3d.geometry.PointCloud:
    """The cloud for open3d: points in metres, normals, and colours from 0 to 1."""
    import open3d

    converted = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud.points.astype(np.float64)))
    converted.normals = open3d.utility.Vector3dVector(cloud.normals.astype(np.float64))
    converted.colors = open3d.utility.Vector3dVector(cloud.colors.astype(np.float64) / 255.0)
    return converted


def coordinate_step(points: Float64s) -> float:
    """Step of coordinates stored as integers: a power of ten, as fine as the resolution of float32 for points of this extent."""
    span = float(np.ptp(points, axis=0).max())
    if span <= 0:
        return 1e-4
    return float(10.0 ** np.floor(np.log10(span / 1e7)))  # float32 holds seven digits

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


def cloud_columns(cloud: Cloud) -> dict[str, npt.NDArray[Any]]:
    """Columns by name: x y z (metres), nx ny nz, red green blue, confidence, views, sigma_mm.

    Positions are float32, or float64 where the coordinates are so large (UTM) that float32 would add to the points' own error.
    """
    farthest = max(abs(float(cloud.points.min())), abs(float(cloud.points.max()))) if len(cloud.points) else 0.0
    needs_float64 = farthest > 0 and float(np.spacing(np.float32(farthest))) > 0.1 * float(np.median(cloud.sigma_mm)) / 1000.0
    return {
        **{name: cloud.points[:, i].astype("f8" if needs_float64 else "f4") for i, name in enumerate(("x", "y", "z"))},
        **{name: cloud.normals[:, i] for i, name in enumerate(("nx", "ny", "nz"))},
        **{name: cloud.colors[:, i] for i, name in enumerate(("red", "green", "blue"))},
        "confidence": cloud.confidence,
        "views": cloud.views,
        "sigma_mm": cloud.sigma_mm,
    }


def cloud_of(columns: Columns) -> Cloud:
    """The cloud that was passed to `cloud_columns`, with positions as they were stored."""
    groups = (("x", "y", "z"), ("nx", "ny", "nz"), ("red", "green", "blue"))
    points, normals, colors = (np.column_stack([columns[name] for name in names]) for names in groups)
    return Cloud(points, normals, colors, columns["confidence"], columns["views"], columns["sigma_mm"])


def point_cloud(cloud: Cloud) -> open3d.geometry.PointCloud:
    """The cloud for open3d: points in metres, normals, and colours from 0 to 1."""
    import open3d

    converted = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud.points.astype(np.float64)))
    converted.normals = open3d.utility.Vector3dVector(cloud.normals.astype(np.float64))
    converted.colors = open3d.utility.Vector3dVector(cloud.colors.astype(np.float64) / 255.0)
    return converted


def cloud_figures(cloud: Cloud) -> dict[str, Any]:
    """Corners of a cloud's bounding box."""
    return {"bounds": (tuple(cloud.points.min(axis=0).tolist()), tuple(cloud.points.max(axis=0).tolist()))}


def coordinate_step(points: Float64s) -> float:
    """Step of coordinates stored as integers: a power of ten, as fine as the resolution of float32 for points of this extent."""
    span = float(np.ptp(points, axis=0).max())
    return float(10.0 ** np.floor(np.log10(span / 1e7))) if span > 0 else 1e-4

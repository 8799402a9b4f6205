"""Clouds and meshes of other programs: LAS and LAZ, E57, PLY, PCD and XYZ; meshes are sampled to points."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..types import Float64s

CLOUDS = (".las", ".laz", ".e57", ".ply", ".pcd", ".xyz")
"""Suffixes of files that may hold points."""
MESHES = (".obj", ".stl", ".off")
"""Suffixes of files that hold triangles alone; a PLY may hold either."""
_SEED = 0
"""Seed of the points that are sampled on a mesh."""
_LEAST_SAMPLES = 1000
"""Smallest number of points that are sampled on a mesh."""
_MOST_SAMPLES = 20_000_000
"""Largest number of points that are sampled on a mesh: about a gigabyte."""


@dataclass(frozen=True)
class Scan:
    """Points sampled from a surface."""

    points: Float64s
    """(n, 3), metres."""
    epsg: int | None = None
    """EPSG code of the coordinate system, if the file states it."""


def read_scan(path: Path, spacing: float) -> Scan:
    """Return the points of a file with a suffix in `CLOUDS` or `MESHES`; spacing: metres between points sampled on a mesh.

    Raises ValueError if the file is of another kind, damaged, or without points; ImportError if a library is missing: laspy,
    lazrs or pyproj for LAS, pye57 for E57.
    """
    kind = path.suffix.lower()
    try:
        if kind in (".las", ".laz"):
            scan = _las(path)
        elif kind == ".e57":
            scan = _e57(path)
        elif kind in CLOUDS or kind in MESHES:
            scan = Scan(_open3d(path, kind, spacing))
        else:
            raise ValueError(f"its file name ends in none of {' '.join(CLOUDS + MESHES)}")
    except ImportError:
        raise
    except Exception as error:  # each library raises its own errors for damaged files
        raise ValueError(f"{path} cannot be read: {error}") from None
    points = scan.points[np.isfinite(scan.points).all(axis=1)]
    if not len(points):
        raise ValueError(f"{path} holds no points")
    return Scan(points, scan.epsg)


def _las(path: Path) -> Scan:
    import laspy

    las = laspy.read(path)
    crs = las.header.parse_crs()
    return Scan(np.asarray(las.xyz, np.float64), crs.to_epsg() if crs else None)


def _e57(path: Path) -> Scan:
    import pye57

    file = pye57.E57(str(path))
    parts = []
    for k in range(file.scan_count):
        scan = file.read_scan(k, ignore_missing_fields=True)
        parts.append(np.column_stack([scan[f"cartesian{axis}"] for axis in "XYZ"]).astype(np.float64))
    crs_name = ""
    if file.root.isDefined("coordinateMetadata"):
        crs_name = str(file.root["coordinateMetadata"].value())
    # other names, and descriptions in WKT, are not understood
    epsg = None
    code = crs_name.removeprefix("EPSG:")
    if crs_name.startswith("EPSG:") and code.isdigit():
        epsg = int(code)
    return Scan(np.vstack(parts), epsg)


def _open3d(path: Path, kind: str, spacing: float) -> Float64s:
    """(n, 3) points of a file: sampled on its triangles if it has some, else its own."""
    import open3d

    if kind in (".ply", *MESHES):
        mesh = _read(open3d.io.read_triangle_mesh, path)
        if len(mesh.triangles):
            open3d.utility.random.seed(_SEED)
            count = int(np.clip(mesh.get_surface_area() / spacing**2, _LEAST_SAMPLES, _MOST_SAMPLES))
            return np.asarray(mesh.sample_points_uniformly(count).points, np.float64)
    if kind in CLOUDS:
        return np.asarray(_read(open3d.io.read_point_cloud, path).points, np.float64)
    return np.zeros((0, 3))


def _read(function: Callable[[Path], Any], path: Path) -> Any:
    """Return what an open3d reader returns; raise ValueError where it only prints a message (truncated files)."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        result = function(path)
    if "failed" in printed.getvalue() or "Unable" in printed.getvalue():
        raise ValueError("it is damaged or cut short")
    return result

"""A cloud as E57 (ASTM E2807), by libE57Format: a scan of scaled integers, colours, normals, and confidence as intensity.

References: ASTM E2807-11, Standard Specification for 3D Imaging Data Exchange, 2011; surface normals: the extension E57_NOR of
libe57.org.
"""

from __future__ import annotations

import hashlib
import tempfile
import uuid
from pathlib import Path

import numpy as np
from pye57 import libe57

from ..io.clouds import coordinate_step
from ..types import Cloud, Float64s
from .world import Georeference

_NORMALS = "nor", "http://www.libe57.org/E57_NOR_surface_normals.txt"
_POINTS_AT_ONCE = 1_000_000
"""Points per write; they are in memory twice."""


def e57_bytes(cloud: Cloud, georeference: Georeference | None = None) -> bytes:
    """E57 of a cloud, in map coordinates if there is a georeference.  The same cloud gives the same bytes."""
    points = cloud.points.astype(np.float64)
    normals = cloud.normals.astype(np.float64)
    crs = ""
    if georeference is not None:
        normals = georeference.directions(points, normals)  # at the points of the local frame
        points = georeference.points(points)
        crs = f"EPSG:{georeference.epsg}"
    colors = cloud.colors.astype(np.float64)
    columns: dict[str, Float64s] = {
        "cartesianX": points[:, 0],
        "cartesianY": points[:, 1],
        "cartesianZ": points[:, 2],
        "colorRed": colors[:, 0],
        "colorGreen": colors[:, 1],
        "colorBlue": colors[:, 2],
        "intensity": cloud.confidence.astype(np.float64),
        "nor:normalX": normals[:, 0],
        "nor:normalY": normals[:, 1],
        "nor:normalZ": normals[:, 2],
    }
    with tempfile.TemporaryDirectory() as folder:  # the library writes files only
        path = Path(folder) / "cloud.e57"
        _write(str(path), columns, points, crs)
        return path.read_bytes()


def _write(path: str, columns: dict[str, Float64s], points: Float64s, crs: str) -> None:
    """Write the file.  columns: attributes of the points by name; points (n, 3), crs: as for `_add_scan`."""
    file = libe57.ImageFile(path, "w")
    try:
        # the same cloud gets the same identifier
        content = b"".join(values.tobytes() for values in columns.values())
        guid = uuid.UUID(bytes=hashlib.sha256(content).digest()[:16])
        scan = _add_scan(file, points, str(guid), crs)
        # the library reads from buffers that it was given once
        buffers = libe57.VectorSourceDestBuffer()
        chunk = {}
        for name in columns:
            values = np.empty(_POINTS_AT_ONCE)
            chunk[name] = values
            buffers.append(libe57.SourceDestBuffer(file, name, values, _POINTS_AT_ONCE, True, True))
        writer = scan.writer(buffers)
        for start in range(0, len(points), _POINTS_AT_ONCE):
            count = min(_POINTS_AT_ONCE, len(points) - start)
            for name, values in chunk.items():
                values[:count] = columns[name][start : start + count]
            writer.write(count)
        writer.close()
    finally:
        file.close()


def _add_scan(file: libe57.ImageFile, points: Float64s, guid: str, crs: str) -> libe57.CompressedVectorNode:
    """Build the node tree of the file, and return the node for its points (n, 3).

    guid: identifies the cloud; crs: the coordinate system, "" for a local one.
    """
    file.extensionsAdd("", libe57.E57_V1_0_URI)
    file.extensionsAdd(*_NORMALS)
    root = file.root()
    root.set("formatName", libe57.StringNode(file, "ASTM E57 3D Imaging Data File"))
    root.set("guid", libe57.StringNode(file, f"{{{guid}}}"))
    root.set("versionMajor", libe57.IntegerNode(file, libe57.E57_FORMAT_MAJOR))
    root.set("versionMinor", libe57.IntegerNode(file, libe57.E57_FORMAT_MINOR))
    root.set("coordinateMetadata", libe57.StringNode(file, crs))
    scans = libe57.VectorNode(file, True)
    root.set("data3D", scans)
    root.set("images2D", libe57.VectorNode(file, True))
    scan = libe57.StructureNode(file)
    scan.set("guid", libe57.StringNode(file, f"{{{guid}-0}}"))
    scan.set("name", libe57.StringNode(file, "cloud"))
    scan.set("description", libe57.StringNode(file, "wbflow; intensity is the confidence of a point, 0 to 1"))
    low = points.min(axis=0)
    high = points.max(axis=0)
    step = coordinate_step(points)
    bounds = libe57.StructureNode(file)
    colours = libe57.StructureNode(file)
    intensities = libe57.StructureNode(file)
    prototype = libe57.StructureNode(file)
    for k, axis in enumerate("XYZ"):
        bounds.set(f"{axis.lower()}Minimum", libe57.FloatNode(file, float(low[k])))
        bounds.set(f"{axis.lower()}Maximum", libe57.FloatNode(file, float(high[k])))
        offset = float(np.floor(low[k]))
        most_steps = int(np.ceil((high[k] - offset) / step)) + 1
        prototype.set(f"cartesian{axis}", libe57.ScaledIntegerNode(file, 0, 0, most_steps, step, offset))
    for name in ("colorRed", "colorGreen", "colorBlue"):
        prototype.set(name, libe57.IntegerNode(file, 0, 0, 255))
        colours.set(f"{name}Minimum", libe57.IntegerNode(file, 0))
        colours.set(f"{name}Maximum", libe57.IntegerNode(file, 255))
    prototype.set("intensity", libe57.FloatNode(file, 0.0, libe57.E57_SINGLE, 0.0, 1.0))
    for axis in "XYZ":
        prototype.set(f"nor:normal{axis}", libe57.FloatNode(file, 0.0, libe57.E57_SINGLE, -1.0, 1.0))
    intensities.set("intensityMinimum", libe57.FloatNode(file, 0.0))
    intensities.set("intensityMaximum", libe57.FloatNode(file, 1.0))
    scan.set("cartesianBounds", bounds)
    scan.set("colorLimits", colours)
    scan.set("intensityLimits", intensities)
    points_node = libe57.CompressedVectorNode(file, prototype, libe57.VectorNode(file, True))
    scan.set("points", points_node)
    scans.append(scan)
    return points_node

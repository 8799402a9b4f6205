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
    points, normals = cloud.points.astype(np.float64), cloud.normals.astype(np.float64)
    crs = ""
    if georeference is not None:
        points, normals = georeference.points(points), georeference.directions(points, normals)
        crs = f"EPSG:{georeference.epsg}"
    columns: dict[str, Float64s] = {
        **{f"cartesian{axis}": points[:, k] for k, axis in enumerate("XYZ")},
        **{f"color{name}": cloud.colors[:, k].astype(np.float64) for k, name in enumerate(("Red", "Green", "Blue"))},
        "intensity": cloud.confidence.astype(np.float64),
        **{f"nor:normal{axis}": normals[:, k] for k, axis in enumerate("XYZ")},
    }
    with tempfile.TemporaryDirectory() as folder:  # the library writes files only
        path = Path(folder) / "cloud.e57"
        _write(str(path), columns, points, crs)
        return path.read_bytes()


def _write(path: str, columns: dict[str, Float64s], points: Float64s, crs: str) -> None:
    file = libe57.ImageFile(path, "w")
    try:
        guid = uuid.UUID(bytes=hashlib.sha256(b"".join(c.tobytes() for c in columns.values())).digest()[:16])
        scan = _add_scan(file, columns, points, str(guid), crs)
        buffers, chunk = libe57.VectorSourceDestBuffer(), {name: np.empty(_POINTS_AT_ONCE) for name in columns}
        for name, values in chunk.items():
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


def _add_scan(
    file: libe57.ImageFile, columns: dict[str, Float64s], points: Float64s, guid: str, crs: str
) -> libe57.CompressedVectorNode:
    """Builds the node tree of the file, and returns the node for its points (n, 3).

    columns: attributes of the points; guid: identifies the cloud; crs: the coordinate system, "" for a local one.
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
    low, high, step = points.min(axis=0), points.max(axis=0), coordinate_step(points)
    bounds, colours, intensities = (libe57.StructureNode(file) for _ in range(3))
    prototype = libe57.StructureNode(file)
    for k, axis in enumerate("XYZ"):
        bounds.set(f"{axis.lower()}Minimum", libe57.FloatNode(file, float(low[k])))
        bounds.set(f"{axis.lower()}Maximum", libe57.FloatNode(file, float(high[k])))
        offset = float(np.floor(low[k]))
        most_steps = int(np.ceil((high[k] - offset) / step)) + 1
        prototype.set(f"cartesian{axis}", libe57.ScaledIntegerNode(file, 0, 0, most_steps, step, offset))
    for name in (name for name in columns if name.startswith("color")):
        prototype.set(name, libe57.IntegerNode(file, 0, 0, 255))
        colours.set(f"{name}Minimum", libe57.IntegerNode(file, 0))
        colours.set(f"{name}Maximum", libe57.IntegerNode(file, 255))
    for name, minimum in (("intensity", 0.0), *((f"nor:normal{axis}", -1.0) for axis in "XYZ")):
        prototype.set(name, libe57.FloatNode(file, 0.0, libe57.E57_SINGLE, minimum, 1.0))
    intensities.set("intensityMinimum", libe57.FloatNode(file, 0.0))
    intensities.set("intensityMaximum", libe57.FloatNode(file, 1.0))
    for name, node in (("cartesianBounds", bounds), ("colorLimits", colours), ("intensityLimits", intensities)):
        scan.set(name, node)
    points_node = libe57.CompressedVectorNode(file, prototype, libe57.VectorNode(file, True))
    scan.set("points", points_node)
    scans.append(scan)
    return points_node

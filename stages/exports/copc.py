"""A cloud as Cloud Optimized Point Cloud: LAZ 1.4 whose points lie in an octree, so that viewers fetch only what they show.

References: Hobu, COPC Specification 1.0, 2021.
"""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

import copclib
import laspy
import numpy as np

from .octree import CELLS, LEAST_SIDE, octree


def copc_bytes(laz: bytes) -> bytes:
    """Return the same points, attributes and CRS as COPC.  laz: LAZ 1.4 of point format 6, 7 or 8, not empty."""
    las = laspy.read(io.BytesIO(laz))
    points = np.column_stack([las.x, las.y, las.z]).astype(np.float64)
    records = las.points.array.view(np.int8).reshape(len(points), -1)  # (n, bytes of a point)
    with tempfile.TemporaryDirectory() as folder:  # the library reads and writes files only
        source = Path(folder) / "cloud.laz"
        target = Path(folder) / "cloud.copc.laz"
        source.write_bytes(laz)

        # 1. A writer with the form of the points, the scale and the CRS of the source.
        config = copclib.LazReader(str(source)).laz_config
        crs = las.header.parse_crs()
        wkt = ""
        if crs:
            wkt = crs.to_wkt("WKT1_GDAL")  # plain ASCII: the library miscounts the bytes of other characters
        args = (config.las_header.point_format_id, config.las_header.scale, config.las_header.offset, wkt, config.extra_bytes_vlr)
        writer = copclib.FileWriter(str(target), copclib.CopcConfigWriter(*args))

        # 2. What the writer does not take over by itself, and the cube of the octree.
        low = points.min(axis=0)
        side = max(float(np.ptp(points, axis=0).max()), LEAST_SIDE)
        header = writer.copc_config.las_header
        info = writer.copc_config.copc_info
        for name in ("min", "max", "creation_day", "creation_year", "generating_software", "system_identifier"):
            setattr(header, name, getattr(config.las_header, name))
        info.center_x, info.center_y, info.center_z = (low + side / 2).tolist()
        info.halfsize = side / 2
        info.spacing = side / CELLS

        # 3. The nodes, each with the bytes of its points as they are.
        for key, rows in octree(points, low, side):
            writer.AddNode(copclib.VoxelKey(*key), copclib.VectorChar(np.ascontiguousarray(records[rows]).ravel()))
        writer.Close()
        return target.read_bytes()

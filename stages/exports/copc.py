"""A cloud as Cloud Optimized Point Cloud: LAZ 1.4 whose points lie in an octree, so that viewers fetch only what they show.

References
----------
Hobu, COPC Specification 1.0, 2021.
"""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterator
from pathlib import Path

import copclib
import laspy
import numpy as np

from ..types import Float64s, Int64s

CELLS = 128
"""A node keeps one point for each of so many cells along an axis, and hands the others down."""
MOST_IN_LEAF = 20_000
"""A node with fewer points keeps them all."""

Key = tuple[int, int, int, int]
"""Level, and the node's place along x, y and z on it."""


def copc_bytes(laz: bytes) -> bytes:
    """Return the same points, attributes and CRS as COPC.  laz: LAZ 1.4 of point format 6, 7 or 8, not empty."""
    las = laspy.read(io.BytesIO(laz))
    points = np.column_stack([las.x, las.y, las.z]).astype(np.float64)
    records = las.points.array.view(np.int8).reshape(len(points), -1)
    with tempfile.TemporaryDirectory() as folder:  # the library reads and writes files only
        source, target = Path(folder) / "cloud.laz", Path(folder) / "cloud.copc.laz"
        source.write_bytes(laz)
        like = copclib.LazReader(str(source)).laz_config
        crs = las.header.parse_crs()
        wkt = crs.to_wkt("WKT1_GDAL") if crs else ""  # plain ASCII: the library miscounts the bytes of other characters
        form = (like.las_header.point_format_id, like.las_header.scale, like.las_header.offset, wkt, like.extra_bytes_vlr)
        writer = copclib.FileWriter(str(target), copclib.CopcConfigWriter(*form))
        low, side = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-3)
        _describe(writer.copc_config, like.las_header, low, side)
        for key, rows in octree(points, low, side):
            writer.AddNode(copclib.VoxelKey(*key), copclib.VectorChar(np.ascontiguousarray(records[rows]).ravel()))
        writer.Close()
        return target.read_bytes()


def _describe(config: copclib.CopcConfigWriter, like: copclib.LasHeader, low: Float64s, side: float) -> None:
    """Fill in the header and the cube of the octree."""
    header, info = config.las_header, config.copc_info
    for name in ("min", "max", "creation_day", "creation_year", "generating_software", "system_identifier"):
        setattr(header, name, getattr(like, name))
    info.center_x, info.center_y, info.center_z = (low + side / 2).tolist()
    info.halfsize, info.spacing = side / 2, side / CELLS


def octree(points: Float64s, low: Float64s, side: float) -> Iterator[tuple[Key, Int64s]]:
    """Yield each node of an octree with the rows (n,) of the points (n, 3) that it keeps.

    low, side: corner (3,) and edge of its cube.  Each point is in one node; those of a node are spread evenly over it.
    """
    pending: list[tuple[Key, Int64s]] = [((0, 0, 0, 0), np.arange(len(points)))]
    while pending:
        (level, *place), rows = pending.pop()
        edge = side / 2**level
        at = np.clip((points[rows] - low) / edge - place, 0, 1 - 1e-9)
        if len(rows) > MOST_IN_LEAF:
            i, j, k = (at * CELLS).astype(np.int64).T
            kept = np.sort(np.unique((i * CELLS + j) * CELLS + k, return_index=True)[1])
        else:
            kept = np.arange(len(rows))
        yield (level, *place), rows[kept]  # type: ignore[misc]
        left = np.setdiff1d(np.arange(len(rows)), kept, assume_unique=True)
        half = (at[left] * 2).astype(np.int64)
        for child in np.unique(half, axis=0):
            inside = rows[left[(half == child).all(axis=1)]]
            x, y, z = (2 * np.array(place) + child).tolist()
            pending.append(((level + 1, x, y, z), inside))

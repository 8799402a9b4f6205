"""A cloud as 3D Tiles: an octree of point clouds that Cesium and iTowns stream.

References: OGC 18-053r2, 3D Tiles Specification 1.0, 2019.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..types import Cloud, Float64s, Int64s
from .octree import CELLS, LEAST_SIDE, Key, octree

_HEADER = struct.Struct("<4s6I")
"""Header of a tile: magic, version, bytes in all, and the bytes of each of the two parts of both tables."""
_ALIGNMENT = 8
"""Tables begin at multiples of this many bytes."""


def tile_files(cloud: Cloud, to_earth: Float64s | None = None) -> Iterator[tuple[str, bytes]]:
    """Yield the tiles of a cloud that is not empty, and tileset.json, which names them.

    to_earth: (4, 4) from world points to geocentric coordinates (EPSG 4978); None: the site is not georeferenced.
    """
    points = cloud.points.astype(np.float64)
    low = points.min(axis=0)
    side = max(float(np.ptp(points, axis=0).max()), LEAST_SIDE)

    # 1. A tile for each node of the octree; the octree yields parents before their children.
    tiles: dict[Key, dict[str, Any]] = {}
    for key, rows in octree(points, low, side):
        level, *index = key
        edge = side / 2**level
        name = f"{'-'.join(map(str, key))}.pnts"
        # a box is its centre and three half axes
        centre = low + edge * (np.array(index) + 0.5)
        half_axes = np.eye(3) * edge / 2
        box = [*centre, *half_axes.ravel()]
        tiles[key] = {"boundingVolume": {"box": box}, "geometricError": 0.0, "content": {"uri": name}}
        if level:
            parent = tiles[level - 1, index[0] // 2, index[1] // 2, index[2] // 2]
            parent.setdefault("children", []).append(tiles[key])
            parent["geometricError"] = 2 * edge / CELLS  # the spacing of its points: viewers load children if it is too coarse
        yield name, _tile(cloud, rows)

    # 2. The tileset: the root, which holds all others.
    root = tiles[0, 0, 0, 0] | {"refine": "ADD"}
    if to_earth is not None:
        root["transform"] = to_earth.T.ravel().tolist()  # column-major
    tileset = {"asset": {"version": "1.0"}, "geometricError": side, "root": root}
    yield "tileset.json", (json.dumps(tileset, indent=1) + "\n").encode()


def _tile(cloud: Cloud, rows: Int64s) -> bytes:
    """One tile: a header, the feature table (what is drawn) and the batch table (what belongs to each point besides)."""
    feature_columns = {
        "POSITION": cloud.points[rows].astype("<f4"),
        "RGB": cloud.colors[rows].astype(np.uint8),
    }
    batch_columns = {
        "confidence": cloud.confidence[rows].astype("<f4"),
        "sigma_mm": cloud.sigma_mm[rows].astype("<f4"),
    }
    # the first table begins after the header, the second where the first ends, at a multiple of the alignment
    feature_table = _table({"POINTS_LENGTH": len(rows)}, feature_columns, {}, _HEADER.size)
    tables = [*feature_table, *_table({}, batch_columns, {"componentType": "FLOAT", "type": "SCALAR"}, 0)]
    lengths = [len(table) for table in tables]
    return b"".join([_HEADER.pack(b"pnts", 1, _HEADER.size + sum(lengths), *lengths), *tables])


def _table(header: dict[str, Any], columns: Mapping[str, Any], column_type: Mapping[str, str], start: int) -> tuple[bytes, bytes]:
    """The two parts of a table of columns: the JSON `header` with entries of the columns, and the bytes that these refer to.

    column_type: added to the entry of each column; start: bytes before the table since the last multiple of `_ALIGNMENT`.
    """
    data = b""
    for name, values in columns.items():
        header[name] = {"byteOffset": len(data), **column_type}
        data += values.tobytes()
    # the format asks for spaces after text and zeros after data
    text = json.dumps(header).encode()
    text += b" " * (-(start + len(text)) % _ALIGNMENT)
    data += bytes(-len(data) % _ALIGNMENT)
    return text, data

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
from .octree import CELLS, Key, octree

_HEADER = struct.Struct("<4s6I")
_ALIGNMENT = 8
"""Tables begin at multiples of this many bytes."""


def tile_files(cloud: Cloud, to_earth: Float64s | None = None) -> Iterator[tuple[str, bytes]]:
    """Yield the tiles of a cloud that is not empty, and tileset.json, which names them.

    to_earth: (4, 4) from world points to geocentric coordinates (EPSG 4978); None: the site is not georeferenced.
    """
    points = cloud.points.astype(np.float64)
    low, side = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-3)
    tiles: dict[Key, dict[str, Any]] = {}
    for key, rows in octree(points, low, side):
        level, *index = key
        edge, name = side / 2**level, f"{'-'.join(map(str, key))}.pnts"
        box = [*(low + edge * (np.array(index) + 0.5)), *(np.eye(3) * edge / 2).ravel()]
        tiles[key] = {"boundingVolume": {"box": box}, "geometricError": 0.0, "content": {"uri": name}}
        if level:
            parent = tiles[level - 1, index[0] // 2, index[1] // 2, index[2] // 2]
            parent.setdefault("children", []).append(tiles[key])
            parent["geometricError"] = 2 * edge / CELLS  # the spacing of its points: viewers load children if it is too coarse
        yield name, _tile(cloud, rows)
    root = tiles[0, 0, 0, 0] | {"refine": "ADD"}
    if to_earth is not None:
        root["transform"] = to_earth.T.ravel().tolist()  # column-major
    tileset = {"asset": {"version": "1.0"}, "geometricError": side, "root": root}
    yield "tileset.json", (json.dumps(tileset, indent=1) + "\n").encode()


def _tile(cloud: Cloud, rows: Int64s) -> bytes:
    feature_columns = {"POSITION": cloud.points[rows].astype("<f4"), "RGB": cloud.colors[rows].astype(np.uint8)}
    batch_columns = {"confidence": cloud.confidence[rows].astype("<f4"), "sigma_mm": cloud.sigma_mm[rows].astype("<f4")}
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
    text = json.dumps(header).encode()
    return text + b" " * (-(start + len(text)) % _ALIGNMENT), data + bytes(-len(data) % _ALIGNMENT)

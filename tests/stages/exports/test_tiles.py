"""3D Tiles, read back as specified, and with py3dtiles if that is installed (it requires an older numpy)."""

from __future__ import annotations

import itertools
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.stages.exports.test_colmap import cloud_of
from tests.stages.exports.test_maps import LOCAL, hill
from wbflow_stages.exports.octree import MOST_IN_LEAF
from wbflow_stages.exports.tiles import tile_files
from wbflow_stages.types import Cloud

CLOUD = cloud_of(hill(count=4 * MOST_IN_LEAF))


def columns_of(tile: bytes) -> np.ndarray:
    """(n, 8) position, colour, confidence and sigma_mm of a tile's points."""
    magic, version, length, *lengths = struct.unpack_from("<4s6I", tile)
    assert (magic, version, length) == (b"pnts", 1, len(tile))
    begins = 28 + np.cumsum([0, *lengths])
    assert not (begins[[1, 2, 4]] % 8).any(), "binary parts, and the tile's end, lie at multiples of 8 bytes"
    feature_json, feature_data, batch_json, batch_data = (tile[a:b] for a, b in itertools.pairwise(begins))
    feature_table, batch_table = json.loads(feature_json), json.loads(batch_json)
    n = feature_table["POINTS_LENGTH"]

    def column(part: bytes, entry: dict[str, Any], kind: str, width: int) -> np.ndarray:
        return np.frombuffer(part, kind, n * width, entry["byteOffset"]).reshape(n, width)

    positions, colors = (
        column(feature_data, feature_table["POSITION"], "<f4", 3),
        column(feature_data, feature_table["RGB"], "u1", 3),
    )
    return np.hstack(
        [positions, colors, *(column(batch_data, batch_table[name], "<f4", 1) for name in ("confidence", "sigma_mm"))]
    )


def as_rows(cloud: Cloud) -> np.ndarray:
    return np.column_stack([cloud.points, cloud.colors, cloud.confidence, cloud.sigma_mm]).astype(np.float32)


def sort(rows: np.ndarray) -> np.ndarray:
    return rows[np.lexsort(rows.T)]


def walk(tile: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield tile
    for child in tile.get("children", []):
        yield from walk(child)


def test_tiles_hold_every_point_once_in_its_box_and_the_root_covers_all() -> None:
    files = dict(tile_files(CLOUD))
    tileset = json.loads(files.pop("tileset.json"))
    assert tileset["asset"]["version"] == "1.0"
    assert tileset["root"]["refine"] == "ADD"
    parts = []
    for tile in walk(tileset["root"]):
        parts.append(columns_of(files.pop(tile["content"]["uri"])))
        middle, half = np.array(tile["boundingVolume"]["box"][:3]), tile["boundingVolume"]["box"][3]
        assert (np.abs(parts[-1][:, :3] - middle) <= half + 1e-5).all()
        assert all(child["geometricError"] < tile["geometricError"] for child in tile.get("children", []))
    assert not files, "each tile is named once"
    assert np.array_equal(sort(np.vstack(parts)), sort(as_rows(CLOUD)))
    assert 0.02 < len(parts[0]) / len(CLOUD.points) < 0.5
    assert np.histogram(parts[0][:, 0], 10)[0].min() > 0.5 * len(parts[0]) / 10, "the coarse part covers all of the ramp alike"
    assert dict(tile_files(CLOUD)) == dict(tile_files(CLOUD))


def test_tiles_are_placed_on_the_globe_at_the_site() -> None:
    pyproj = pytest.importorskip("pyproj")
    from wbflow_stages.exports.world import georeference

    place = georeference(LOCAL)
    files = dict(tile_files(CLOUD, place.to_earth()))
    transform = np.reshape(json.loads(files["tileset.json"])["root"]["transform"], (4, 4)).T
    x, y, z, _ = transform @ [190.0, 90.0, 5.0, 1.0]
    found = pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(x, y, z)
    assert found == pytest.approx(place.degrees([190.0, 90.0, 5.0]), abs=1e-7)


def test_py3dtiles_reads_the_tiles_back(tmp_path: Path) -> None:
    pytest.importorskip("py3dtiles")
    from py3dtiles.tileset import TileSet

    for name, data in tile_files(CLOUD):
        (tmp_path / name).write_bytes(data)
    root = TileSet.from_file(tmp_path / "tileset.json").root_tile
    found = [tile.get_or_fetch_content(tmp_path).to_points(None) for tile in (root, *root.get_all_children())]
    extra = [[part.extra_fields[name] for part in found] for name in ("confidence", "sigma_mm")]
    rows = np.column_stack(
        [np.vstack([p.positions for p in found]), np.vstack([p.colors for p in found]), *map(np.hstack, extra)]
    )
    assert np.array_equal(sort(rows.astype(np.float32)), sort(as_rows(CLOUD)))

"""Points of the report's 3-D view: few enough to rotate smoothly, spread like the cloud, with its positions and colours."""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from wbflow_stages.exports.view import changes_view, cloud_view, track_view
from wbflow_stages.types import NEW, SAME, VANISHED, Changes, Cloud, GroundGrid, ObservedPoses


def bowl(count: int) -> Cloud:
    """Points on a bowl 20 m wide, redder to the east."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-10, 10, (2, count))
    points = np.column_stack([x, y, 0.05 * (x**2 + y**2)])
    colors = np.column_stack([12 * (x + 10), np.full((count, 2), 40)]).astype(np.uint8)
    normals = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    ones = np.ones(count, np.float32)
    return Cloud(points, normals, colors, 0.5 * ones, (3 * ones).astype(np.uint16), 10 * ones)


def unpacked(stream: bytes) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Header, positions (n, 3) and colours (n, 3), decoded as in the browser."""
    (length,) = struct.unpack_from("<I", stream)
    head = json.loads(stream[4 : 4 + length])
    planes = np.frombuffer(zlib.decompress(stream[4 + length :]), np.uint8).reshape(-1, head["n"])
    differences = planes[0:3].astype(np.uint16) | planes[3:6].astype(np.uint16) << 8
    places = np.cumsum(differences, axis=1, dtype=np.uint16).T * head["step"] + head["low"]
    return head, places, planes[6:9].T


def test_uncertainties_beyond_the_colour_scale_keep_their_values() -> None:
    sigma = np.geomspace(2, 5000, 3000).astype(np.float32)  # millimetres; only the last three exceed 500
    sigma[sigma > 500] = 10
    sigma[-3:] = 700, 2000, 5000
    stream = cloud_view(replace(bowl(3000), sigma_mm=sigma))
    head, places, _ = unpacked(stream)
    (layer,) = (one for one in head["layers"] if one["name"] == "sigma")
    coded = np.frombuffer(zlib.decompress(stream[4 + struct.unpack_from("<I", stream)[0] :]), np.uint8).reshape(-1, 3000)[-1]
    known = layer["least"] * (layer["most"] / layer["least"]) ** (coded / 255)
    _, nearest = cKDTree(bowl(3000).points).query(places)
    assert layer["high"] < 500 and np.allclose(known, sigma[nearest], rtol=0.02)


def test_a_small_cloud_is_shown_point_by_point() -> None:
    cloud = bowl(5000)
    head, places, colors = unpacked(cloud_view(cloud))
    distance, nearest = cKDTree(cloud.points).query(places)
    assert head["n"] == head["total"] == 5000 and sorted(nearest) == list(range(5000))
    assert distance.max() < head["step"] and np.array_equal(colors, cloud.colors[nearest])


@pytest.mark.parametrize("count", [30_000, 400_000])
def test_a_large_cloud_is_thinned_to_evenly_spread_means(count: int) -> None:
    cloud, most = bowl(count), 10_000
    head, places, colors = unpacked(cloud_view(cloud, most))
    assert 0.8 * most < head["n"] <= most and head["total"] == count
    assert cKDTree(places).query(cloud.points)[0].max() < 3 * head["voxel"]
    distance, nearest = cKDTree(cloud.points).query(places)
    assert distance.max() < head["voxel"]
    assert np.abs(colors[:, 0].astype(float) - cloud.colors[nearest, 0]).max() < 12 * 2 * head["voxel"] + 1


def compared(points: np.ndarray, label: np.ndarray, blob: np.ndarray) -> Changes:
    """A comparison of nights with these points (n, 3), labels and changes."""
    flat = np.zeros(len(points), np.float32)
    grey = np.full((len(points), 3), 90, np.uint8)
    grid = GroundGrid(np.eye(3), 0.0, 0.0, 1.0, 1, 1)
    labels = label.astype(np.uint8), blob.astype(np.uint16)
    return Changes(True, {}, points, grey, flat, flat, flat, *labels, grid, np.zeros((1, 1), np.float32))


def test_the_stream_of_changes_has_what_is_unchanged_around_what_is_new() -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(100.0), np.arange(100.0)))
    points = np.column_stack([x, y, np.zeros(len(x))])
    label = np.where((x < 10) & (y < 10), NEW, SAME)
    label[x > 90] = VANISHED
    stream = changes_view(compared(points, label, label != SAME))
    head, places, _ = unpacked(stream)
    (layer,) = head["layers"]
    coded = np.frombuffer(zlib.decompress(stream[4 + struct.unpack_from("<I", stream)[0] :]), np.uint8).reshape(-1, head["n"])[-1]
    kind = layer["low"] + (layer["high"] - layer["low"]) * coded / 255
    assert head["voxel"] == pytest.approx(1.0), "the spacing of the points, not of the site"
    assert head["total"] == 100 + 900
    assert [np.count_nonzero(np.rint(kind) == k) for k in (0, 2)] == [100, 900]
    unchanged = places[np.rint(kind) == 1]
    assert 0 < len(unchanged) < 300
    assert cKDTree(points[label == NEW]).query(unchanged)[0].max() <= 6.01


def test_a_night_without_changes_has_an_empty_stream() -> None:
    points = np.zeros((50, 3))
    stream = changes_view(compared(points, np.full(50, SAME), np.zeros(50)))
    assert json.loads(stream[4 : 4 + struct.unpack_from("<I", stream)[0]])["n"] == 0


def test_a_track_is_shown_from_its_blue_beginning_to_its_red_end() -> None:
    track = np.column_stack([np.linspace(313_000, 313_100, 500), np.full(500, 5_154_000.0), np.full(500, 15.0)])
    head, points, colors = unpacked(track_view(ObservedPoses({}, track=track)))
    assert head["n"] == head["total"] == 500 and head["layers"] == []
    order = np.argsort(points[:, 0])
    assert points[order] == pytest.approx(track, abs=0.002)
    assert colors[order[0]].tolist() == [60, 120, 255] and colors[order[-1]].tolist() == [255, 70, 40]
    assert head["voxel"] == pytest.approx(0.4, rel=0.01)


def test_a_track_of_no_places_is_an_empty_stream() -> None:
    stream = track_view(ObservedPoses({}))
    (length,) = struct.unpack_from("<I", stream)
    assert json.loads(stream[4 : 4 + length])["n"] == 0

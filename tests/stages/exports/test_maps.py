"""Height maps, depth maps and clouds in map coordinates can be read back with other libraries."""

from __future__ import annotations

import datetime
import io
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.stages.exports.test_colmap import cloud_of
from wbflow_stages.exports.forms import depth_files
from wbflow_stages.exports.heights import height_map
from wbflow_stages.io.rasters import geotiff, stepped
from wbflow_stages.types import DepthMap

LOCAL = "+proj=topocentric +ellps=WGS84 +lat_0=53.541 +lon_0=9.966 +h_0=52.0"
DAY = datetime.date(2026, 3, 1)


def read_pfm(data: bytes, shape: tuple[int, int]) -> np.ndarray:
    assert data.startswith(f"Pf\n{shape[1]} {shape[0]}\n-1.0\n".encode())
    return np.frombuffer(data[-4 * shape[0] * shape[1] :], "<f4").reshape(shape)[::-1]


def hill(seed: int = 0, count: int = 40_000) -> np.ndarray:
    """A ramp of 20 x 10 that rises by 0.1 per unit to the east, with a pole at (15.05, 8.05) whose top is at 3."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 20, count), rng.uniform(0, 10, count)
    pole = np.column_stack([np.full(50, 15.05), np.full(50, 8.05), np.linspace(1.5, 3.0, 50)])
    return np.vstack([np.column_stack([x, y, 0.1 * x]), pole])


def test_a_height_map_shows_the_ramp_and_the_pole_with_north_up() -> None:
    found = height_map(hill(), cell=0.5)
    assert found.heights.shape == (20, 40)
    assert (found.left, found.top, found.left_out) == (0.0, 10.0, 0)
    middles = 0.25 + 0.5 * np.arange(40)
    assert np.nanmax(np.abs(found.heights[5:] - 0.1 * middles)) < 0.03
    row, column = np.unravel_index(np.nanargmax(found.heights), found.heights.shape)
    assert (found.left + 0.5 * column, found.top - 0.5 * row) == (15.0, 8.5), "the corner above the pole"


def test_cells_of_two_nights_coincide_and_far_points_do_not_stretch_the_map() -> None:
    one, other = height_map(hill()), height_map(np.vstack([hill(1)[500:], [[1e5, 0.0, 0.0]]]))
    assert one.cell == other.cell
    assert math.isclose((one.left - other.left) / one.cell % 1, 0, abs_tol=1e-6)
    assert other.left_out == 1
    assert other.heights.shape[0] == one.heights.shape[0]
    assert other.heights.shape[1] < 1.2 * one.heights.shape[1]


@pytest.mark.parametrize("span", [1e-3, 0.7, 65.0, 66.0, 12_345.0])
def test_steps_use_most_of_the_16_bit_range_and_never_exceed_it(span: float) -> None:
    values, steps = stepped(np.array([[3.0, 3.0 + span, np.nan]]), 3.0)
    assert values[0, 0] == 1
    assert 65_535 / 2.6 < values[0, 1] <= 65_535
    assert values[0, 2] == 0
    assert values[0, 1] - 1 == pytest.approx(span * steps, abs=0.51)


def test_depth_that_is_not_sure_is_left_out() -> None:
    depth = np.linspace(2, 40, 12, dtype=np.float32).reshape(3, 4)
    sure = np.ones((3, 4), bool)
    sure[1, 2] = False
    files, steps = depth_files(DepthMap(depth, depth, depth, depth, np.ones((3, 4), np.uint32), ("roof",), sure))
    png = cv2.imdecode(np.frombuffer(files[".png"], np.uint8), cv2.IMREAD_UNCHANGED)
    assert png is not None and steps == 1000
    assert np.array_equal(png > 0, sure)
    assert np.abs((png[sure] - 1.0) / steps - depth[sure]).max() <= 0.51e-3
    pfm = read_pfm(files[".pfm"], (3, 4))
    assert np.array_equal(pfm[sure], depth[sure])
    assert np.isinf(pfm[~sure]).all()


def test_the_georeferenced_origin_is_at_the_stated_place_and_lengths_are_kept() -> None:
    pyproj = pytest.importorskip("pyproj")
    from wbflow_stages.exports.world import georeference

    found = georeference(LOCAL)
    X = np.array([[0.0, 0, 0], [0, 100, 0], [0, 0, 25]])
    moved = found.points(X)
    back = pyproj.Transformer.from_crs(found.epsg, 4326, always_xy=True).transform(*moved[0, :2])
    assert found.epsg == 32632
    assert back == pytest.approx((9.966, 53.541), abs=1e-8)
    assert moved[:, 2] == pytest.approx([52.0, 52.0, 77.0], abs=1e-3)
    grid_scale = np.linalg.norm(moved[1] - moved[0]) / 100
    assert abs(grid_scale - 1) < 5e-4, "a UTM zone's scale is off by 0.4 per mille at most here"
    up = found.directions(X, np.tile([0.0, 0, 1], (3, 1)))
    assert np.abs(up - [0, 0, 1]).max() < 1e-4


@pytest.mark.parametrize("crs", ["EPSG:25832", LOCAL.replace("53.541", "88.0")])
def test_frames_that_are_not_local_or_lie_near_a_pole_are_refused(crs: str) -> None:
    pytest.importorskip("pyproj")
    from wbflow_stages.exports.world import georeference

    with pytest.raises(ValueError, match=r"local frame|latitude 88"):
        georeference(crs)


@pytest.mark.parametrize("crs", ["", LOCAL])
def test_laspy_reads_the_cloud_back(crs: str) -> None:
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    from wbflow_stages.exports.las import laz_bytes
    from wbflow_stages.exports.world import georeference

    cloud = cloud_of(hill(count=2000))
    on_map = georeference(crs) if crs else None
    data = laz_bytes(cloud, DAY, on_map)
    las = laspy.read(io.BytesIO(data))
    expected = on_map.points(cloud.points.astype(float)) if on_map else cloud.points
    assert np.abs(las.xyz - expected).max() < 1e-5
    assert np.array_equal(np.column_stack([las.red, las.green, las.blue]) // 257, cloud.colors)
    assert np.array_equal(las.views, cloud.views)
    assert np.abs(np.asarray(las.nz) - 1).max() < 1e-4
    found = las.header.parse_crs()
    assert (found.to_epsg() if found else None) == (32632 if crs else None)
    assert las.header.creation_date == DAY
    assert laz_bytes(cloud, DAY, on_map) == data


@pytest.mark.parametrize("crs", ["", LOCAL])
def test_laspy_reads_a_copc_file_completely_or_as_a_coarse_even_part(crs: str, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("copclib")
    from wbflow_stages.exports.copc import copc_bytes
    from wbflow_stages.exports.las import laz_bytes
    from wbflow_stages.exports.octree import MOST_IN_LEAF
    from wbflow_stages.exports.world import georeference

    cloud = cloud_of(hill(count=4 * MOST_IN_LEAF))
    laz = laz_bytes(cloud, DAY, georeference(crs) if crs else None)
    data, plain = copc_bytes(laz), laspy.read(io.BytesIO(laz))
    (tmp_path / "cloud.copc.laz").write_bytes(data)
    with laspy.CopcReader.open(str(tmp_path / "cloud.copc.laz")) as reader:
        found, coarse = reader.query(), reader.query(level=0)
        middle = (reader.header.mins + reader.header.maxs) / 2
        half = reader.query(bounds=laspy.Bounds(reader.header.mins, np.append(middle[:2], reader.header.maxs[2])))
    order, expected = np.lexsort((found.x, found.y, found.z)), np.lexsort((plain.x, plain.y, plain.z))
    for name in ("x", "y", "z", "red", "views", "nz", "confidence", "sigma_mm"):
        assert np.array_equal(np.asarray(found[name])[order], np.asarray(plain[name])[expected]), name
    assert 0.02 < len(coarse) / len(found) < 0.5
    assert np.histogram(coarse.x, 10)[0].min() > 0.5 * len(coarse) / 10, "the coarse part covers all of the ramp alike"
    assert len(half) == pytest.approx(len(found) / 4, rel=0.05)
    everything = laspy.read(io.BytesIO(data))
    assert len(everything.points) == len(plain.points), "any reader of LAZ reads it"
    parsed = everything.header.parse_crs()
    assert (parsed.to_epsg() if parsed else None) == (32632 if crs else None)
    assert everything.header.creation_date == DAY
    assert copc_bytes(laz) == data


def test_pyogrio_reads_cameras_and_changes_back_from_a_geopackage(tmp_path: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    from wbflow_stages.exports.map_features import Feature, geopackage_bytes
    from wbflow_stages.exports.world import georeference

    place = georeference(LOCAL)
    cameras = [Feature(np.array([k, 2.0 * k, 3.0]), {"camera": f"mast-{k}", "heading_deg": 90.5}) for k in range(3)]
    changes = [Feature(np.array([5.0, 6.0, 7.0]), {"change": "1", "kind": "new", "volume": 2.5, "points": 40})]
    data = geopackage_bytes({"cameras": cameras, "changes": changes, "none": []}, place, DAY)
    path = tmp_path / "site.gpkg"
    path.write_bytes(data)
    layers = [name for name, _ in pyogrio.list_layers(path)]
    assert layers == ["cameras", "changes"]
    about, _, shapes, (names, headings) = pyogrio.raw.read(path, layer="cameras")
    assert about["crs"] == "EPSG:32632"
    assert list(names) == ["mast-0", "mast-1", "mast-2"]
    assert list(headings) == [90.5] * 3
    read = np.array([np.frombuffer(shape[5:], "<f8") for shape in shapes])
    assert np.abs(read - place.points(np.array([c.position for c in cameras]))).max() < 1e-6
    about, _, _, columns = pyogrio.raw.read(path, layer="changes")
    assert [column[0] for column in columns] == ["1", "new", 2.5, 40]
    assert geopackage_bytes({"cameras": cameras, "changes": changes, "none": []}, place, DAY) == data


@pytest.mark.parametrize("crs", ["", LOCAL])
def test_libe57_reads_the_cloud_back(crs: str, tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    from wbflow_stages.exports.e57 import e57_bytes
    from wbflow_stages.exports.world import georeference

    cloud = cloud_of(hill(count=2000))
    on_map = georeference(crs) if crs else None
    data = e57_bytes(cloud, on_map)
    (tmp_path / "cloud.e57").write_bytes(data)
    file = pye57.E57(str(tmp_path / "cloud.e57"))
    read = file.read_scan_raw(0, ignore_unsupported_fields=True)
    expected = on_map.points(cloud.points.astype(float)) if on_map else cloud.points
    assert np.abs(np.column_stack([read[f"cartesian{axis}"] for axis in "XYZ"]) - expected).max() < 1e-5
    assert np.array_equal(np.column_stack([read[f"color{name}"] for name in ("Red", "Green", "Blue")]), cloud.colors)
    assert read["intensity"] == pytest.approx(cloud.confidence, abs=1e-6)
    assert "nor:normalZ" in file.get_header(0).point_fields
    assert file.root["coordinateMetadata"].value() == ("EPSG:32632" if crs else "")
    assert e57_bytes(cloud, on_map) == data


@pytest.mark.parametrize("epsg", [None, 32632])
def test_rasterio_reads_the_geotiff_back(epsg: int | None) -> None:
    rasterio = pytest.importorskip("rasterio")
    far = np.array([565_000.0, 5_933_000.0, 0.0]) if epsg else np.array([-30.0, 12.0, 0.0])
    found = height_map(hill(count=3000) + far, cell=0.5)
    arguments = found.heights[None], found.left, found.top, found.cell, epsg, ["heights"], "m"
    data = geotiff(*arguments)
    with rasterio.MemoryFile(data) as memory, memory.open() as file:
        assert (file.crs.to_epsg() if file.crs else None) == epsg
        assert np.array_equal(file.read(1), found.heights, equal_nan=True)
        assert file.xy(0, 0) == pytest.approx((found.left + 0.25, found.top - 0.25))
        assert math.isnan(file.nodata)
        assert (file.descriptions, file.units) == (("heights",), ("m",))
    assert geotiff(*arguments) == data

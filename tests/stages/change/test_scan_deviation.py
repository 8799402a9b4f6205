"""A cloud compared with a scan: registration and deviations, on surfaces that are known exactly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d
import pytest
from scipy.spatial.transform import Rotation

from wbflow.pipeline.exports import SCANS
from wbflow_stages.change.scan_deviation import deviation_from_scan
from wbflow_stages.exports.deviation import scan_files
from wbflow_stages.io.scans import CLOUDS, MESHES, read_scan
from wbflow_stages.types import Cloud, Float64s, Poses

NOISE = 0.01
LOCAL = "+proj=topocentric +ellps=WGS84 +lat_0=53.541 +lon_0=9.966 +h_0=52.0"


def yard(seed: int, count: int = 40_000, box: float = 2.0, noise: float = 0.0) -> tuple[Float64s, Float64s]:
    """Points and normals: ground of 20 x 14 m, two walls, and a box of height `box` in the middle."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform((0, 0), (20, 14), (count, 2)).T
    on_box = (np.abs(x - 10) < 1.5) & (np.abs(y - 7) < 1.5)
    ground = np.column_stack([x, y, np.where(on_box, box, 0.05 * np.sin(x))])
    u, v = rng.uniform((0, 0), (20, 4), (count // 3, 2)).T
    back = np.column_stack([u, np.full(len(u), 14.0), v])
    side = np.column_stack([np.full(len(u), 0.0), 0.7 * u, v])
    normals = np.repeat([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]], [count, len(u), len(u)], axis=0)
    points = np.vstack([ground, back, side])
    return points + normals * rng.normal(0, noise, (len(points), 1)) if noise else points, normals


def cloud(box: float = 2.0, keep: float = 1.0) -> Cloud:
    points, normals = yard(1, box=box, noise=NOISE)
    rows = points[:, 0] <= np.quantile(points[:, 0], keep)
    n = int(rows.sum())
    return Cloud(
        points=points[rows].astype(np.float32), normals=normals[rows].astype(np.float32),
        colors=np.full((n, 3), 90, np.uint8), confidence=np.ones(n, np.float32), views=np.full(n, 3, np.uint16),
        sigma_mm=np.full(n, 1000 * NOISE, np.float32),
    )  # fmt: skip


def poses(metric: bool, crs: str = "") -> Poses:
    return Poses({}, metric=metric, source="calibration", crs=crs)


def test_a_scan_is_registered_to_the_cloud_and_a_changed_box_does_not_bias_it() -> None:
    turn, shift = Rotation.from_euler("zyx", [1.5, -0.5, 0.7], degrees=True).as_matrix(), np.array([0.5, -0.4, 0.3])
    scan = yard(2, box=0.0)[0] @ turn.T + shift
    found = deviation_from_scan(cloud(box=0.4), scan)
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = turn.T, -turn.T @ shift
    assert np.abs(found.transform - back).max() < 0.005
    at = cloud().points
    on_box = (np.abs(at[:, 0] - 10) < 1.2) & (np.abs(at[:, 1] - 7) < 1.2) & (at[:, 1] < 13)
    assert np.nanmedian(found.distance[on_box]) == pytest.approx(0.4, abs=0.02)
    beyond = np.abs(found.distance) > 2 * found.sigma
    assert beyond[on_box].mean() > 0.95
    elsewhere = (np.abs(at[:, 0] - 10) > 2.5) & (at[:, 0] > 1) & (at[:, 1] < 13)
    assert beyond[elsewhere].mean() < 0.1
    assert found.agreeing > 0.8
    assert found.residual_m < NOISE
    assert found.registration_m < 0.5 * NOISE


def test_a_scan_of_less_than_half_is_refused_and_of_three_quarters_accepted() -> None:
    points, at = yard(3)[0], cloud().points[:, 0]
    with pytest.raises(ValueError, match=r"4\d% of the cloud"):
        deviation_from_scan(cloud(), points[points[:, 0] < np.quantile(at, 0.45)])
    most = float(np.quantile(at, 0.75))
    assert deviation_from_scan(cloud(), points[points[:, 0] < most]).overlap == pytest.approx(0.75, abs=0.03)


def test_map_coordinates_are_converted_to_site_coordinates_and_back() -> None:
    pytest.importorskip("pyproj")
    from wbflow_stages.exports.world import georeference

    place = georeference(LOCAL)
    points = yard(4)[0]
    assert np.abs(place.local(place.points(points)) - points).max() < 1e-4
    degrees = np.array([place.degrees(x) for x in points[:5]])
    assert np.abs(place.local(degrees, 4326) - points[:5]).max() < 1e-3
    assert place.is_on_map(place.points(points))
    assert not place.is_on_map(points)


def test_scan_files_report_the_deviation_and_need_a_metric_scale(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    from wbflow_stages.exports.world import georeference

    on_map = georeference(LOCAL).points(yard(5)[0])
    path = tmp_path / "scan.ply"
    open3d.io.write_point_cloud(path, open3d.geometry.PointCloud(open3d.utility.Vector3dVector(on_map)))
    files, figures = scan_files(cloud(), poses(metric=True, crs=LOCAL), path)
    assert files.keys() == {"deviation.ply", "deviation.json"}
    assert figures["overlap"] > 0.95
    assert figures["median_unsigned"] < NOISE
    assert scan_files(cloud(), poses(metric=True, crs=LOCAL), path)[0]["deviation.json"] == files["deviation.json"]
    with pytest.raises(ValueError, match="no scale"):
        scan_files(cloud(), poses(metric=False), path)


def test_the_command_accepts_every_cloud_and_mesh_format_as_a_scan() -> None:
    assert SCANS == CLOUDS + MESHES


@pytest.mark.parametrize("kind", CLOUDS)
def test_every_cloud_format_is_read(kind: str, tmp_path: Path) -> None:
    points, path = yard(6, count=300)[0], tmp_path / f"scan{kind}"
    if kind in (".las", ".laz"):
        laspy = pytest.importorskip("laspy")
        header = laspy.LasHeader(point_format=3, version="1.2")
        header.scales = [1e-4] * 3
        las = laspy.LasData(header)
        las.x, las.y, las.z = points.T
        las.write(path)
    elif kind == ".e57":
        pye57 = pytest.importorskip("pye57")
        with pye57.E57(str(path), mode="w") as file:
            file.write_scan_raw({f"cartesian{axis}": points[:, k] for k, axis in enumerate("XYZ")})
    else:
        open3d.io.write_point_cloud(path, open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)))
    read = read_scan(path, 0.1)
    assert np.abs(read.points - points).max() < 1e-3
    assert read.epsg is None


@pytest.mark.parametrize("kind", [*MESHES, ".ply"])
def test_points_are_spread_evenly_over_meshes(kind: str, tmp_path: Path) -> None:
    path, box = tmp_path / f"model{kind}", open3d.geometry.TriangleMesh.create_box(2.0, 3.0, 1.0)
    box.compute_vertex_normals()
    assert open3d.io.write_triangle_mesh(path, box)
    read = read_scan(path, 0.05)
    assert len(read.points) == pytest.approx(22 / 0.05**2, rel=0.01)
    inside = np.all((read.points > 1e-6) & (read.points < np.array([2.0, 3.0, 1.0]) - 1e-6), axis=1)
    assert not inside.any()
    assert np.array_equal(read_scan(path, 0.05).points, read.points)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", b"", "ends in none"),
        ("a.laz", b"not so", "cannot be read"),
        ("a.e57", b"x", "cannot be read"),
        ("a.ply", b"ply\n", "cut short"),
    ],
)
def test_files_that_are_not_scans_are_refused(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read_scan(tmp_path / name, 0.1)

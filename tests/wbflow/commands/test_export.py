"""Exports of a finished run for other programs, without running anything again."""

from __future__ import annotations

import importlib.util
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import open3d
import pycolmap
import pytest
from click.testing import CliRunner, Result

from tests.helpers.images import read_image
from wbflow.cache.checksum import content_digest
from wbflow.cache.ply import read_ply
from wbflow.cli.main import main
from wbflow.commands.demo import write_demo

ALL = ("--laz", "--heights", "--depth", "--mesh", "--orthophoto", "--colmap")
ORIGIN = (53.541, 9.966, 52.0)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small demo, run once with few points, since meshing many takes long."""
    folder = tmp_path_factory.mktemp("export") / "demo"
    write_demo(folder, small=True, captures=1)
    with (folder / "site.yaml").open("a") as file:
        file.write("stages: {fuse: {voxel_m: 0.12}}\n")
    assert CliRunner().invoke(main, ["run", str(folder), "--jobs", "1", "-q"]).exit_code == 0
    return folder


@pytest.fixture(scope="module")
def exported(site: Path) -> Path:
    """A folder with everything that can be exported from the site's run."""
    result = wbflow_export(site, site / "out", *ALL)
    assert result.exit_code == 0, result.output
    written = {Path(line) for line in result.stdout.splitlines()}
    assert written == {path for path in (site / "out").rglob("*") if path.is_file()}
    return site / "out"


def wbflow_export(site: Path, out: Path, *arguments: str) -> Result:
    return CliRunner().invoke(main, ["export", str(site), "--out", str(out), *arguments])


def work(site: Path) -> Path:
    return site / ".wbflow" / "yard"


def test_laspy_reads_the_points_of_the_cloud(site: Path, exported: Path) -> None:
    laspy = pytest.importorskip("laspy")
    las, cloud = laspy.read(exported / "cloud.laz"), read_ply(work(site) / "runs" / "latest-good" / "cloud.ply")
    assert np.abs(las.x - cloud["x"]).max() < 1e-5
    assert np.array_equal(las.green // 257, cloud["green"])
    assert las.header.parse_crs() is None


def test_colmap_reads_the_exported_cameras_and_points(site: Path, exported: Path) -> None:
    model = pycolmap.Reconstruction(exported / "colmap" / "sparse")
    truth = json.loads((site / "truth" / "cameras.json").read_text())
    assert {image.name for image in model.images.values()} == {f"{name}.png" for name in truth}
    for image in model.images.values():
        picture = read_image(exported / "colmap" / "images" / image.name)
        assert picture.shape[:2] == (image.camera.height, image.camera.width)
        assert image.projection_center() == pytest.approx(truth[Path(image.name).stem]["C"], abs=1e-6)
    tracked = [point for point in model.points3D.values() if point.track.length() > 0]
    assert len(model.points3D) - len(tracked) == len(read_ply(work(site) / "runs" / "latest-good" / "cloud.ply")["x"])
    assert len(tracked) > 100 and model.compute_mean_reprojection_error() < 1.5


def test_colmap_finds_the_whole_cloud_and_who_sees_it_where_its_own_fusion_writes_them(site: Path, exported: Path) -> None:
    cloud = read_ply(work(site) / "runs" / "latest-good" / "cloud.ply")
    fused = open3d.io.read_point_cloud(exported / "colmap" / "fused.ply")
    assert np.array_equal(np.asarray(fused.points, np.float32), np.column_stack([cloud[axis] for axis in "xyz"]))
    assert np.array_equal(np.rint(np.asarray(fused.colors)[:, 1] * 255), cloud["green"])
    assert np.allclose(np.asarray(fused.normals)[:, 2], cloud["nz"])
    images = pycolmap.Reconstruction(exported / "colmap" / "sparse").images
    views = visible_images(exported / "colmap" / "fused.ply.vis")
    assert len(views) == len(fused.points)
    counts = np.array([len(seen) for seen in views])
    assert np.mean(counts >= 2) > 0.9
    for number in range(0, len(views), 997):
        for index in views[number]:
            image = images[int(index) + 1]
            x = image.project_point(np.asarray(fused.points)[number])
            assert x is not None and image.camera is not None
            assert 0 <= x[0] <= image.camera.width and 0 <= x[1] <= image.camera.height


def visible_images(path: Path) -> list[np.ndarray]:
    """Indices of the images that see each point, from a file of COLMAP's."""
    data = path.read_bytes()
    (count,) = np.frombuffer(data[:8], "<u8")
    entries = np.frombuffer(data[8:], "<u4")
    views = []
    start = 0
    for _ in range(int(count)):
        end = start + 1 + int(entries[start])
        views.append(entries[start + 1 : end])
        start = end
    assert start == len(entries), "nothing is left over"
    return views


def test_depth_maps_are_close_to_the_truth(site: Path, exported: Path) -> None:
    index = json.loads((exported / "depth" / "depth.json").read_text())
    assert index["unit"] == "m"
    assert len(index["cameras"]) == 4
    for name, entry in index["cameras"].items():
        truth = np.load(site / "truth" / "depth" / f"{name}.npz")["depth"]
        png = read_image(exported / "depth" / f"{name}.png", cv2.IMREAD_UNCHANGED)
        known = (png > 0) & (truth > 0)
        errors = np.abs((png[known] - 1.0) / entry["png_steps_per_unit"] - truth[known]) / truth[known]
        assert known.mean() > 0.4
        assert np.median(errors) < 0.005


def test_the_mesh_lies_on_the_cloud(site: Path, exported: Path) -> None:
    mesh = open3d.io.read_triangle_mesh(exported / "mesh.ply")
    cloud = open3d.io.read_point_cloud(work(site) / "runs" / "latest-good" / "cloud.ply")
    vertices = open3d.geometry.PointCloud(mesh.vertices)
    assert len(mesh.triangles) > 10_000
    assert np.percentile(np.asarray(vertices.compute_point_cloud_distance(cloud)), 95) < 0.25


def test_heights_agree_with_the_cloud(site: Path, exported: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    cloud = read_ply(work(site) / "runs" / "latest-good" / "cloud.ply")
    with rasterio.open(exported / "heights.tif") as file:
        assert file.crs is None, "the site is not on the map"
        assert (file.units, file.descriptions) == (("m",), ("height above the site's origin",))
        column, row = ~file.transform * (cloud["x"], cloud["y"])
        assert 0.88 < share_below(file.read(1), row, column, cloud["z"]) < 0.97


def test_the_orthophoto_of_a_site_that_is_not_on_the_map_lies_in_its_own_coordinates(site: Path, exported: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    cloud = read_ply(work(site) / "runs" / "latest-good" / "cloud.ply")
    with rasterio.open(exported / "orthophoto.tif") as file:
        assert file.crs is None
        photo = file.read()
        column, row = (np.floor(k).astype(int) for k in ~file.transform * (cloud["x"], cloud["y"]))
    inside = (row >= 0) & (row < photo.shape[1]) & (column >= 0) & (column < photo.shape[2])
    there = photo[:, row[inside], column[inside]].astype(int)
    colours = np.stack([cloud["red"], cloud["green"], cloud["blue"]])[:, inside]
    assert inside.mean() > 0.99
    assert (there[3] == 255).mean() > 0.9
    assert np.median(np.abs(there[:3] - colours)) < 20, "of walls only the upper edge is seen"


def share_below(heights: np.ndarray, row: np.ndarray, column: np.ndarray, z: np.ndarray) -> float:
    """Share of points that are not above their cell of a height map; about half if the map is shifted or flipped."""
    row, column = np.floor(row).astype(int), np.floor(column).astype(int)
    inside = (row >= 0) & (row < heights.shape[0]) & (column >= 0) & (column < heights.shape[1])
    assert inside.mean() > 0.99
    there = heights[row[inside], column[inside]]
    assert np.isfinite(there).mean() > 0.999, "every point's cell has a height"
    return float(np.mean(z[inside] <= there + 1e-3))


def test_exporting_a_run_twice_gives_the_same_bytes(site: Path, exported: Path, tmp_path: Path) -> None:
    assert wbflow_export(site, tmp_path, *ALL).exit_code == 0
    files = [path.relative_to(exported) for path in exported.rglob("*") if path.is_file()]
    assert len(files) > 10
    assert [f for f in files if (tmp_path / f).read_bytes() != (exported / f).read_bytes()] == []


def test_exports_of_a_georeferenced_site_have_its_coordinate_system(site: Path, tmp_path: Path) -> None:
    laspy, rasterio = pytest.importorskip("laspy"), pytest.importorskip("rasterio")
    on_map = placed_on_the_map(site, tmp_path / "site")
    result = wbflow_export(on_map, tmp_path / "out", "--laz", "--copc", "--heights", "--orthophoto")
    assert result.exit_code == 0, result.output
    assert laspy.read(tmp_path / "out" / "cloud.copc.laz").header.parse_crs().to_epsg() == 32632
    las = laspy.read(tmp_path / "out" / "cloud.laz")
    assert las.header.parse_crs().to_epsg() == 32632
    with rasterio.open(tmp_path / "out" / "heights.tif") as file:
        assert file.crs.to_epsg() == 32632
        heights = file.read(1)
        column, row = ~file.transform * (np.asarray(las.x), np.asarray(las.y))
    assert 0.88 < share_below(heights, row, column, np.asarray(las.z)) < 0.97
    assert np.nanmedian(heights) > 45, "above the ellipsoid, not above the local origin"
    with rasterio.open(tmp_path / "out" / "orthophoto.tif") as file:
        assert file.crs.to_epsg() == 32632
        photo = file.read()
        column, row = (np.asarray(k, int) for k in ~file.transform * (np.asarray(las.x), np.asarray(las.y)))
    inside = (row >= 0) & (row < photo.shape[1]) & (column >= 0) & (column < photo.shape[2])
    there, written = photo[:, row[inside], column[inside]], np.stack([las.red, las.green, las.blue])[:, inside] / 257
    assert (there[3] == 255).mean() > 0.9
    assert np.median(np.abs(there[:3] - written)) < 20, "of walls only the upper edge is seen"


def test_cameras_are_exported_as_geojson_only_if_georeferenced(site: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    pyogrio = pytest.importorskip("pyogrio")
    assert "not on the map" in wbflow_export(site, tmp_path / "no", "--geojson").output
    assert "not on the map" in wbflow_export(site, tmp_path / "no", "--gpkg").output
    on_map = placed_on_the_map(site, tmp_path / "site")
    assert wbflow_export(on_map, tmp_path / "out", "--geojson", "--gpkg").exit_code == 0
    data = json.loads((tmp_path / "out" / "cameras.geojson").read_text())
    solved = json.loads((site / ".wbflow" / "yard" / "runs" / "latest" / "cameras.json").read_text())
    found = {f["properties"]["camera"]: f["geometry"]["coordinates"] for f in data["features"]}
    assert found.keys() == solved.keys()
    for name, (longitude, latitude, height) in found.items():
        east, north, up = solved[name]["C"]
        assert (latitude - ORIGIN[0]) * 111_200 == pytest.approx(north, rel=0.01, abs=0.05)
        assert (longitude - ORIGIN[1]) * 111_320 * np.cos(np.radians(ORIGIN[0])) == pytest.approx(east, rel=0.01, abs=0.05)
        assert height == pytest.approx(ORIGIN[2] + up, abs=0.01)
    assert pyogrio.read_info(tmp_path / "out" / "site.gpkg", layer="cameras")["features"] == len(solved)


def placed_on_the_map(site: Path, copy: Path) -> Path:
    """A copy of a site with georeferenced poses, as if its cameras were stated by latitude and longitude."""
    from dataclasses import replace

    from wbflow.cache import artifact
    from wbflow.cache.layout import WorkFolder
    from wbflow.cache.store import Cache
    from wbflow.site.geodesy import LocalFrame
    from wbflow.task import Task

    shutil.copytree(site, copy, symlinks=True)
    cache = Cache(WorkFolder(work(copy)))
    receipt = cache.newest(Task("poses"))
    assert receipt is not None
    poses = artifact.decode(cache.path(receipt).read_bytes())
    data = artifact.encode(replace(poses, crs=LocalFrame(*ORIGIN).crs))
    cache.write(replace(receipt, digest=content_digest(data), bytes=len(data)), data)
    return copy


def test_depth_maps_of_unrefined_cameras_come_from_their_pairs(site: Path, exported: Path, tmp_path: Path) -> None:
    shutil.copytree(site, tmp_path / "site", symlinks=True)
    log = (work(tmp_path / "site") / "runs" / "latest-good").resolve() / "log.jsonl"
    log.write_text("".join(line for line in log.read_text().splitlines(keepends=True) if '"stage": "refine"' not in line))
    assert wbflow_export(tmp_path / "site", tmp_path / "out", "--depth").exit_code == 0
    names = json.loads((tmp_path / "out" / "depth" / "depth.json").read_text())["cameras"]
    assert len(names) == 4
    for name in names:
        pairs = (tmp_path / "out" / "depth" / f"{name}.pfm").read_bytes()
        refined = (exported / "depth" / f"{name}.pfm").read_bytes()
        assert len(pairs) == len(refined)
        assert pairs != refined


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ((), 2, "name what to export: --laz"),
        (("19990101T000000Z", "--laz"), 2, "there is no run"),
    ],
)
def test_wrong_arguments_are_refused_and_nothing_is_written(
    site: Path, tmp_path: Path, arguments: tuple[str, ...], code: int, message: str
) -> None:
    result = wbflow_export(site, tmp_path / "out", *arguments)
    assert (result.exit_code, message in result.output) == (code, True)
    assert not (tmp_path / "out").exists()


def test_a_missing_package_is_named_with_what_to_install(site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "lazrs" else found(name, *rest))
    result = wbflow_export(site, tmp_path / "out", "--laz")
    assert result.exit_code == 2
    assert "--laz needs lazrs: pip install 'wbflow[las]'" in result.output
    assert not (tmp_path / "out").exists()


def test_an_export_that_cannot_be_made_does_not_stop_the_others(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "lazrs" else found(name, *rest))
    result = wbflow_export(site, tmp_path / "out", "--laz", "--depth", "--colmap")
    assert result.exit_code == 2
    assert "--laz was not made: --laz needs lazrs" in result.stderr
    assert f"1 of 3 exports not made; the others are in {tmp_path / 'out'}" in result.stderr
    written = {Path(line) for line in result.stdout.splitlines()}
    assert written == {path for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert {path.relative_to(tmp_path / "out").parts[0] for path in written} == {"depth", "colmap"}


@pytest.mark.parametrize("fault", [ValueError("no point"), RuntimeError("the library gave up"), ImportError("no libGL.so.1")])
def test_an_export_whose_library_fails_does_not_stop_the_others(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    def fail(**results: object) -> None:
        raise fault

    monkeypatch.setattr("wbflow_stages.exports.forms.heights", fail)
    result = wbflow_export(site, tmp_path / "out", "--laz", "--heights", "--depth")
    assert result.exit_code == 1
    assert f"--heights was not made: run {(work(site) / 'runs' / 'latest').resolve().name}: {fault}" in result.stderr
    assert "1 of 3 exports not made" in result.stderr
    assert {path.relative_to(tmp_path / "out").parts[0] for path in (tmp_path / "out").rglob("*")} == {"cloud.laz", "depth"}


def test_a_night_is_compared_with_a_scan_of_its_site(site: Path, tmp_path: Path) -> None:
    truth, shifted = read_ply(site / "truth" / "reference.ply"), tmp_path / "scan.ply"
    at = np.column_stack([truth[axis] for axis in "xyz"]) + np.array([0.4, -0.3, 0.2])
    open3d.io.write_point_cloud(shifted, open3d.geometry.PointCloud(open3d.utility.Vector3dVector(at)))
    result = CliRunner().invoke(main, ["compare", str(site), str(shifted), "--out", str(tmp_path), "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["overlap"] > 0.8
    assert np.array(found["transform_of_scan"])[:3, 3] == pytest.approx([-0.4, 0.3, -0.2], abs=0.05)
    assert found["median_unsigned"] < 0.05
    written = read_ply(tmp_path / "deviation.ply")
    assert np.median(np.abs(written["deviation"][np.isfinite(written["deviation"])])) == pytest.approx(
        found["median_unsigned"], 1e-3
    )
    words = CliRunner().invoke(main, ["compare", str(site), str(shifted), "--out", str(tmp_path)]).stdout
    assert "the scan covers" in words
    assert str(tmp_path / "deviation.ply") in words


@pytest.mark.parametrize("what", ["elsewhere", "a corner", "damaged", "missing"])
def test_a_scan_that_cannot_be_compared_is_refused_and_nothing_is_written(site: Path, tmp_path: Path, what: str) -> None:
    truth, file = read_ply(site / "truth" / "reference.ply"), tmp_path / "scan.ply"
    at = np.column_stack([truth[axis] for axis in "xyz"]).astype(float)
    at = at + 5000.0 if what == "elsewhere" else at[at[:, 0] < np.quantile(at[:, 0], 0.2)]
    open3d.io.write_point_cloud(file, open3d.geometry.PointCloud(open3d.utility.Vector3dVector(at)))
    if what == "damaged":
        file.write_bytes(file.read_bytes()[:300])
    if what == "missing":
        file.unlink()
    result = CliRunner().invoke(main, ["compare", str(site), str(file), "--out", str(tmp_path / "out")])
    expected = {"elsewhere": "no point near", "a corner": "50% are needed", "damaged": "cut short", "missing": "no such file"}
    assert result.exit_code == 2
    assert expected[what] in result.output
    assert not (tmp_path / "out").exists()


def test_a_missing_cache_entry_is_named_in_the_error(site: Path, tmp_path: Path) -> None:
    shutil.copytree(site, tmp_path / "site", symlinks=True)
    shutil.rmtree(work(tmp_path / "site") / "cache" / "frames")
    result = wbflow_export(tmp_path / "site", tmp_path / "out", "--colmap")
    assert result.exit_code == 1
    assert "the cache no longer holds 'frames " in result.output


def test_exporting_a_mesh_without_a_cloud_fails_with_a_message(site: Path, tmp_path: Path) -> None:
    shutil.copytree(site, tmp_path / "site", symlinks=True)
    (work(tmp_path / "site") / "runs" / "latest-good" / "cloud.ply").unlink()
    result = wbflow_export(tmp_path / "site", tmp_path / "out", "--mesh")
    assert result.exit_code == 1
    assert "made no cloud" in result.output

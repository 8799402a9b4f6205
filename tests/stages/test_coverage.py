"""Which places the cameras see, how well, and what the site loses without each of them."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.helpers.exact_scene import make_yard
from wbflow_stages.core.ground_grid import cell_centres, cells_of
from wbflow_stages.coverage import find_coverage
from wbflow_stages.exports.ground import coverage_files, coverage_layer, coverage_preview
from wbflow_stages.types import Coverage, Poses, Rejected, Scene

YARD = make_yard((-40, -20, 0, 20, 40), width=160)
DEPTHS = YARD.depths()
POSES = Poses(YARD.cameras, metric=True, source="calibration")


def covered(leave_out: str = "", max_angle_deg: float = 60.0) -> Coverage:
    cameras = {name: camera for name, camera in YARD.cameras.items() if name != leave_out}
    found = find_coverage(replace(POSES, cameras=cameras), YARD.frames, DEPTHS, scene=Scene(), max_angle_deg=max_angle_deg)
    assert isinstance(found, Coverage)
    return found


def value_at(coverage: Coverage, values: np.ndarray, x: float, y: float) -> float:
    return float(values.ravel()[cells_of(coverage.grid, np.array([[x, y, 0.0]]))[0]])


def test_open_ground_is_seen_by_all_cameras_and_ground_behind_the_box_by_fewer() -> None:
    coverage = covered()
    assert value_at(coverage, coverage.views, -0.5, -2.0) == 5
    assert value_at(coverage, coverage.heights, -0.5, -2.0) == pytest.approx(0.0, abs=0.05)
    assert value_at(coverage, coverage.heights, -0.5, 0.0) == pytest.approx(1.6, abs=0.05)  # on the box
    assert value_at(coverage, coverage.views, -0.5, 1.4) < 5  # behind it
    assert 0 < coverage.seen_by_two <= coverage.seen_by_one <= 1


def test_angle_and_error_are_those_of_the_best_pair() -> None:
    coverage = covered(max_angle_deg=50)
    angle, error = value_at(coverage, coverage.angle_deg, -0.5, -2.0), value_at(coverage, coverage.error, -0.5, -2.0)
    assert 30 < angle <= 50
    # plain formula for two equal rays: range / focal * noise / (sqrt(2) sin(angle / 2))
    reach = float(np.median([np.linalg.norm(c.C - (-0.5, -2.0, 0.0)) for c in YARD.cameras.values()]))
    plain = reach / YARD.cameras["cam+0"].K[0, 0] * 0.35 / (np.sqrt(2) * np.sin(np.radians(angle) / 2))
    assert error == pytest.approx(plain, rel=0.15)
    assert value_at(covered(max_angle_deg=25), covered(max_angle_deg=25).error, -0.5, -2.0) > 1.2 * error


def test_the_predicted_loss_of_a_camera_equals_the_actual_loss() -> None:
    coverage = covered()
    lost = max(coverage.lost_without, key=lambda name: coverage.lost_without[name])
    without = covered(lost)
    centres = cell_centres(coverage.grid, coverage.heights.astype(np.float64))
    cells = cells_of(without.grid, np.nan_to_num(centres))
    both = (cells >= 0) & np.isfinite(coverage.heights.ravel())
    fell = (coverage.views.ravel()[both] >= 2) & (without.views.ravel()[cells[both]] < 2)
    assert coverage.lost_without[lost] == pytest.approx(fell.sum() / np.isfinite(coverage.heights).sum(), abs=0.02)


def test_a_camera_without_depth_sees_nothing() -> None:
    depths = {name: depth for name, depth in DEPTHS.items() if name != "cam+0"}
    coverage = find_coverage(POSES, YARD.frames, depths, scene=Scene())
    assert isinstance(coverage, Coverage)
    assert coverage.views.max() == 4
    assert "cam+0" not in coverage.lost_without


def test_masked_pixels_see_nothing() -> None:
    frames = {name: replace(frame, mask=np.zeros_like(frame.mask)) for name, frame in YARD.frames.items()}
    blind = find_coverage(POSES, frames, DEPTHS)
    assert isinstance(blind, Coverage)
    assert (blind.seen_by_one, blind.median_error) == (0, -1)


def test_coverage_does_not_depend_on_position_and_scale_of_the_world() -> None:
    turned = make_yard((-40, -20, 0, 20, 40), width=160, scale=0.1, shift=(100.0, -50.0, 3.0))
    other = find_coverage(replace(POSES, cameras=turned.cameras), turned.frames, turned.depths())
    assert isinstance(other, Coverage)
    assert other.seen_by_two == pytest.approx(covered().seen_by_two, abs=0.03)
    assert other.median_error == pytest.approx(0.1 * covered().median_error, rel=0.1)


def test_holes_lie_on_the_ground_plane_if_it_is_known() -> None:
    plane = Scene(ground=np.array([0.0, 0.0, 1.0, 0.25]))
    found = find_coverage(POSES, YARD.frames, DEPTHS, scene=plane)
    assert isinstance(found, Coverage)
    behind = value_at(found, found.heights, -0.5, 1.05)
    assert behind == pytest.approx(-0.25, abs=1e-6) or value_at(found, found.views, -0.5, 1.05) > 1


def test_without_any_depth_coverage_is_rejected() -> None:
    assert isinstance(find_coverage(POSES, YARD.frames, {}), Rejected)


def test_coverage_is_drawn_and_written_as_a_geotiff() -> None:
    rasterio = pytest.importorskip("rasterio", reason="the extra geo is not installed")
    pytest.importorskip("pyproj", reason="the extra geo is not installed")
    coverage = replace(covered(), crs="+proj=topocentric +ellps=WGS84 +lat_0=53.5 +lon_0=9.9 +h_0=0 +type=crs")
    files = dict(coverage_files(coverage))
    assert set(files) == {"coverage.png", "coverage.tif"}
    shown = cv2.imdecode(np.frombuffer(files["coverage.png"], np.uint8), 1)
    assert shown is not None
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 5
    with rasterio.MemoryFile(files["coverage.tif"]) as memory, memory.open() as file:
        views = file.read(1)
        assert file.crs.to_epsg() == 32632
        assert np.nanmax(views) == 5
        assert np.isfinite(views).sum() == pytest.approx(np.isfinite(coverage.heights).sum(), rel=0.02)
    assert cv2.imdecode(coverage_preview(coverage, POSES), 1) is not None
    assert list(dict(coverage_files(covered()))) == ["coverage.png"]


def test_the_letters_of_the_map_can_be_read_on_a_phone_and_are_inside_the_picture() -> None:
    coverage = covered()
    legend = cv2.imdecode(np.frombuffer(dict(coverage_files(coverage))["coverage.png"], np.uint8), 1)
    with_cameras = cv2.imdecode(coverage_preview(coverage, POSES), 1)
    assert legend is not None and with_cameras is not None
    # the digits of the legend are nearly white, which no colour of the map is; a digit is 0.7 as high as its font
    rows = np.flatnonzero((legend.min(axis=2) > 190).any(axis=1))
    height_on_phone = (rows[-1] - rows[0] + 1) * 350 / legend.shape[1]
    assert height_on_phone >= 0.7 * 11
    assert with_cameras[:, -2:].max() < 100, "names of cameras at the edge are not cut off"


def test_the_corners_of_the_map_layer_enclose_its_cells() -> None:
    coverage = covered()
    data = coverage_layer(coverage)
    length = int.from_bytes(data[:4], "little")
    head, image = json.loads(data[4 : 4 + length]), cv2.imdecode(np.frombuffer(data[4 + length :], np.uint8), -1)
    assert image is not None
    assert image.shape == (coverage.grid.rows, coverage.grid.columns, 4)
    assert np.array_equal(image[..., 3] > 0, np.isfinite(coverage.heights)), "clear where nothing is known"
    top_left, top_right, bottom_left = np.array(head["corners"])
    centres = cell_centres(coverage.grid, np.full(coverage.heights.shape, top_left[2]))
    right, down = (top_right - top_left) / coverage.grid.columns, (bottom_left - top_left) / coverage.grid.rows
    assert top_left + (right + down) / 2 == pytest.approx(centres[0])
    assert top_right + bottom_left - top_left - (right + down) / 2 == pytest.approx(centres[-1])
    views = int(coverage.views[np.isfinite(coverage.heights)].max())
    red, green, blue = (int(head["legend"][views][1][k : k + 2], 16) for k in (1, 3, 5))
    assert image[np.unravel_index(coverage.views.argmax(), coverage.views.shape)].tolist() == [blue, green, red, 255]

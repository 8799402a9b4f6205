"""COLMAP reads the exported model, and projects every point as our cameras do, with its offset of half a pixel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from tests.helpers.exact_pairs import make_pair_site
from wbflow_stages.exports.colmap import colmap_files
from wbflow_stages.types import Camera, Cloud


def cloud_of(points: np.ndarray) -> Cloud:
    n = len(points)
    colors = (np.arange(3 * n).reshape(n, 3) % 256).astype(np.uint8)
    up = np.tile(np.array([0, 0, 1], np.float32), (n, 1))
    return Cloud(points.astype(np.float32), up, colors, np.ones(n, np.float32), np.full(n, 2, np.uint16), np.ones(n, np.float32))


def camera(turn: list[float], radial: tuple[float, float] = (0.0, 0.0)) -> Camera:
    K = np.array([[500.0, 0, 310.25], [0, 505.0, 180.75], [0, 0, 1]])
    return Camera(K, Rotation.from_rotvec(turn).as_matrix(), np.array([0.5, -0.3, -10.0]), 640, 360, radial=radial)


def read(files: dict[str, bytes], folder: Path) -> pycolmap.Reconstruction:
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return pycolmap.Reconstruction(folder)


def test_colmap_pixel_coordinates_are_half_a_pixel_larger_than_ours(tmp_path: Path) -> None:
    cameras = {"gate": camera([0.02, -0.1, 0.3]), "roof": camera([-0.1, 0.15, -2.9])}
    X = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    model = read(colmap_files(cameras, {}, cloud_of(X)), tmp_path)
    images = {image.name: image for image in model.images.values()}
    assert images.keys() == {"gate.png", "roof.png"}
    for name, ours in cameras.items():
        x = (ours.K @ ours.R @ (X - ours.C).T).T
        theirs = np.array([images[f"{name}.png"].project_point(p) for p in X])
        assert np.abs(theirs - 0.5 - x[:, :2] / x[:, 2:]).max() < 1e-9


def test_points_and_colors_are_exported_unchanged(tmp_path: Path) -> None:
    cloud = cloud_of(np.random.default_rng(1).normal(size=(30, 3)))
    model = read(colmap_files({"gate": camera([0.0, 0.0, 0.1])}, {}, cloud), tmp_path)
    read_back = [model.points3D[n + 1] for n in range(30)]
    assert np.abs([p.xyz for p in read_back] - cloud.points).max() < 1e-6
    assert np.array_equal([p.color for p in read_back], cloud.colors)


def test_distortion_that_remains_in_a_frame_is_exported(tmp_path: Path) -> None:
    model = read(colmap_files({"gate": camera([0.0, 0.0, 0.1], (-0.1, 0.02))}, {}, cloud_of(np.zeros((1, 3)))), tmp_path)
    assert model.cameras[1].model.name == "OPENCV"
    assert model.cameras[1].params == pytest.approx([500, 505, 310.75, 181.25, -0.1, 0.02, 0, 0])


def test_a_large_cloud_is_thinned_evenly() -> None:
    points = np.column_stack([np.arange(1000.0), np.zeros(1000), np.zeros(1000)])
    files = colmap_files({"gate": camera([0.0, 0.0, 0.1])}, {}, cloud_of(points), most_points=100)
    x = [float(line.split()[1]) for line in files["points3D.txt"].decode().splitlines() if line[0] != "#"]
    assert x == [10.0 * n for n in range(100)]


def test_matches_become_tracks_with_their_reprojection_errors(tmp_path: Path) -> None:
    site = make_pair_site(3, points=60, noise_px=0.3)
    geometries = {"--".join(pair): geometry for pair, geometry in site.geometries.items()}
    model = read(colmap_files(site.cameras, geometries, cloud_of(site.X)), tmp_path)
    tracked = [point for point in model.points3D.values() if point.track.length() > 0]
    assert len(tracked) > 40 and model.compute_mean_track_length() > 1
    assert 0.05 < np.mean([point.error for point in tracked]) < 0.6
    nearest = [np.linalg.norm(site.X - point.xyz, axis=1).min() for point in tracked]
    assert np.median(nearest) < 0.02


def test_a_match_that_contradicts_the_cameras_becomes_no_track(tmp_path: Path) -> None:
    site = make_pair_site(2, points=60)
    geometry = site.geometries["c0", "c1"]
    shifted = replace(geometry, x2=geometry.x2 + np.where(np.arange(len(geometry.x2)) < 20, 40.0, 0.0)[:, None])
    model = read(colmap_files(site.cameras, {"c0--c1": shifted}, cloud_of(site.X)), tmp_path)
    assert sum(point.track.length() > 0 for point in model.points3D.values()) <= len(geometry.x2) - 15

"""Cameras, tracks of their matches, and the cloud as a COLMAP model in text form, written by COLMAP itself.

The origin of COLMAP's pixels is the corner of the image, ours is the centre of the first pixel: principal points and keypoints
move by half a pixel.

References: https://colmap.github.io/format.html
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from ..sfm.tracks import Tracks, build_tracks, undistort_tracks
from ..sfm.triangulation import residuals, triangulate
from ..types import Camera, Cloud, Float64s, Geometry

MAX_ERROR_PX = 4.0
"""Observations with a larger reprojection error are left out, as in COLMAP (`filter_max_reproj_error`)."""


def colmap_files(
    cameras: Mapping[str, Camera], geometries: Mapping[str, Geometry], cloud: Cloud, most_points: int = 200_000
) -> dict[str, bytes]:
    """The text files of a model of cameras that share a world; images are called <camera>.png.

    Parameters
    ----------
    cameras : by id.
    geometries : by "left--right": their inliers become tracks.
    cloud : thinned evenly to `most_points` and added after the points of the tracks; its points have no observations.
    most_points : largest number of points of the cloud.
    """
    tracks, X = _tracks(cameras, geometries)
    model = pycolmap.Reconstruction()

    # 1. images with their observations as keypoints; COLMAP counts cameras and images from 1
    keypoint_index = np.zeros(len(tracks.track), np.int64)  # of each observation in its image
    for view, (name, camera) in enumerate(cameras.items()):
        number = view + 1
        observations = np.flatnonzero(tracks.view == view)
        keypoint_index[observations] = np.arange(len(observations))
        model.add_camera_with_trivial_rig(_colmap_camera(camera, number))
        image = pycolmap.Image(name=f"{name}.png", keypoints=tracks.xy[observations] + 0.5, camera_id=number, image_id=number)
        pose = np.column_stack([camera.R, -camera.R @ camera.C])  # x ~ R X + t
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))

    # 2. points of tracks, in the colour of the nearest point of the cloud
    colors = np.zeros((len(X), 3), np.uint8)
    if len(cloud.points):
        _, nearest = cKDTree(cloud.points).query(X)
        colors = cloud.colors[nearest]
    starts = np.searchsorted(tracks.track, np.arange(tracks.count + 1)).tolist()  # observations are sorted by track
    for X_track, color, start, end in zip(X, colors, starts, starts[1:], strict=False):
        track = pycolmap.Track()
        for row in range(start, end):
            track.add_element(int(tracks.view[row]) + 1, int(keypoint_index[row]))
        model.add_point3D(X_track, track, color)

    # 3. points of the cloud, without observations
    count = len(cloud.points)
    sample = np.arange(count)
    if count > most_points:
        sample = np.arange(most_points) * count // most_points
    for point, color in zip(cloud.points[sample].astype(np.float64), cloud.colors[sample], strict=True):
        model.add_point3D(point, pycolmap.Track(), color)
    model.update_point_3d_errors()

    with tempfile.TemporaryDirectory() as folder:
        model.write_text(folder)
        return {file.name: file.read_bytes() for file in sorted(Path(folder).iterdir())}


def _tracks(cameras: Mapping[str, Camera], geometries: Mapping[str, Geometry]) -> tuple[Tracks, Float64s]:
    """Tracks of at least two views with reprojection errors below `MAX_ERROR_PX`, and their points (count, 3)."""
    view_of = {name: view for view, name in enumerate(cameras)}
    views = {view_of[name]: camera for name, camera in cameras.items()}
    edges = {}
    for pair, geometry in geometries.items():
        left, right = pair.split("--")
        if left in view_of and right in view_of:
            edges[view_of[left], view_of[right]] = geometry
    tracks = build_tracks(edges, len(views))
    undistorted = undistort_tracks(tracks, views)
    X = triangulate(views, undistorted, np.ones(len(tracks.track), bool), MAX_ERROR_PX / 2)
    accurate = np.linalg.norm(residuals(views, undistorted, X), axis=1) < MAX_ERROR_PX
    usable = np.bincount(tracks.track[accurate], minlength=tracks.count) >= 2
    observations = np.flatnonzero(accurate & usable[tracks.track])
    _, track = np.unique(tracks.track[observations], return_inverse=True)  # numbered anew, without gaps
    kept = Tracks(track.astype(np.int32), tracks.view[observations], tracks.xy[observations], int(usable.sum()))
    return kept, X[usable]


def _colmap_camera(camera: Camera, number: int) -> pycolmap.Camera:
    """A pinhole camera, or one with the two radial coefficients that were solved."""
    K = camera.K
    model = "PINHOLE"
    params = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5]
    if any(camera.radial):
        model = "OPENCV"
        params = [*params, *camera.radial, 0.0, 0.0]  # k1, k2, p1, p2
    return pycolmap.Camera(camera_id=number, model=model, width=camera.width, height=camera.height, params=params)

"""The files of each export format, from a run's results.  Each function yields names and contents of its files.

Raises ValueError, with the reason, if there is nothing to export.
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..io.rasters import geotiff, pfm, png, stepped
from ..types import Changes, Cloud, DepthMap, Frame, Geometry, Poses

if TYPE_CHECKING:
    from .world import Georeference

Files = Iterator[tuple[str, bytes]]


def laz(cloud: Cloud, poses: Poses, day: datetime.date) -> Files:
    """cloud.laz, in map coordinates if the site is georeferenced.  day: for the file's header."""
    from .las import laz_bytes  # here and below: each format has its own libraries, some of them optional

    yield "cloud.laz", laz_bytes(cloud, day, _georeference(poses))


def copc(cloud: Cloud, poses: Poses, day: datetime.date) -> Files:
    """cloud.copc.laz: the points of `laz` in an octree.  day: for the file's header."""
    from .copc import copc_bytes
    from .las import laz_bytes

    yield "cloud.copc.laz", copc_bytes(laz_bytes(cloud, day, _georeference(poses)))


def tiles(cloud: Cloud, poses: Poses) -> Files:
    """tiles/tileset.json and the files that it names, on the globe if the site is georeferenced."""
    from .tiles import tile_files

    georeference = _georeference(poses)
    to_earth = georeference.to_earth() if georeference is not None else None
    for name, data in tile_files(cloud, to_earth):
        yield f"tiles/{name}", data


def e57(cloud: Cloud, poses: Poses) -> Files:
    """cloud.e57, in map coordinates if the site is georeferenced."""
    from .e57 import e57_bytes

    yield "cloud.e57", e57_bytes(cloud, _georeference(poses))


def heights(cloud: Cloud, poses: Poses) -> Files:
    """heights.tif, in map coordinates if the site is georeferenced, else in the site's own."""
    from .heights import height_map

    points = cloud.points.astype(np.float64)
    georeference = _georeference(poses)
    epsg = None
    words = "height above the site's origin"
    if georeference is not None:
        points = georeference.points(points)
        epsg = georeference.epsg
        words = "height above the ellipsoid"
    raster = height_map(points)
    unit = "m" if poses.metric else ""
    yield "heights.tif", geotiff(raster.heights[None], raster.left, raster.top, raster.cell, epsg, [words], unit)


def depth(poses: Poses, depths: Mapping[str, DepthMap]) -> Files:
    """depth/<camera>.png and .pfm of every camera of the main component that has a depth map; depth/depth.json."""
    entries = {}
    for name, camera in poses.main_cameras().items():
        if name not in depths:
            continue
        files, steps = depth_files(depths[name])
        for suffix, data in files.items():
            yield f"depth/{name}{suffix}", data
        entries[name] = {
            "png_steps_per_unit": steps,
            "width": camera.width,
            "height": camera.height,
            "K": camera.K.tolist(),
            "R": camera.R.tolist(),
            "C": camera.C.tolist(),
        }
    if not entries:
        raise ValueError("no camera has a depth map")
    yield "depth/depth.json", _json({"unit": _unit(poses), "cameras": entries})


def mesh(cloud: Cloud, poses: Poses, frames: Mapping[str, Frame]) -> Files:
    """mesh.ply: the surface of the cloud, in its colours; mesh/mesh.obj: a coarser one, textured with the photographs."""
    from .mesh import mesh_bytes, object_files, poisson_mesh, textured

    yield "mesh.ply", mesh_bytes(poisson_mesh(cloud))
    textured_mesh = textured(poisson_mesh(cloud, coarser=1), poses.main_cameras(), frames)
    for name, data in object_files(textured_mesh, "mesh"):
        yield f"mesh/{name}", data


def orthophoto(cloud: Cloud, poses: Poses, frames: Mapping[str, Frame]) -> Files:
    """orthophoto.tif, in map coordinates if the site is georeferenced, else in the site's own."""
    from .mesh import poisson_mesh, textured
    from .orthophoto import orthophoto as seen_from_above

    georeference = _georeference(poses)
    textured_mesh = textured(poisson_mesh(cloud, coarser=1), poses.main_cameras(), frames)
    photo = seen_from_above(textured_mesh, georeference)
    epsg = georeference.epsg if georeference is not None else None
    bands = np.moveaxis(photo.image, 2, 0)  # (4, h, w)
    yield "orthophoto.tif", geotiff(bands, photo.left, photo.top, photo.cell, epsg)


def colmap(
    cloud: Cloud,
    poses: Poses,
    frames: Mapping[str, Frame],
    geometries: Mapping[str, Geometry],
    depths: Mapping[str, DepthMap],
) -> Files:
    """colmap/: a dense workspace of COLMAP of the main component.

    sparse/*.txt, images/<camera>.png, and the whole cloud as fused.ply, with the images that see each point in fused.ply.vis.

    Parameters
    ----------
    cloud, poses : the cloud, whose points, thinned, follow those of the tracks in the sparse model, and the camera poses.
    frames, geometries : frames by camera, and geometries by "left--right", whose inliers become tracks.
    depths : depth maps by camera, which tell what each image sees.
    """
    from .colmap import colmap_files
    from .colmap_dense import fused_files

    cameras = poses.main_cameras()
    # pairs that the solution of the whole site contradicts would join wrong points to tracks
    accepted = {name: geometry for name, geometry in geometries.items() if name not in poses.dropped}
    for name, data in colmap_files(cameras, accepted, cloud).items():
        yield f"colmap/sparse/{name}", data
    for name in cameras:
        if name not in frames:
            raise ValueError(f"there is no frame of {name}")
        yield f"colmap/images/{name}.png", png(frames[name].image)
    for name, data in fused_files(cloud, cameras, depths).items():
        yield f"colmap/{name}", data


def geojson(poses: Poses, changes: Changes | None) -> Files:
    """cameras.geojson, and changes.geojson if nights were compared: longitude, latitude, height above the ellipsoid."""
    from .map_features import camera_features, change_features, geojson_bytes

    georeference = _required_georeference(poses)
    yield "cameras.geojson", geojson_bytes(camera_features(poses.main_cameras()), georeference)
    if changes is not None and changes.compared:
        yield "changes.geojson", geojson_bytes(change_features(changes.changes), georeference)


def gpkg(poses: Poses, changes: Changes | None, day: datetime.date) -> Files:
    """site.gpkg in UTM, with the layers "cameras" and, if anything has changed, "changes".  day: date of the night."""
    from .map_features import camera_features, change_features, geopackage_bytes

    found = changes.changes if changes is not None else {}
    layers = {"cameras": camera_features(poses.main_cameras()), "changes": change_features(found)}
    yield "site.gpkg", geopackage_bytes(layers, _required_georeference(poses), day)


def _required_georeference(poses: Poses) -> Georeference:
    """Georeference of the site.  Raises ValueError if it has none."""
    georeference = _georeference(poses)
    if georeference is None:
        raise ValueError("the site is not on the map: state positions by latitude, longitude and height")
    return georeference


def _georeference(poses: Poses) -> Georeference | None:
    """Georeference of the site, or None.  Raises ValueError for a site outside UTM."""
    if not poses.crs:
        return None
    from .world import georeference

    return georeference(poses.crs)


def _unit(poses: Poses) -> str:
    return "m" if poses.metric else "arbitrary"


def _json(data: dict[str, Any]) -> bytes:
    return (json.dumps(data, indent=1) + "\n").encode()


def depth_files(depth: DepthMap) -> tuple[dict[str, bytes], float]:
    """Files of the reliable depths, by suffix, and the steps of the PNG per unit of length.

    PNG: 0 is unknown, else depth = (value - 1) / steps.  PFM: float32, bottom row first, infinite where unknown.
    """
    # depths that need confirmation by another view are left out, as these files show one view alone
    reliable = np.where(depth.sure, depth.depth, np.nan).astype(np.float32)
    values, steps = stepped(reliable, 0.0)
    return {".png": png(values), ".pfm": pfm(reliable)}, steps

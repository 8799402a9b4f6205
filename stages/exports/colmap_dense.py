"""The whole cloud as COLMAP's fusion of depth maps writes it: fused.ply, and in fused.ply.vis the images that see each point.

COLMAP's and OpenMVS's meshing read both from the folder that holds images/ and sparse/.

References: https://colmap.github.io/format.html; COLMAP's src/colmap/mvs/fusion.cc, `WritePointsVisibility`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..core.cameras import project
from ..types import Bools, Camera, Cloud, DepthMap

MAX_DEPTH_ERROR = 0.01
"""A view sees a point if its depth there differs by less than this share, as in COLMAP (`StereoFusion.max_depth_error`)."""


def fused_files(cloud: Cloud, cameras: Mapping[str, Camera], depths: Mapping[str, DepthMap]) -> dict[str, bytes]:
    """fused.ply and fused.ply.vis of a cloud.

    cameras, depths: by id; an image's number in fused.ply.vis is its camera's place in `cameras`.
    """
    seen = np.zeros((len(cloud.points), len(cameras)), bool)
    for view, (name, camera) in enumerate(cameras.items()):
        if name in depths:
            seen[:, view] = _seen(cloud, camera, depths[name])
    return {"fused.ply": _ply(cloud), "fused.ply.vis": _visibility(seen)}


def _seen(cloud: Cloud, camera: Camera, depth: DepthMap) -> Bools:
    """(n,) does a view's depth map hold each point?"""
    x, z = project(camera, cloud.points.astype(np.float64))
    column, row = np.rint(np.where(z[:, None] > 0, x, -1.0)).clip(-1, 1e6).astype(np.int64).T
    inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    seen = np.zeros(len(z), bool)
    there = depth.depth[row[inside], column[inside]]
    seen[inside] = np.abs(there - z[inside]) < MAX_DEPTH_ERROR * z[inside]  # False where the depth is nan
    return seen


def _ply(cloud: Cloud) -> bytes:
    """Binary little-endian PLY with the properties of COLMAP's."""
    properties = {
        **dict.fromkeys(("x", "y", "z", "nx", "ny", "nz"), ("float", "<f4")),
        **dict.fromkeys(("red", "green", "blue"), ("uchar", "u1")),
    }
    points = np.empty(len(cloud.points), dtype=[(name, code) for name, (_, code) in properties.items()])
    points["x"], points["y"], points["z"] = cloud.points.T
    points["nx"], points["ny"], points["nz"] = cloud.normals.T
    points["red"], points["green"], points["blue"] = cloud.colors.T
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    for name, (words, _) in properties.items():
        lines.append(f"property {words} {name}")
    lines += ["end_header", ""]
    return "\n".join(lines).encode() + points.tobytes()


def _visibility(seen: Bools) -> bytes:
    """The number of points (uint64), then for each one the number of its images and their indices (uint32).  seen: (n, views)."""
    counts = seen.sum(axis=1)
    # a point's own entry, its count, comes before the entries of its images
    ends = np.cumsum(counts + 1)
    starts = ends - counts - 1
    entries = np.zeros(int(ends[-1]) if len(ends) else 0, "<u4")
    is_count = np.zeros(len(entries), bool)
    is_count[starts] = True
    entries[is_count] = counts
    entries[~is_count] = np.nonzero(seen)[1]  # row by row, as the entries are
    return np.array([len(seen)], "<u8").tobytes() + entries.tobytes()

"""A closed surface through the cloud, cut where no points carry it.

References
----------
Kazhdan, Hoppe, Screened Poisson Surface Reconstruction, ACM Transactions on Graphics 32(3), 2013.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d

from ..types import Cloud, Float64s, Int32s, Uint8s
from .heights import spacing

DEEPEST = 11
"""The octree's depth is at most this: 2048 cells along the longest side, several gigabytes."""
SPARSEST = 2.0
"""Surface is cut where points lie this many levels of the octree (a factor of two each) sparser than in the median."""


@dataclass(frozen=True)
class Mesh:
    """A surface of coloured triangles."""

    vertices: Float64s
    """(n, 3) float64."""
    colors: Uint8s
    """(n, 3) uint8 RGB."""
    triangles: Int32s
    """(m, 3) int32, counterclockwise seen from outside."""


def poisson_mesh(cloud: Cloud, depth: int | None = None, coarser: int = 0) -> Mesh:
    """Mesh of a cloud.

    Parameters
    ----------
    cloud : with normals.
    depth : of the octree; None: so that its cells are about as wide as points are apart.
    coarser : so many times its cells are twice as wide then: for a surface whose detail is in the photographs on it.
    """
    points = cloud.points.astype(np.float64)
    middle = points.mean(axis=0)
    if depth is None:
        span = float(np.ptp(points, axis=0).max()) * 1.1
        depth = int(np.clip(np.ceil(np.log2(span / spacing(points))), 5, DEEPEST)) - coarser
    source = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points - middle))
    source.normals = open3d.utility.Vector3dVector(cloud.normals.astype(np.float64))
    source.colors = open3d.utility.Vector3dVector(cloud.colors / 255.0)
    # one thread: sums in the same order, the same bytes
    surface, levels = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(source, depth=depth, n_threads=1)
    carried = np.asarray(levels)
    surface.remove_vertices_by_mask(carried < np.median(carried) - SPARSEST)
    colors = (np.asarray(surface.vertex_colors) * 255 + 0.5).clip(0, 255).astype(np.uint8)
    return Mesh(np.asarray(surface.vertices) + middle, colors, np.asarray(surface.triangles).astype(np.int32))


def mesh_bytes(mesh: Mesh) -> bytes:
    """Binary little-endian PLY."""
    vertices = np.empty(len(mesh.vertices), dtype=[("X", "<f8", 3), ("rgb", "u1", 3)])
    vertices["X"], vertices["rgb"] = mesh.vertices, mesh.colors
    faces = np.empty(len(mesh.triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.triangles
    head = ["ply", "format binary_little_endian 1.0", "comment made by wbflow", f"element vertex {len(vertices)}"]
    head += [f"property double {axis}" for axis in "xyz"] + [f"property uchar {color}" for color in ("red", "green", "blue")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(head).encode() + vertices.tobytes() + faces.tobytes()

"""A mesh follows the surface and ends where the points end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d

from wbflow_stages.exports.mesh import mesh_bytes, poisson_mesh
from wbflow_stages.types import Cloud

FAR = np.array([1000.0, -500.0, 20.0])


def dome(count: int = 20_000) -> Cloud:
    """The upper half of a unit sphere, far from the origin."""
    directions = np.random.default_rng(3).normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[:, 2] = np.abs(directions[:, 2])
    ones = np.ones(count, np.float32)
    colors = np.tile(np.array([200, 100, 50], np.uint8), (count, 1))
    normals = directions.astype(np.float32)
    return Cloud((directions + FAR).astype(np.float32), normals, colors, ones, ones.astype(np.uint16), ones)


def test_open3d_reads_back_the_mesh_of_a_dome_which_stays_open_below(tmp_path: Path) -> None:
    mesh = poisson_mesh(dome())
    (tmp_path / "mesh.ply").write_bytes(mesh_bytes(mesh))
    read = open3d.io.read_triangle_mesh(tmp_path / "mesh.ply")
    vertices = np.asarray(read.vertices) - FAR
    assert len(vertices) > 5000
    assert np.array_equal(np.asarray(read.triangles), mesh.triangles)
    above = vertices[vertices[:, 2] > 0.05]
    assert np.abs(np.linalg.norm(above, axis=1) - 1).max() < 0.02
    assert vertices[:, 2].min() > -0.2, "no floor"
    assert np.abs(np.asarray(read.vertex_colors) * 255 - [200, 100, 50]).max() < 3
    read.compute_triangle_normals()
    outward = np.asarray(read.triangle_normals) * vertices[mesh.triangles[:, 0]]
    assert np.median(outward.sum(axis=1)) > 0.99


def test_the_same_cloud_gives_the_same_bytes() -> None:
    cloud = dome(3000)
    assert mesh_bytes(poisson_mesh(cloud)) == mesh_bytes(poisson_mesh(cloud))

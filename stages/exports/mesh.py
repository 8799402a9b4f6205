"""Meshes of the cloud: a closed surface, cut where no points support it, and the same textured with the photographs.

On the textured mesh each triangle shows the camera that sees it largest and sharpest.

References
----------
Kazhdan, Hoppe, Screened Poisson Surface Reconstruction, ACM Transactions on Graphics 32(3), 2013.
Lempitsky, Ivanov, Seamless Mosaicing of Image-Based Texture Maps, CVPR 2007: one view for each triangle, alike among neighbours.
Waechter, Moehrle, Goesele, Let There Be Color!, ECCV 2014: projected area covers distance, obliquity and resolution."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import open3d

from ..core.cameras import project, rays
from ..core.luminance import with_gain
from ..io.clouds import point_cloud
from ..io.rasters import jpeg, png
from ..types import Bools, Camera, Cloud, Float32s, Float64s, Frame, Int32s, Int64s, Uint8s
from .heights import spacing

MOST_DEPTH = 11
"""Largest depth of the octree: 2048 cells along the longest side, several gigabytes."""
SPARSER_LEVELS = 2.0
"""The surface is cut where the points are sparser than the median by more than this many octree levels (a factor of two each)."""


@dataclass(frozen=True)
class Mesh:
    """A surface of coloured triangles."""

    vertices: Float64s
    """(n, 3) float64."""
    colors: Uint8s
    """(n, 3) uint8 RGB."""
    triangles: Int32s
    """(m, 3) int32, counterclockwise seen from outside."""


def poisson_mesh(cloud: Cloud, coarser: int = 0) -> Mesh:
    """Mesh of a cloud with normals; cells of the octree are about as wide as the point spacing.

    coarser: number of times that the cell width is doubled, for a surface whose detail is in its texture.
    """
    points = cloud.points.astype(np.float64)
    middle = points.mean(axis=0)
    span = float(np.ptp(points, axis=0).max()) * 1.1
    depth = int(np.clip(np.ceil(np.log2(span / spacing(points))), 5, MOST_DEPTH)) - coarser
    source = point_cloud(replace(cloud, points=points - middle))
    # one thread keeps the order of sums, and so the bytes, reproducible
    surface, levels = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(source, depth=depth, n_threads=1)
    octree_levels = np.asarray(levels)
    surface.remove_vertices_by_mask(octree_levels < np.median(octree_levels) - SPARSER_LEVELS)
    colors = (np.asarray(surface.vertex_colors) * 255 + 0.5).clip(0, 255).astype(np.uint8)
    return Mesh(np.asarray(surface.vertices) + middle, colors, np.asarray(surface.triangles).astype(np.int32))


def mesh_bytes(mesh: Mesh) -> bytes:
    """Binary little-endian PLY."""
    vertices = np.empty(len(mesh.vertices), dtype=[("X", "<f8", 3), ("rgb", "u1", 3)])
    vertices["X"], vertices["rgb"] = mesh.vertices, mesh.colors
    faces = np.empty(len(mesh.triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.triangles
    header = ["ply", "format binary_little_endian 1.0", "comment made by wbflow", f"element vertex {len(vertices)}"]
    header += [f"property double {axis}" for axis in "xyz"] + [f"property uchar {color}" for color in ("red", "green", "blue")]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(header).encode() + vertices.tobytes() + faces.tobytes()


NO_VIEW = -1
"""Index of the view of a triangle that no camera sees."""
_OCCLUSION_TOLERANCE = 0.01
"""A vertex is hidden if it is farther away than the surface that a camera sees by more than this share of the depth."""
_SMOOTHING_ROUNDS = 8
"""Number of times that the scores of views are averaged over neighbouring triangles."""
_GREY_WEIGHT = 0.05
"""Weight of views without colour: they are used where no other view sees the surface."""
_COLOURLESS = 0.05
_DARKEST, _BRIGHTEST = 10, 245
"""Levels between which a pixel is used to estimate a camera's exposure."""
_BALANCE_TRIANGLES, _BALANCE_ROUNDS = 50_000, 20
"""Exposures are equalised on about this many triangles, in this many rounds."""


@dataclass(frozen=True)
class View:
    """A view that textures the mesh."""

    name: str
    camera: Camera
    image: Uint8s
    """(h, w, 3) RGB, with the exposure equalised with the other views."""


@dataclass(frozen=True)
class Textured:
    """A mesh with a view for each of its triangles."""

    mesh: Mesh
    views: tuple[View, ...]
    view_of_triangle: Int32s
    """(m,) index of the view of each triangle, or `NO_VIEW`."""
    pixel: float
    """Median width on the surface of a pixel of the triangle's view; 0 if no camera sees a triangle."""


def textured(mesh: Mesh, cameras: Mapping[str, Camera], frames: Mapping[str, Frame]) -> Textured:
    """Choose a view for each triangle, and equalise the exposures of the views; masked pixels of a frame are not shown.

    Raises ValueError if no camera has a frame.
    """
    names = [name for name in sorted(cameras) if name in frames]
    if not names:
        raise ValueError("no camera has a frame to show")
    scene = scene_of(mesh.vertices, mesh.triangles)
    visible = [_visible_triangles(mesh, scene, cameras[name], frames[name].mask) for name in names]
    gains = _exposure_gains(mesh, visible, [cameras[name] for name in names], [frames[name].image for name in names])
    weights = _view_weights([frames[name] for name in names])
    chosen = _choose_views(mesh, [_Visible(view.triangles, view.area * w) for view, w in zip(visible, weights, strict=True)])
    views = (View(name, cameras[name], with_gain(frames[name].image, gain)) for name, gain in zip(names, gains, strict=True))
    return Textured(mesh, tuple(views), chosen, _median_pixel(mesh, visible, chosen))


def scene_of(vertices: Float64s, triangles: Int32s) -> open3d.t.geometry.RaycastingScene:
    """Ray-casting scene of a surface.  vertices (n, 3) near the origin, since rays are of single precision."""
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(_tensor(vertices.astype(np.float32)), _tensor(triangles.astype(np.uint32)))
    return scene


def cast(scene: open3d.t.geometry.RaycastingScene, origins: Float64s, directions: Float64s) -> dict[str, Any]:
    """First hits of rays (n, 3): `t_hit`, `primitive_ids`, `primitive_uvs`."""
    rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=1)
    return {name: value.numpy() for name, value in scene.cast_rays(_tensor(rays.astype(np.float32)), nthreads=1).items()}


def _tensor(values: Any) -> open3d.core.Tensor:
    tensor: open3d.core.Tensor = open3d.core.Tensor.from_numpy(np.ascontiguousarray(values))
    return tensor


@dataclass(frozen=True)
class _Visible:
    """The triangles that a view sees."""

    triangles: Int64s
    """(k,) indices of triangles, ascending."""
    area: Float32s
    """(k,) areas of the triangles in the view, square pixels."""


def _visible_triangles(mesh: Mesh, scene: open3d.t.geometry.RaycastingScene, camera: Camera, mask: Bools) -> _Visible:
    """The triangles that lie wholly in the image, on usable pixels, face the camera and are not occluded."""
    x, z = project(camera, mesh.vertices)
    column, row = np.rint(np.where(z[:, None] > 0, x, -1.0)).clip(-1, 1e6).astype(np.int64).T
    inside = (z > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    pixels = np.where(inside, row, 0), np.where(inside, column, 0)
    visible = inside & mask[pixels] & (z < (1 + _OCCLUSION_TOLERANCE) * _surface_depth(scene, camera)[pixels])
    triangles = np.flatnonzero(visible[mesh.triangles].all(axis=1))
    a, b, c = (x[mesh.triangles[triangles, k]] for k in range(3))
    area = 0.5 * ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))
    facing = area < 0  # counterclockwise from outside is clockwise where y points down
    return _Visible(triangles[facing], -area[facing].astype(np.float32))


def _surface_depth(scene: open3d.t.geometry.RaycastingScene, camera: Camera) -> Float32s:
    """(h, w) depth of the mesh along the optical axis; inf where there is none."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1)
    directions = rays(camera, np.column_stack([x, y]).astype(np.float64)).T
    depth = cast(scene, camera.C, directions)["t_hit"]
    return np.asarray(depth.reshape(camera.height, camera.width), np.float32)


def _view_weights(frames: list[Frame]) -> Float64s:
    """Weight of the area in each view: less if it is blurred compared with the others, overexposed, or without colour."""
    sharpness = np.array([frame.sharpness if np.isfinite(frame.sharpness) else 1.0 for frame in frames])
    sharp = np.clip(sharpness / max(float(np.median(sharpness)), 1e-6), 0.25, 1.0)
    exposed = np.array([1 - frame.saturated if np.isfinite(frame.saturated) else 1.0 for frame in frames])
    coloured = np.array([frame.colour > _COLOURLESS for frame in frames])
    return np.asarray(sharp * exposed * np.where(coloured | ~coloured.any(), 1.0, _GREY_WEIGHT), np.float64)


def _choose_views(mesh: Mesh, visible: list[_Visible]) -> Int32s:
    """(m,) the view of each triangle; its area relative to the best is averaged over neighbours first, for large patches."""
    count = len(mesh.triangles)
    best_area = np.zeros(count, np.float32)
    for view in visible:
        best_area[view.triangles] = np.maximum(best_area[view.triangles], view.area)
    vertex_count, best_share, chosen = len(mesh.vertices), np.zeros(count, np.float32), np.full(count, NO_VIEW, np.int32)
    triangle_counts = np.maximum(np.bincount(mesh.triangles.ravel(), minlength=vertex_count), 1)
    for number, view in enumerate(visible):
        share = np.zeros(count)
        share[view.triangles] = view.area / best_area[view.triangles]
        for _ in range(_SMOOTHING_ROUNDS):
            at_vertices = np.bincount(mesh.triangles.ravel(), np.repeat(share, 3), vertex_count) / triangle_counts
            share = at_vertices[mesh.triangles].mean(axis=1)
        better = view.triangles[share[view.triangles] > best_share[view.triangles]]
        best_share[better], chosen[better] = share[better], number
    return chosen


def _median_pixel(mesh: Mesh, visible: list[_Visible], chosen: Int32s) -> float:
    widths = [np.zeros(0)]
    for number, view in enumerate(visible):
        is_chosen = chosen[view.triangles] == number
        a, b, c = (mesh.vertices[mesh.triangles[view.triangles[is_chosen], k]] for k in range(3))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        widths.append(np.sqrt(area / np.maximum(view.area[is_chosen], 1e-9)))
    all_widths = np.concatenate(widths)
    return float(np.median(all_widths)) if len(all_widths) else 0.0


def _exposure_gains(mesh: Mesh, visible: list[_Visible], cameras: list[Camera], images: list[Uint8s]) -> Float64s:
    """(views, 3) gains that equalise exposure: medians over triangles in several views, in alternation with their colours."""
    view_counts = np.bincount(np.concatenate([view.triangles for view in visible]), minlength=len(mesh.triangles))
    shared = np.flatnonzero(view_counts >= 2)
    shared = shared[:: max(1, len(shared) // _BALANCE_TRIANGLES)]
    log_levels = np.full((len(visible), len(shared), 3), np.nan, np.float32)
    centroids = mesh.vertices[mesh.triangles[shared]].mean(axis=1)
    for number, (view, camera, image) in enumerate(zip(visible, cameras, images, strict=True)):
        rows = np.flatnonzero(np.isin(shared, view.triangles))
        levels = sampled(image, project(camera, centroids[rows])[0])
        usable = ((levels > _DARKEST) & (levels < _BRIGHTEST)).all(axis=1)
        log_levels[number, rows[usable]] = np.log(levels[usable])
    log_levels, gains = log_levels[:, np.isfinite(log_levels[..., 0]).any(axis=0)], np.zeros((len(visible), 3))
    overlapping = np.isfinite(log_levels[..., 0]).any(axis=1)
    if not overlapping.any():
        return np.asarray(np.exp(gains))
    for _ in range(_BALANCE_ROUNDS):
        colours = np.nanmedian(log_levels + gains[:, None].astype(np.float32), axis=0)
        gains[overlapping] = np.nanmedian(colours[None] - log_levels[overlapping], axis=1)
        gains[overlapping] -= gains[overlapping].mean(axis=0)
    return np.asarray(np.exp(gains), np.float64)


def sampled(image: Uint8s, x: Float64s) -> Float32s:
    """(n, 3) colours of an image at pixels (n, 2), bilinear."""
    column, row = (np.ascontiguousarray(x[:, k : k + 1], np.float32) for k in (0, 1))
    parts = [slice(k, k + 30_000) for k in range(0, len(x), 30_000)]  # cv2.remap is limited to fewer than 32,768 rows
    out = [cv2.remap(image, column[part], row[part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for part in parts]
    return np.concatenate(out).reshape(-1, 3).astype(np.float32) if out else np.zeros((0, 3), np.float32)


def object_files(found: Textured, name: str) -> Iterator[tuple[str, bytes]]:
    """Wavefront OBJ with its materials: `name`.obj, `name`.mtl, and a JPEG of every view that is shown.

    Triangles that no camera sees have the cloud's colours, one pixel each in a separate image.
    """
    shown = [number for number in range(len(found.views)) if (found.view_of_triangle == number).any()]
    pictures = {found.views[number].name: f"{name}_{found.views[number].name}.jpg" for number in shown}  # by material
    for number in shown:
        yield pictures[found.views[number].name], jpeg(found.views[number].image, 92).tobytes()
    unseen = np.flatnonzero(found.view_of_triangle == NO_VIEW)
    if len(unseen):
        side = _square_side(len(unseen))
        pixels = np.zeros((side * side, 3), np.uint8)
        pixels[: len(unseen)] = found.mesh.colors[found.mesh.triangles[unseen]].mean(axis=1)
        pictures["unseen"] = f"{name}_unseen.png"
        yield pictures["unseen"], png(pixels.reshape(side, side, 3))
    shading = "Ka 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1"
    yield f"{name}.mtl", "".join(f"newmtl {material}\n{shading}\nmap_Kd {file}\n" for material, file in pictures.items()).encode()
    yield f"{name}.obj", b"".join(_object_parts(found, name, shown, unseen))


def _object_parts(textured_mesh: Textured, name: str, shown: list[int], unseen: Int64s) -> Iterator[bytes]:
    mesh, uv_count = textured_mesh.mesh, 0
    yield f"# made by wbflow\nmtllib {name}.mtl\n".encode()
    yield _text_lines("v %.4f %.4f %.4f", mesh.vertices)
    for number in shown:
        view, triangles = textured_mesh.views[number], mesh.triangles[textured_mesh.view_of_triangle == number]
        corners, uv_index = np.unique(triangles, return_inverse=True)
        uv = (project(view.camera, mesh.vertices[corners])[0] + 0.5) / (view.camera.width, view.camera.height)
        yield _text_lines("vt %.6f %.6f", np.column_stack([uv[:, 0], 1 - uv[:, 1]]))
        yield f"usemtl {view.name}\n".encode() + _faces(triangles, uv_index.reshape(-1, 3) + uv_count)
        uv_count += len(corners)
    if len(unseen):
        side, uv_index = _square_side(len(unseen)), np.arange(len(unseen))
        yield _text_lines("vt %.6f %.6f", np.column_stack([uv_index % side + 0.5, side - uv_index // side - 0.5]) / side)
        yield b"usemtl unseen\n" + _faces(mesh.triangles[unseen], np.repeat(uv_index[:, None], 3, axis=1) + uv_count)


def _text_lines(line_format: str, rows: Float64s) -> bytes:
    return "".join(map(f"{line_format}\n".__mod__, map(tuple, rows.tolist()))).encode()


def _faces(triangles: Int32s, uv_index: Int64s) -> bytes:
    rows = np.stack([triangles + 1, uv_index + 1], axis=2).reshape(-1, 6)
    return _text_lines("f %d/%d %d/%d %d/%d", rows)


def _square_side(count: int) -> int:
    return int(np.ceil(np.sqrt(count)))

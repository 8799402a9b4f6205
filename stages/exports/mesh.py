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
_LEAST_DEPTH = 5
"""Smallest depth of the octree of the fine mesh: 32 cells along the longest side."""
_CUBE_SCALE = 1.1
"""Side of the octree's cube over that of the cloud; open3d's own default."""
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
    span = float(np.ptp(points, axis=0).max()) * _CUBE_SCALE
    depth = int(np.clip(np.ceil(np.log2(span / spacing(points))), _LEAST_DEPTH, MOST_DEPTH)) - coarser
    source = point_cloud(replace(cloud, points=points - middle))
    # one thread keeps the order of sums, and so the bytes, reproducible
    surface, levels = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(source, depth=depth, n_threads=1)
    # open3d calls them densities: the depth of the octree at each vertex, deeper where points are denser
    octree_levels = np.asarray(levels)
    surface.remove_vertices_by_mask(octree_levels < np.median(octree_levels) - SPARSER_LEVELS)
    colors = (np.asarray(surface.vertex_colors) * 255 + 0.5).clip(0, 255).astype(np.uint8)
    return Mesh(np.asarray(surface.vertices) + middle, colors, np.asarray(surface.triangles).astype(np.int32))


def mesh_bytes(mesh: Mesh) -> bytes:
    """Binary little-endian PLY."""
    vertices = np.empty(len(mesh.vertices), dtype=[("X", "<f8", 3), ("rgb", "u1", 3)])
    vertices["X"] = mesh.vertices
    vertices["rgb"] = mesh.colors
    faces = np.empty(len(mesh.triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"] = 3
    faces["corners"] = mesh.triangles
    header = f"""ply
format binary_little_endian 1.0
comment made by wbflow
element vertex {len(vertices)}
property double x
property double y
property double z
property uchar red
property uchar green
property uchar blue
element face {len(faces)}
property list uchar int vertex_indices
end_header
"""
    return header.encode() + vertices.tobytes() + faces.tobytes()


NO_VIEW = -1
"""Index of the view of a triangle that no camera sees."""
_OCCLUSION_TOLERANCE = 0.01
"""A vertex is hidden if it is farther away than the surface that a camera sees by more than this share of the depth."""
_SMOOTHING_ROUNDS = 8
"""Number of times that the scores of views are averaged over neighbouring triangles."""
_GREY_WEIGHT = 0.05
"""Weight of views without colour: they are used where no other view sees the surface."""
_COLOURLESS = 0.05
"""Frames with a colourfulness of at most this have no colour."""
_LEAST_SHARPNESS_WEIGHT = 0.25
"""Smallest weight of a view because it is blurred."""
_DARKEST = 10
"""Pixels with a level of at most this are not used to estimate a camera's exposure."""
_BRIGHTEST = 245
"""Nor are pixels with at least this level."""
_BALANCE_TRIANGLES = 50_000
"""Exposures are equalised on about this many triangles; more take longer and change little."""
_BALANCE_ROUNDS = 20
"""Rounds of equalisation."""
_MOST_ROWS = 30_000
"""Pixels that are sampled at once: cv2.remap is limited to fewer than 32,768 rows."""
_JPEG_QUALITY = 92
"""JPEG quality of textures, per cent."""


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
    weighted = []
    for view, weight in zip(visible, weights, strict=True):
        weighted.append(_Visible(view.triangles, view.area * weight))
    chosen = _choose_views(mesh, weighted)
    views = []
    for name, gain in zip(names, gains, strict=True):
        views.append(View(name, cameras[name], with_gain(frames[name].image, gain)))
    return Textured(mesh, tuple(views), chosen, _median_pixel(mesh, visible, chosen))


def scene_of(vertices: Float64s, triangles: Int32s) -> open3d.t.geometry.RaycastingScene:
    """Ray-casting scene of a surface.  vertices (n, 3) near the origin, since rays are of single precision."""
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(_tensor(vertices.astype(np.float32)), _tensor(triangles.astype(np.uint32)))
    return scene


def cast(scene: open3d.t.geometry.RaycastingScene, origins: Float64s, directions: Float64s) -> dict[str, Any]:
    """First hits of rays (n, 3): `t_hit`, `primitive_ids`, `primitive_uvs`."""
    rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=1)
    hits = scene.cast_rays(_tensor(rays.astype(np.float32)), nthreads=1)
    return {name: value.numpy() for name, value in hits.items()}


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
    # 1. vertices: in the image, on usable pixels, not behind the surface seen there
    x, z = project(camera, mesh.vertices)
    column, row = np.rint(np.where(z[:, None] > 0, x, -1.0)).clip(-1, 1e6).astype(np.int64).T
    inside = (z > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    pixels = (np.where(inside, row, 0), np.where(inside, column, 0))
    seen_depth = _surface_depth(scene, camera)[pixels]
    visible = inside & mask[pixels] & (z < (1 + _OCCLUSION_TOLERANCE) * seen_depth)
    # 2. triangles, by the sign of their area in the image
    triangles = np.flatnonzero(visible[mesh.triangles].all(axis=1))
    a, b, c = _corners(x, mesh.triangles[triangles])
    area = 0.5 * ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))
    facing = area < 0  # counterclockwise from outside is clockwise where y points down
    return _Visible(triangles[facing], -area[facing].astype(np.float32))


def _corners(vertices: Float64s, triangles: Int32s) -> tuple[Float64s, Float64s, Float64s]:
    """First, second and third corners (m, k) of triangles (m, 3), from `vertices` (n, k)."""
    return vertices[triangles[:, 0]], vertices[triangles[:, 1]], vertices[triangles[:, 2]]


def _surface_depth(scene: open3d.t.geometry.RaycastingScene, camera: Camera) -> Float32s:
    """(h, w) depth of the mesh along the optical axis; inf where there is none."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1)
    directions = rays(camera, np.column_stack([x, y]).astype(np.float64)).T
    depth = cast(scene, camera.C, directions)["t_hit"]
    return np.asarray(depth.reshape(camera.height, camera.width), np.float32)


def _view_weights(frames: list[Frame]) -> Float64s:
    """Weight of the area in each view: less if it is blurred compared with the others, overexposed, or without colour."""
    # figures that were not measured are None, in arrays nan, and take nothing away
    sharpness = np.array([frame.sharpness for frame in frames], np.float64)
    sharpness = np.where(np.isfinite(sharpness), sharpness, 1.0)
    saturated = np.array([frame.saturated for frame in frames], np.float64)
    saturated = np.where(np.isfinite(saturated), saturated, 0.0)
    coloured = np.array([frame.colour is None or frame.colour > _COLOURLESS for frame in frames])

    sharp = np.clip(sharpness / max(float(np.median(sharpness)), 1e-6), _LEAST_SHARPNESS_WEIGHT, 1.0)
    exposed = 1 - saturated
    all_grey = not coloured.any()
    in_colour = np.where(coloured | all_grey, 1.0, _GREY_WEIGHT)
    return np.asarray(sharp * exposed * in_colour, np.float64)


def _choose_views(mesh: Mesh, visible: list[_Visible]) -> Int32s:
    """(m,) the view of each triangle; its area relative to the best is averaged over neighbours first, for large patches."""
    count = len(mesh.triangles)
    vertex_count = len(mesh.vertices)
    corners = mesh.triangles.ravel()
    triangle_counts = np.maximum(np.bincount(corners, minlength=vertex_count), 1)  # triangles at each vertex
    best_area = np.zeros(count, np.float32)
    for view in visible:
        best_area[view.triangles] = np.maximum(best_area[view.triangles], view.area)
    best_share = np.zeros(count, np.float32)
    chosen = np.full(count, NO_VIEW, np.int32)
    for number, view in enumerate(visible):
        share = np.zeros(count)
        share[view.triangles] = view.area / best_area[view.triangles]
        # from triangles to vertices and back: a mean over the triangles around
        for _ in range(_SMOOTHING_ROUNDS):
            at_vertices = np.bincount(corners, np.repeat(share, 3), vertex_count) / triangle_counts
            share = at_vertices[mesh.triangles].mean(axis=1)
        better = view.triangles[share[view.triangles] > best_share[view.triangles]]
        best_share[better] = share[better]
        chosen[better] = number
    return chosen


def _median_pixel(mesh: Mesh, visible: list[_Visible], chosen: Int32s) -> float:
    """Median width on the surface of a pixel of the chosen views; 0 if no triangle is seen."""
    widths = [np.zeros(0)]
    for number, view in enumerate(visible):
        is_chosen = chosen[view.triangles] == number
        a, b, c = _corners(mesh.vertices, mesh.triangles[view.triangles[is_chosen]])
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        widths.append(np.sqrt(area / np.maximum(view.area[is_chosen], 1e-9)))
    all_widths = np.concatenate(widths)
    if not len(all_widths):
        return 0.0
    return float(np.median(all_widths))


def _exposure_gains(mesh: Mesh, visible: list[_Visible], cameras: list[Camera], images: list[Uint8s]) -> Float64s:
    """(views, 3) gains that equalise exposure: medians over triangles in several views, in alternation with their colours."""
    # 1. triangles that several views see
    view_counts = np.bincount(np.concatenate([view.triangles for view in visible]), minlength=len(mesh.triangles))
    shared = np.flatnonzero(view_counts >= 2)
    shared = shared[:: max(1, len(shared) // _BALANCE_TRIANGLES)]
    # 2. logarithms of their colours (views, triangles, 3): a gain is an offset; nan where a view does not show them well
    log_levels = np.full((len(visible), len(shared), 3), np.nan, np.float32)
    centroids = mesh.vertices[mesh.triangles[shared]].mean(axis=1)
    for number, (view, camera, image) in enumerate(zip(visible, cameras, images, strict=True)):
        rows = np.flatnonzero(np.isin(shared, view.triangles))
        pixels, _ = project(camera, centroids[rows])
        levels = sampled(image, pixels)
        usable = ((levels > _DARKEST) & (levels < _BRIGHTEST)).all(axis=1)
        log_levels[number, rows[usable]] = np.log(levels[usable])
    shown = np.isfinite(log_levels[..., 0]).any(axis=0)
    log_levels = log_levels[:, shown]
    overlapping = np.isfinite(log_levels[..., 0]).any(axis=1)
    gains = np.zeros((len(visible), 3))
    if not overlapping.any():
        return np.asarray(np.exp(gains))
    # 3. colours of the triangles by the gains, and gains by these colours; the mean gain stays 1
    for _ in range(_BALANCE_ROUNDS):
        colours = np.nanmedian(log_levels + gains[:, None].astype(np.float32), axis=0)
        gains[overlapping] = np.nanmedian(colours[None] - log_levels[overlapping], axis=1)
        gains[overlapping] -= gains[overlapping].mean(axis=0)
    return np.asarray(np.exp(gains), np.float64)


def sampled(image: Uint8s, x: Float64s) -> Float32s:
    """(n, 3) colours of an image at pixels (n, 2), bilinear."""
    column = np.ascontiguousarray(x[:, :1], np.float32)
    row = np.ascontiguousarray(x[:, 1:2], np.float32)
    colours = np.zeros((len(x), 3), np.float32)
    for start in range(0, len(x), _MOST_ROWS):
        part = slice(start, start + _MOST_ROWS)
        values = cv2.remap(image, column[part], row[part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        colours[part] = values.reshape(-1, 3)
    return colours


def object_files(found: Textured, name: str) -> Iterator[tuple[str, bytes]]:
    """Wavefront OBJ with its materials: `name`.obj, `name`.mtl, and a JPEG of every view that is shown.

    Triangles that no camera sees have the cloud's colours, one pixel each in a separate image.
    """
    shown = [number for number in range(len(found.views)) if (found.view_of_triangle == number).any()]
    pictures = {}  # file names by material; materials are called as the views
    for number in shown:
        view = found.views[number]
        pictures[view.name] = f"{name}_{view.name}.jpg"
        yield pictures[view.name], jpeg(view.image, _JPEG_QUALITY).tobytes()
    unseen = np.flatnonzero(found.view_of_triangle == NO_VIEW)
    if len(unseen):
        side = _square_side(len(unseen))
        pixels = np.zeros((side * side, 3), np.uint8)
        pixels[: len(unseen)] = found.mesh.colors[found.mesh.triangles[unseen]].mean(axis=1)
        pictures["unseen"] = f"{name}_unseen.png"
        yield pictures["unseen"], png(pixels.reshape(side, side, 3))
    shading = "Ka 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1"  # colours as in the picture, without light
    materials = [f"newmtl {material}\n{shading}\nmap_Kd {file}\n" for material, file in pictures.items()]
    yield f"{name}.mtl", "".join(materials).encode()
    yield f"{name}.obj", b"".join(_object_parts(found, name, shown, unseen))


def _object_parts(textured_mesh: Textured, name: str, shown: list[int], unseen: Int64s) -> Iterator[bytes]:
    """The parts of an OBJ file: vertices, then texture coordinates and triangles of each view and of the unseen triangles.

    Parameters
    ----------
    textured_mesh, name : the mesh, and the name of its files.
    shown : indices of the views that a triangle shows.
    unseen : indices of the triangles that no view sees.
    """
    mesh = textured_mesh.mesh
    uv_count = 0  # texture coordinates so far: indices count through the whole file
    yield f"# made by wbflow\nmtllib {name}.mtl\n".encode()
    yield _text_lines("v %.4f %.4f %.4f", mesh.vertices)
    for number in shown:
        view = textured_mesh.views[number]
        triangles = mesh.triangles[textured_mesh.view_of_triangle == number]
        corners, uv_index = np.unique(triangles, return_inverse=True)
        pixels, _ = project(view.camera, mesh.vertices[corners])
        # shares of width and height; OBJ counts from the lower left corner
        uv = (pixels + 0.5) / (view.camera.width, view.camera.height)
        yield _text_lines("vt %.6f %.6f", np.column_stack([uv[:, 0], 1 - uv[:, 1]]))
        yield f"usemtl {view.name}\n".encode() + _faces(triangles, uv_index.reshape(-1, 3) + uv_count)
        uv_count += len(corners)
    if len(unseen):
        side = _square_side(len(unseen))
        uv_index = np.arange(len(unseen))
        middles = np.column_stack([uv_index % side + 0.5, side - uv_index // side - 0.5])  # of one pixel for each triangle
        yield _text_lines("vt %.6f %.6f", middles / side)
        yield b"usemtl unseen\n" + _faces(mesh.triangles[unseen], np.repeat(uv_index[:, None], 3, axis=1) + uv_count)


def _text_lines(line_format: str, rows: Float64s) -> bytes:
    """One line for each of the rows (n, k), as ASCII."""
    # the bound method of the format is the fastest way to write millions of lines
    return "".join(map(f"{line_format}\n".__mod__, map(tuple, rows.tolist()))).encode()


def _faces(triangles: Int32s, uv_index: Int64s) -> bytes:
    """Lines of triangles (m, 3), with the texture coordinates (m, 3) of their corners; OBJ counts from 1."""
    rows = np.stack([triangles + 1, uv_index + 1], axis=2).reshape(-1, 6)
    return _text_lines("f %d/%d %d/%d %d/%d", rows)


def _square_side(count: int) -> int:
    """Side of the smallest square of `count` pixels."""
    return int(np.ceil(np.sqrt(count)))

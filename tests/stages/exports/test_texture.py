"""A mesh is textured with the photograph of the camera that sees it best, never with one in which it is hidden."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import open3d
import pytest

from wbflow_stages.core.cameras import project
from wbflow_stages.exports.mesh import NO_VIEW, Mesh, object_files, textured
from wbflow_stages.exports.orthophoto import orthophoto
from wbflow_stages.types import Camera, Float64s, Frame, View

K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
DOWN = np.diag([1.0, -1.0, -1.0])
"""Rotation of a camera that looks down, with east to its right."""
SIDE_M = 4.0


def colour_at(x: Float64s) -> Float64s:
    """(n, 3) colours painted on the ground at positions x (n, 2)."""
    waves = np.column_stack([np.sin(1.7 * x[:, 0]), np.sin(2.3 * x[:, 1]), np.sin(x.sum(axis=1))])
    return np.asarray(120 + 60 * waves, np.float64)


def ground(cells: int = 40, height: float = 0.0, side: float = SIDE_M) -> Mesh:
    """A square around the origin with two triangles per cell, counterclockwise from above."""
    at = np.linspace(-side / 2, side / 2, cells + 1)
    x, y = np.meshgrid(at, at)
    vertices = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    lower = np.column_stack([first, first + 1, first + cells + 1])
    upper = np.column_stack([first + 1, first + cells + 2, first + cells + 1])
    triangles = np.concatenate([lower, upper]).astype(np.int32)
    return Mesh(vertices, colour_at(vertices[:, :2]).astype(np.uint8), triangles)


def camera_at(x: float, height: float) -> Camera:
    return Camera(K, DOWN, np.array([x, 0.0, height]), 320, 240)


def photograph(camera: Camera, gain: float = 1.0) -> Frame:
    """What a camera sees of the ground."""
    v, u = np.mgrid[0:240, 0:320].reshape(2, -1)
    rays = np.column_stack([(u - K[0, 2]) / K[0, 0], -(v - K[1, 2]) / K[1, 1]])
    image = gain * colour_at(camera.C[:2] + camera.C[2] * rays)
    return Frame(image.reshape(240, 320, 3).astype(np.uint8), np.ones((240, 320), bool), View(320, 240, K), sharpness=1.0)


def test_the_larger_view_is_used_and_exposures_are_equalised() -> None:
    near, far = camera_at(-1.5, 3.0), camera_at(0.0, 6.0)
    found = textured(ground(), {"near": near, "far": far}, {"near": photograph(near, 0.7), "far": photograph(far)})
    names = np.array([view.name for view in found.views])
    middles = found.mesh.vertices[found.mesh.triangles].mean(axis=1)
    seen_near = np.abs(project(near, middles)[0] - K[:2, 2]).max(axis=1) < 100
    assert (names[found.view_of_triangle[seen_near]] == "near").all()
    assert (names[found.view_of_triangle[middles[:, 0] > 1]] == "far").all()
    ratio = [view.image.mean() for view in found.views]
    pixels = project(far, middles[seen_near])[0].round().astype(int), project(near, middles[seen_near])[0].round().astype(int)
    levels = [found.views[k].image[x[:, 1], x[:, 0]].astype(float) for k, x in enumerate(pixels)]
    assert abs(np.median(levels[0] / levels[1]) - 1) < 0.03, ratio


def test_hidden_and_masked_ground_gets_no_texture() -> None:
    floor, board = ground(), ground(10, 1.0, 1.0)
    both = Mesh(
        np.concatenate([floor.vertices, board.vertices]),
        np.concatenate([floor.colors, board.colors]),
        np.concatenate([floor.triangles, board.triangles + len(floor.vertices)]),
    )
    camera = camera_at(0.0, 8.0)
    frame = photograph(camera)
    mask = frame.mask.copy()
    mask[:, :120] = False
    found = textured(both, {"one": camera}, {"one": replace(frame, mask=mask)})
    middles = both.vertices[both.triangles].mean(axis=1)
    below, west = (np.abs(middles[:, :2]) < 0.5).all(axis=1) & (middles[:, 2] == 0), middles[:, 0] < -1.3
    assert (found.view_of_triangle[below | west] == NO_VIEW).all()
    assert (found.view_of_triangle[(middles[:, 0] > 0.7)] == 0).all()


def test_a_camera_beneath_the_ground_gives_no_texture() -> None:
    beneath = Camera(K, np.eye(3), np.array([0.0, 0.0, -4.0]), 320, 240)
    found = textured(ground(), {"one": beneath}, {"one": photograph(camera_at(0, 4))})
    assert (found.view_of_triangle == NO_VIEW).all()


def test_open3d_reads_the_textured_mesh_with_its_colours_in_place(tmp_path: Path) -> None:
    mesh, camera = ground(), camera_at(0.8, 4.0)
    found = textured(mesh, {"one": camera}, {"one": photograph(camera)})
    for name, data in object_files(found, "mesh"):
        (tmp_path / name).write_bytes(data)
    read = open3d.io.read_triangle_mesh(tmp_path / "mesh.obj", enable_post_processing=False)
    assert len(read.triangles) == len(mesh.triangles)
    corners = np.asarray(read.vertices)[np.asarray(read.triangles)]
    uv, pictures = np.asarray(read.triangle_uvs).reshape(-1, 3, 2), [np.asarray(image) for image in read.textures]
    errors: list[Float64s] = []
    for material, picture in enumerate(pictures):
        if read.textures[material].is_empty():
            continue  # Open3D puts a texture for triangles without a material first
        chosen = np.asarray(read.triangle_material_ids) == material
        at = uv[chosen].mean(axis=1)
        height, width = picture.shape[:2]
        pixels = np.column_stack([at[:, 0] * width, at[:, 1] * height]).astype(int)  # Open3D flips v
        errors.append(np.abs(picture[pixels[:, 1], pixels[:, 0], :3] - colour_at(corners[chosen].mean(axis=1)[:, :2])))
    assert len(errors) == 2 and np.percentile(np.concatenate(errors), 99) < 8


def test_the_orthophoto_has_the_right_colours_and_is_clear_beside_the_ground() -> None:
    mesh, camera = ground(), camera_at(0.8, 4.0)
    photo = orthophoto(textured(mesh, {"one": camera}, {"one": photograph(camera)}))
    assert photo.cell == pytest.approx(0.02), "a pixel is 4 m / 300 wide"
    row, column = np.nonzero(photo.image[..., 3])
    x = np.column_stack([photo.left + (column + 0.5) * photo.cell, photo.top - (row + 0.5) * photo.cell])
    assert np.abs(photo.image[row, column, :3] - colour_at(x)).max() < 8
    assert np.abs(x).max() < SIDE_M / 2 and len(x) == pytest.approx((SIDE_M / photo.cell) ** 2, rel=0.03)


def test_a_mesh_without_any_frame_is_refused() -> None:
    with pytest.raises(ValueError, match="no camera has a frame"):
        textured(ground(), {"one": camera_at(0, 4)}, {})


def test_infrared_frames_are_not_used_where_colour_frames_see_the_mesh() -> None:
    near, far = camera_at(0.0, 3.0), camera_at(0.0, 6.0)
    grey = photograph(near)
    image = cv2.cvtColor(cv2.cvtColor(grey.image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    infrared = replace(grey, image=np.asarray(image, np.uint8), colour=0.0)
    found = textured(ground(), {"far": far, "near": near}, {"near": infrared, "far": photograph(far)})
    assert [found.views[k].name for k in np.unique(found.view_of_triangle)] == ["far"]

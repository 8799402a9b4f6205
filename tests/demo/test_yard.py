"""The demo yard: its ground truth is correct, and its pictures behave like photographs."""

from __future__ import annotations

from typing import Any, cast

import cv2
import numpy as np
import pytest
from scores import correct_matches, true_correspondences

from tests.helpers.synthetic_site import single_pair, small_yard
from wbflow_demo.render.cameras import MOUNTS, Viewpoint, camera_at, distort, pixel_rays
from wbflow_demo.render.photograph import DemoCamera, Shots
from wbflow_demo.yard import yard
from wbflow_stages.core.cameras import backproject, project


def background(camera: DemoCamera) -> np.ndarray:
    """The undistorted view (h, w, 3) without moving things, by OpenCV's own lens model."""
    middle = np.median(np.stack(camera.captures), axis=0).astype(np.uint8)
    assert camera.lens.K is not None
    return cv2.undistort(middle, camera.lens.K, camera.lens.distortion)


def test_the_same_arguments_give_the_same_bytes_on_any_number_of_threads() -> None:
    first = yard(Shots(2, 2, (96, 54), threads=1))
    second = yard(Shots(2, 2, (96, 54), threads=2))
    for a, b in zip(first.cameras, second.cameras, strict=True):
        assert all(np.array_equal(p, q) for p, q in zip(a.captures, b.captures, strict=True))
        assert np.array_equal(a.depth, b.depth)
    assert np.array_equal(first.reference.points, second.reference.points)
    other = yard(Shots(2, 2, (96, 54), seed=1))
    assert not np.array_equal(first.cameras[0].captures[0], other.cameras[0].captures[0])


def test_depth_of_one_camera_agrees_with_what_its_neighbour_sees() -> None:
    left, right = small_yard().cameras[1:3]
    v, u = np.nonzero(left.depth > 0)
    points = backproject(left.camera, np.column_stack([u, v]).astype(float), left.depth[v, u].astype(float))
    x, z = project(right.camera, points)
    pixel = np.rint(x).astype(int)
    inside = (z > 0) & (pixel >= 0).all(axis=1) & (pixel < (320, 180)).all(axis=1)
    ratio = z[inside] / right.depth[pixel[inside, 1], pixel[inside, 0]]
    assert inside.mean() > 0.6
    assert (np.abs(ratio - 1) < 0.01).mean() > 0.55
    assert (ratio < 0.97).mean() < 0.06  # a point may lie behind what the neighbour sees, hardly ever in front of it


@pytest.mark.parametrize("mount", MOUNTS, ids=lambda m: m.name)
def test_lenses_distort_as_in_opencv(mount: Viewpoint) -> None:
    camera, lens = camera_at(mount, (320, 180))
    y, x = (grid.ravel().astype(float) for grid in np.mgrid[0:180:20, 0:320:20])
    rays = pixel_rays(camera, lens, x, y).astype(float)
    straight, _ = project(camera, camera.C + rays)
    assert lens.K is not None
    turn = cv2.Rodrigues(camera.R)[0]
    theirs = cv2.projectPoints(camera.C + rays, turn, -camera.R @ camera.C, lens.K, lens.distortion)[0][:, 0]
    assert np.abs(theirs - np.column_stack([x, y])).max() < 2e-3  # rays are float32
    assert np.abs(distort(lens, straight) - np.column_stack([x, y])).max() < 2e-3
    assert np.abs(straight - np.column_stack([x, y])).max() > 2  # the distortion is not negligible


def test_pictures_agree_with_lenses_poses_and_depth() -> None:
    """Warped by the true depth, one view resembles its neighbour; with 3 % error of the depth, it does not."""
    left, right = small_yard().cameras[1:3]
    one, other = (cv2.cvtColor(background(c), cv2.COLOR_RGB2GRAY).astype(np.float32) for c in (left, right))

    def likeness(depth_error: float) -> float:
        y, x = np.divmod(np.arange(320 * 180), 320)
        points = backproject(
            left.camera, np.column_stack([x, y]).astype(float), left.depth.ravel().astype(float) * (1 + depth_error)
        )
        seen, _ = project(right.camera, points)
        map1, map2 = seen.T.reshape(2, 180, 320).astype(np.float32)
        warped = cv2.remap(other, map1, map2, cv2.INTER_LINEAR, borderValue=-1)
        use = (warped > 0) & (one > 0) & left.mask
        fine = [image - cv2.blur(image, (15, 15)) for image in (one, warped)]
        return float(np.corrcoef(fine[0][use], fine[1][use])[0, 1])

    assert likeness(0.0) > 0.6
    assert likeness(0.0) > likeness(0.03) + 0.2
    assert likeness(0.0) > likeness(-0.03) + 0.2


def test_a_small_part_of_every_picture_moves_between_captures() -> None:
    for camera in small_yard().cameras:
        first, second = (cv2.GaussianBlur(c, (0, 0), 1.5).astype(np.float32) for c in camera.captures[:2])
        gain = np.median((first + 1) / (second + 1))
        changed = (np.abs(first - gain * second).max(axis=-1) > 40) & camera.mask
        assert 0.002 < changed.mean() < 0.25


def test_the_burned_in_clock_lies_in_the_masked_area() -> None:
    camera = small_yard().cameras[0]
    differs = np.abs(np.diff([c.astype(int).max(axis=-1) for c in camera.captures[:2]], axis=0))[0] > 100
    assert differs[~camera.mask].any()
    assert all(c[~camera.mask].max() > 230 for c in camera.captures)
    assert 0.01 < 1 - camera.mask.mean() < 0.04


def test_reference_points_lie_on_surfaces_that_two_cameras_see() -> None:
    site = small_yard()
    cloud, votes = site.reference, np.zeros(len(site.reference.points), int)
    for c in site.cameras:
        x, z = project(c.camera, cloud.points.astype(float))
        pixel = np.rint(x).astype(int)
        inside = (z > 0) & (pixel >= 0).all(axis=1) & (pixel < (320, 180)).all(axis=1)
        depth = c.depth[pixel[inside, 1], pixel[inside, 0]]
        votes[inside] += np.abs(z[inside] - depth) < 2 * site.voxel_m + 0.01 * depth
    assert len(votes) > 50_000
    assert (votes >= 2).mean() > 0.97
    toward = np.max([np.einsum("ni,ni->n", cloud.normals, c.camera.C - cloud.points) for c in site.cameras], axis=0)
    assert (toward > 0).mean() > 0.99


def test_cameras_form_a_connected_half_ring() -> None:
    axes = np.array([camera_at(mount, (1280, 720))[0].R[2] for mount in MOUNTS])
    angles = np.degrees(np.arccos(np.clip(axes @ axes.T, -1, 1)))
    assert ((np.diag(angles, 1) > 13) & (np.diag(angles, 1) < 30)).all()
    assert angles.max() > 60


def test_night_is_dark_and_noisy_and_has_the_same_geometry() -> None:
    day, night = small_yard().cameras[1], small_yard("night").cameras[1]
    assert np.array_equal(day.depth, night.depth)
    assert night.captures[0].mean() < 0.75 * day.captures[0].mean()

    def noise(camera: DemoCamera) -> float:
        a, b = (c.astype(np.float32)[20:] for c in camera.captures[:2])
        gain = np.median((a + 1) / (b + 1))
        difference = (a - gain * b) / (a + gain * b + 1)  # relative to the brightness
        return float(np.median(np.abs(difference - np.median(difference))))

    assert noise(night) > 2 * noise(day)


def test_neighbours_have_many_true_sift_matches_and_some_false_ones() -> None:
    left, right = single_pair().cameras
    sift = cv2.SIFT.create(3000, contrastThreshold=0.02)
    found = []
    for camera in (left, right):
        assert camera.lens.K is not None
        mask = cv2.undistort(camera.mask.astype(np.uint8), camera.lens.K, camera.lens.distortion)
        points, descriptors = sift.detectAndCompute(cv2.cvtColor(background(camera), cv2.COLOR_RGB2GRAY), mask)
        found.append((np.array([p.pt for p in points]), descriptors))
    matches = cv2.BFMatcher(crossCheck=True).match(found[0][1], found[1][1])
    pairs = cv2.BFMatcher().knnMatch(found[0][1], found[1][1], k=2)
    distinct = {first.queryIdx for first, second in pairs if first.distance < 0.8 * second.distance}
    rows = np.array([(m.queryIdx, m.trainIdx) for m in matches if m.queryIdx in distinct])
    correct = correct_matches(found[0][0][rows[:, 0]], found[1][0][rows[:, 1]], left.camera, left.depth, right.camera)
    assert correct.sum() > 120
    assert 0.5 < correct.mean() < 0.98


def test_neighbours_share_most_of_what_they_see() -> None:
    left, right = small_yard().cameras[1:3]
    x1, _ = true_correspondences(left.camera, left.depth, right.camera, right.depth, step=4)
    assert len(x1) > 0.4 * (320 // 4) * (180 // 4)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (Shots(9, 3, (96, 54)), "1 to 8 cameras"),
        (Shots(2, 0, (96, 54)), "at least 1 capture"),
        (Shots(1, 1, (64, 36), light=cast(Any, "noon")), "noon"),
    ],
)
def test_impossible_arguments_are_refused(asked: Shots, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        yard(asked)

"""Patches of the ground are found in another view within a search radius, if nothing else there looks the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.helpers.flat_ground import cameras, frame_of, texture
from wbflow_stages.core.epipolar import apply_homography
from wbflow_stages.core.rotations import rotation_matrix
from wbflow_stages.mvs.ground import ground_homography
from wbflow_stages.mvs.ground_prior import ground_matches
from wbflow_stages.types import Camera, Float32s

PLANE = np.array([0.0, 0.0, 1.0, 0.0])


def images_and_cameras(ground: Float32s) -> tuple[tuple[Float32s, Float32s], tuple[Camera, Camera]]:
    one, two = list(cameras().values())[:2]
    return (grey(one, ground), grey(two, ground)), (one, two)


def grey(camera: Camera, ground: Float32s) -> Float32s:
    return np.asarray(frame_of(camera, ground).image[..., 0], dtype=np.float32)


def test_ground_is_matched_to_a_fraction_of_a_pixel_with_inexact_cameras() -> None:
    images, (one, two) = images_and_cameras(texture())
    turned = replace(two, R=rotation_matrix(np.radians([0.3, -0.4, 0.2])) @ two.R)
    x1, x2 = ground_matches(images, (one, turned), PLANE, 8.0)
    error = np.linalg.norm(apply_homography(ground_homography(one, two, PLANE), x1) - x2, axis=1)
    assert len(x1) > 300 and np.median(error) < 0.2 and np.mean(error < 1) > 0.95


def test_stones_that_repeat_within_the_search_radius_are_not_matched() -> None:
    stone = texture()[:20, :20]
    images, pair = images_and_cameras(np.tile(stone, (45, 45)))
    other, _ = images_and_cameras(texture())
    assert len(ground_matches(images, pair, PLANE, 16.0)[0]) < 0.02 * len(ground_matches(other, pair, PLANE, 16.0)[0])


def test_cameras_beneath_the_plane_match_nothing_on_it() -> None:
    images, pair = images_and_cameras(texture())
    assert len(ground_matches(images, pair, np.array([0.0, 0.0, 1.0, -10.0]), 8.0)[0]) == 0

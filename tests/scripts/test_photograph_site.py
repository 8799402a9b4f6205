"""Photographs as sites of a fault bench: the stated distortion removes the distortion of the simulated lens."""

from __future__ import annotations

import cv2
import numpy as np
from photograph_site import LENS, has_depth, resized, sampled, through_lens

from wbflow_stages.types import Camera

WHOLE = Camera(np.array([[900.0, 0, 640.5], [0, 905.0, 420.0], [0, 0, 1]]), np.eye(3), np.zeros(3), 1280, 860)


def test_undistorting_a_capture_gives_the_photograph_at_a_smaller_size() -> None:
    camera = resized(WHOLE, 320)
    v, u = np.mgrid[0:860, 0:1280]
    waves = np.stack([128 + 60 * np.sin(u / 40), 128 + 60 * np.sin(v / 40), 128 + 60 * np.cos((u + v) / 50)], axis=2)
    picture = waves.astype(np.uint8)
    straight = cv2.undistort(through_lens(picture, WHOLE, camera), camera.K, LENS)
    small = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    inner = np.s_[20:-20, 20:-20]
    assert np.abs(straight[inner].astype(float) - small[inner]).max() < 6
    distorted = through_lens(picture, WHOLE, camera)
    assert np.abs(distorted[inner].astype(float) - small[inner]).max() > 40


def test_the_depth_map_of_a_smaller_camera_is_sampled_along_the_same_rays() -> None:
    camera = resized(WHOLE, 320)
    v, u = np.mgrid[0:860, 0:1280].astype(np.float32)
    plane = (5 + 0.002 * u + 0.001 * v).astype(np.float32)
    small = sampled(plane, WHOLE, camera)
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32)
    np.testing.assert_allclose(small, 5 + 0.002 * (4 * u + 1.5) + 0.001 * (4 * v + 1.5), atol=0.002)


def test_points_are_known_only_where_the_laser_has_measured_depth() -> None:
    depth = np.zeros((860, 1280), np.float32)
    depth[420, 640] = 5.0
    X = np.array([[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 0.0, -3.0], [90.0, 0.0, 3.0]])
    np.testing.assert_array_equal(has_depth(depth, WHOLE, X), [True, False, False, False])

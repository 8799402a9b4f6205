"""Cameras of very different resolution are compared at a resolution that both have."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from tests.helpers.exact_scene import make_yard, true_depth
from wbflow_stages.core.cameras import scaled_intrinsics
from wbflow_stages.fusion.pair_depth import pair_depth
from wbflow_stages.rectification.warping import warp
from wbflow_stages.refine import refine
from wbflow_stages.types import Camera, DepthMap, Frame, Rectification

COARSE = 4


def finer(frame: Frame, camera: Camera, times: int) -> tuple[Frame, Camera]:
    """The same view with `times` as many pixels along each side; the added detail is noise."""
    size = times * camera.width, times * camera.height
    rng = np.random.default_rng(2)
    image = np.asarray(cv2.resize(frame.image, size, interpolation=cv2.INTER_CUBIC), np.float64)
    noisy = np.asarray(np.clip(image + rng.normal(0, 8, image.shape), 0, 255), np.uint8)
    K = scaled_intrinsics(camera.K, times, times)
    view = replace(frame.view, width=size[0], height=size[1], K=K)
    return Frame(noisy, np.ones(size[::-1], np.bool_), view), replace(camera, K=K, width=size[0], height=size[1])


def test_detail_finer_than_rectified_pixels_is_smoothed() -> None:
    rng = np.random.default_rng(0)
    image = np.asarray(np.clip(rng.normal(128, 40, (400, 480)), 0, 255), np.uint8)
    known = Rectification("hartley", "", np.diag([0.25, 0.25, 1.0]), np.eye(3), (118, 98), (470, 390), 0.0, 9.0, 0.0, 0.0, 10.0)
    assert warp(known, 1, image)[4:-4, 4:-4].std() < 16
    assert warp(known, 2, image)[4:-4, 4:-4].std() > 35


def test_the_depth_error_of_a_coarse_partner_is_measured_in_rectified_pixels() -> None:
    """The other view has a quarter of the pixels along each side: its error is in rectified pixels instead of its own."""
    yard = make_yard((-8, 8))
    (pair, rectification), (left, right) = next(iter(yard.rectifications.items())), yard.cameras.values()
    depth, gain = pair_depth(left, right, rectification, yard.disparities[pair], 1)
    small = replace(
        right, K=scaled_intrinsics(right.K, 1 / COARSE, 1 / COARSE), width=right.width // COARSE, height=right.height // COARSE
    )
    shrink = np.array([[1 / COARSE, 0, 0.5 / COARSE - 0.5], [0, 1 / COARSE, 0.5 / COARSE - 0.5], [0, 0, 1]])
    assert rectification.H2 is not None
    coarse = replace(rectification, H2=rectification.H2 @ np.linalg.inv(shrink))
    depth_too, gain_too = pair_depth(left, small, coarse, yard.disparities[pair], 1)
    known = np.isfinite(depth)
    np.testing.assert_allclose(depth_too[known], depth[known], rtol=1e-4)
    np.testing.assert_allclose(gain_too[known], gain[known] * np.median(gain_too[known] / gain[known]), rtol=0.02)
    assert 0.7 < np.median(gain_too[known] / gain[known]) < 1.4


def test_finer_views_refine_a_view_as_well_as_views_of_its_own_size() -> None:
    yard = make_yard((-12, 0, 12), noise_px=0.3)
    name, *others = "cam+0", "cam-12", "cam+12"
    start = yard.depth(name)
    assert isinstance(start, DepthMap)
    large = {other: finer(yard.frames[other], yard.cameras[other], COARSE) for other in others}
    known = yard.frames[name], yard.cameras[name], start
    by_like = refine(*known, {n: yard.frames[n] for n in others}, {n: yard.cameras[n] for n in others})
    by_finer = refine(*known, {n: each[0] for n, each in large.items()}, {n: each[1] for n, each in large.items()})
    assert isinstance(by_like, DepthMap) and isinstance(by_finer, DepthMap)
    error = np.abs(by_finer.depth / true_depth(yard.cameras[name]) - 1)[by_finer.sure]
    assert by_finer.sure.mean() > 0.9 * by_like.sure.mean()
    assert np.median(error) < 0.005

"""The standard deviation of a point is about its error, whatever the pixel noise model assumes."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.fusion.uncertainty import along_nearest_rays, depth_variance
from wbflow_stages.fusion.visibility import ITSELF, CrossCheck
from wbflow_stages.types import Camera, DepthMap, Float64s

ROWS, COLUMNS, DEPTH = 60, 80, 20.0
EVERYWHERE = np.mgrid[0:ROWS, 0:COLUMNS].reshape(2, -1)


def reported_sigma(own: Float64s, others: Float64s, own_sigma: float, other_sigma: float) -> float:
    """Reported standard deviation, as a share of the depth, of depths with relative errors `own` (h, w), compared with agreeing
    views of relative errors `others` (n, h, w).  own_sigma, other_sigma: relative sigmas that the noise models give to both."""
    apart = np.log(np.maximum(np.abs(others - own) / np.hypot(own_sigma, other_sigma), 0.1)).sum(axis=0).astype(np.float32)
    count, flat = np.full((ROWS, COLUMNS), len(others), np.uint8), np.zeros((ROWS, COLUMNS), np.float32)
    known = np.ones((ROWS, COLUMNS), bool)
    z = (DEPTH * (1.0 + own)).astype(np.float32)
    depth = DepthMap(z, (own_sigma * z).astype(np.float32), flat, flat, known.astype(np.uint32), ("other",), known)
    check = CrossCheck(count, count.astype(np.uint16), count, apart, apart, apart, count)
    return float(np.sqrt(np.median(depth_variance(depth, check, *EVERYWHERE)))) / DEPTH


def views_of_pairs(noise: float, views: int) -> Float64s:
    """(views, h, w) errors of views, each the mean over its pairs, whose errors have the standard deviation `noise`."""
    errors = np.random.default_rng(views).normal(0, noise, (views, views, ROWS, COLUMNS))
    pairs = np.triu(np.ones((views, views)), 1)[..., None, None] * errors
    return np.asarray((pairs + pairs.swapaxes(0, 1)).sum(axis=1) / (views - 1))


@pytest.mark.parametrize("noise", [0.0005, 0.004])
@pytest.mark.parametrize("views", [3, 4, 8])
def test_the_error_is_estimated_from_views_that_share_pairs(noise: float, views: int) -> None:
    own, *others = views_of_pairs(noise, views)
    true = noise / np.sqrt(views - 1)
    # the model, wrong by up to a factor of five, has little weight
    reported = reported_sigma(own, np.stack(others), 0.001, 0.001)
    assert reported / true == pytest.approx(1.0, abs=0.35)


def test_the_noise_model_has_little_influence_where_views_disagree() -> None:
    own, *others = views_of_pairs(0.001, 6)
    low, high = (reported_sigma(own, np.stack(others), model_sigma, model_sigma) for model_sigma in (0.0003, 0.003))
    assert high / low < 1.6  # the models differ by a factor of ten


def test_a_precise_view_is_not_given_the_errors_of_coarse_views() -> None:
    rng = np.random.default_rng(0)
    fine, rough = rng.normal(0, 0.0005, (ROWS, COLUMNS)), rng.normal(0, 0.004, (3, ROWS, COLUMNS))
    assert reported_sigma(fine, rough, 0.001, 0.008) == pytest.approx(0.0005, rel=0.3)  # both models expect twice the true error
    assert reported_sigma(rough[0], fine[None], 0.008, 0.001) == pytest.approx(0.004, rel=0.4)


def test_a_view_set_on_a_plane_is_not_reported_as_exact() -> None:
    others = np.random.default_rng(0).normal(0, 0.002, (4, ROWS, COLUMNS))
    plane = np.zeros((ROWS, COLUMNS))
    assert reported_sigma(plane, others, 0.001, 0.001) > 0.001, "not as exact as it is flat"


def test_without_agreeing_views_sigma_comes_from_neighbours_and_the_model() -> None:
    own, no_views = np.random.default_rng(0).normal(0, 0.001, (ROWS, COLUMNS)), np.zeros((0, ROWS, COLUMNS))
    assert 0.001 < reported_sigma(own, no_views, 0.002, 0.0) < 0.002


def test_the_sigma_of_a_point_is_along_the_ray_of_the_nearest_camera() -> None:
    """A wall seen frontally from 10 m; a nearer camera sees it at an angle of 30 degrees to its surface."""
    camera = Camera(np.diag([500.0, 500.0, 1.0]), np.eye(3), np.zeros(3), 100, 100)
    points, normals = np.array([[0.0, 0.0, 10.0]] * 2), np.array([[0.0, 0.0, -1.0]] * 2)
    aslant = points[:1] + 4.0 * np.array([[np.cos(np.pi / 6), 0.0, -np.sin(np.pi / 6)]])
    variance = along_nearest_rays(np.full(2, 0.01), camera, aslant, np.array([ITSELF, 0], np.uint8), points, normals)
    np.testing.assert_allclose(np.sqrt(variance), [0.1, 0.2])

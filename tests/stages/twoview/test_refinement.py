"""Final refinement of F and E: accurate keypoints count more, and known lenses stay enforced."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.two_views import K, looking, scene, seen_by_both
from wbflow_stages.core.epipolar import fundamental_from_cameras, sampson_distance
from wbflow_stages.twoview.refinement import refine_two_view
from wbflow_stages.twoview.robust import estimate_fundamental
from wbflow_stages.types import Float64s

LEFT, RIGHT = looking(np.zeros(3), np.array([0.0, 0.0, 9.0])), looking(np.array([2.0, 0.1, 0.3]), np.array([0.0, 0.0, 9.0]))


def noisy(wrong: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x1, x2 and sizes of keypoints whose noise is a tenth of their size; `wrong` of them are only near their epipolar lines."""
    x1, x2 = seen_by_both(LEFT, RIGHT, scene())
    rng = np.random.default_rng(4)
    size = np.exp(rng.uniform(np.log(1), np.log(10), len(x1)))
    x1, x2 = (x + 0.1 * size[:, None] * rng.normal(size=x.shape) for x in (x1, x2))
    x2[:wrong] += rng.normal(0.7, 0.3, (wrong, 2)) * [0, 1]
    return x1, x2, size


def error_px(F: np.ndarray) -> float:
    return float(np.percentile(np.abs(sampson_distance(F, *seen_by_both(LEFT, RIGHT, scene()))), 95))


@pytest.mark.parametrize("lenses", [None, (K, K)])
@pytest.mark.parametrize("wrong", [0, 100])
def test_f_is_more_exact_if_small_keypoints_get_more_weight(lenses: tuple[Float64s, Float64s] | None, wrong: int) -> None:
    x1, x2, size = noisy(wrong)
    rough = estimate_fundamental(x1, x2, 1.0, seed=0)
    assert rough is not None
    inside = rough.inliers
    weighted, _ = refine_two_view(rough.F, x1[inside], x2[inside], size[inside], lenses)
    alike, _ = refine_two_view(rough.F, x1[inside], x2[inside], np.ones(inside.sum()), lenses)
    assert error_px(weighted) < 0.75 * error_px(alike)
    assert error_px(weighted) < 0.75 * error_px(rough.F)


def test_the_estimated_noise_equals_the_true_noise() -> None:
    x1, x2, size = noisy()
    _, noise = refine_two_view(fundamental_from_cameras(LEFT, RIGHT), x1, x2, size)
    np.testing.assert_allclose(noise, 0.1 * size, rtol=0.1)


def test_refined_f_fits_known_lenses_or_has_rank_two_without_them() -> None:
    x1, x2, size = noisy()
    rough = fundamental_from_cameras(LEFT, RIGHT) + 1e-7
    bare = np.linalg.svd(refine_two_view(rough, x1, x2, size)[0], compute_uv=False)
    assert bare[2] < 1e-12 * bare[1]
    E = np.linalg.svd(K.T @ refine_two_view(rough, x1, x2, size, (K, K))[0] @ K, compute_uv=False)
    np.testing.assert_allclose(E / E[0], [1, 1, 0], atol=1e-9)


def test_exact_matches_give_the_exact_f() -> None:
    x1, x2 = seen_by_both(LEFT, RIGHT, scene())
    F, noise = refine_two_view(fundamental_from_cameras(LEFT, RIGHT), x1, x2, np.ones(len(x1)))
    assert error_px(F) < 1e-6 and (noise > 0).all()

"""Two views with unknown lenses: F is that of plausible cameras, and is rejected if only implausible ones explain it."""

import dataclasses

import numpy as np
import pytest

from tests.helpers.two_views import HEIGHT, WIDTH, K, geometry_of, looking, scene, seen_by_both
from wbflow_stages.core.epipolar import fundamental_from_cameras, sampson_distance
from wbflow_stages.rectify import rectify
from wbflow_stages.twoview.intrinsics_prior import MOST_IMPLAUSIBLE, refine_with_plausible_intrinsics
from wbflow_stages.twoview.refinement import refine_two_view
from wbflow_stages.twoview.robust import estimate_fundamental, estimate_with_one_lens
from wbflow_stages.types import Camera, Rectification, Rejected, View

UNKNOWN = View(WIDTH, HEIGHT)
LEFT = looking(np.zeros(3), np.array([0.0, 0.0, 9.0]))
RIGHT = looking(np.array([2.5, 0.3, 0.8]), np.array([0.3, -0.4, 9.0]))


def shallow(noise_px: float = 0.6, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Matches of a nearly flat scene, which hardly determine F off its plane."""
    rng = np.random.default_rng(seed)
    exact = seen_by_both(LEFT, RIGHT, scene(n=500, depth=(8.8, 9.0)))
    return exact[0] + rng.normal(0, noise_px, exact[0].shape), exact[1] + rng.normal(0, noise_px, exact[1].shape)


def error_px(F: np.ndarray, right: Camera = RIGHT) -> float:
    """95th percentile of the distance to the truth, all over a deep scene."""
    return float(np.percentile(np.abs(sampson_distance(F, *seen_by_both(LEFT, right, scene(depth=(5.0, 14.0))))), 95))


def with_focal(camera: Camera, factor: float) -> Camera:
    return dataclasses.replace(camera, K=camera.K * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]]))


def test_plausible_intrinsics_make_f_of_a_shallow_scene_more_exact() -> None:
    guessed = View(WIDTH, HEIGHT, K, focal_known=False)
    errors = []
    for seed in range(5):
        x1, x2 = shallow(seed=seed)
        bare, noise = refine_two_view(fundamental_from_cameras(LEFT, RIGHT), x1, x2, np.ones(len(x1)))
        errors.append([error_px(bare)])
        for view in (UNKNOWN, guessed):
            found = refine_with_plausible_intrinsics([bare], x1, x2, noise, view, view)
            assert found is not None and found.implausibility < 2
            errors[-1].append(error_px(found.F))
    of_bare, of_cameras, of_guess = np.median(errors, axis=0)
    assert of_guess < of_cameras < 0.4 * of_bare


def test_f_is_consistent_with_the_lenses_returned_with_it() -> None:
    x1, x2 = shallow()
    found = refine_with_plausible_intrinsics(
        [fundamental_from_cameras(LEFT, RIGHT)], x1, x2, np.full(len(x1), 0.9), UNKNOWN, UNKNOWN
    )
    assert found is not None
    E = np.linalg.svd(found.K2.T @ found.F @ found.K1, compute_uv=False)
    np.testing.assert_allclose(E / E[0], [1, 1, 0], atol=1e-9)


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_matches_of_a_deep_scene_determine_f_even_for_two_different_lenses(factor: float) -> None:
    right = with_focal(RIGHT, factor)
    x1, x2 = seen_by_both(LEFT, right, scene(n=4000, depth=(3.0, 14.0)), 0.1)
    bare, noise = refine_two_view(fundamental_from_cameras(LEFT, right), x1, x2, np.ones(len(x1)))
    found = refine_with_plausible_intrinsics([bare], x1, x2, noise, UNKNOWN, UNKNOWN)
    assert found is not None and found.implausibility < MOST_IMPLAUSIBLE
    assert error_px(found.F, right) < 0.1


def test_f_is_found_for_images_of_two_sizes_from_one_lens() -> None:
    """The second image is enlarged 1.5 times: both have one focal length in units of the long side."""
    x1, x2 = seen_by_both(LEFT, RIGHT, scene(), 0.1)
    big = View(WIDTH * 3 // 2, HEIGHT * 3 // 2)
    S = np.array([[1.5, 0, 0.25], [0, 1.5, 0.25], [0, 0, 1]])
    found = estimate_with_one_lens(x1, 1.5 * x2 + 0.25, UNKNOWN, big, 1.0, seed=0)
    assert found is not None and found.inliers.mean() > 0.95
    refined = refine_with_plausible_intrinsics([found.F], x1, 1.5 * x2 + 0.25, np.full(len(x1), 0.1), UNKNOWN, big)
    assert refined is not None and refined.implausibility < 1
    assert error_px(S.T @ refined.F) < 0.3
    assert refined.K2[0, 0] == pytest.approx(1.5 * refined.K1[0, 0], rel=0.1)


def test_an_f_of_implausible_intrinsics_is_refused_without_known_cameras() -> None:
    """A lens that sees 150 degrees without distortion is implausible: repetition on a wall gives such an F, cameras do not."""
    left, right = with_focal(LEFT, 0.15), with_focal(RIGHT, 0.15)
    X = scene(n=6000, depth=(3.0, 14.0))
    x1, x2 = seen_by_both(left, right, X * [5, 5, 1], 0.1)
    F = fundamental_from_cameras(left, right)
    found = refine_with_plausible_intrinsics([F], x1, x2, np.full(len(x1), 0.15), UNKNOWN, UNKNOWN)
    assert found is not None and found.implausibility > MOST_IMPLAUSIBLE
    geometry = dataclasses.replace(geometry_of(x1, x2, F), implausibility=found.implausibility)
    refused = rectify(geometry, None, None)
    assert isinstance(refused, Rejected) and refused.code == "implausible-intrinsics" and "fields of view" in refused.reason
    assert not isinstance(rectify(geometry, left, right), Rejected)


def test_plausible_intrinsics_reduce_the_row_error_of_rectification() -> None:
    x1, x2 = seen_by_both(LEFT, RIGHT, scene(n=300, depth=(7.0, 9.0)), 0.5)
    own = estimate_fundamental(x1, x2, 1.0, seed=0)
    assert own is not None
    found = refine_with_plausible_intrinsics([own.F], x1, x2, np.full(len(x1), 0.5), UNKNOWN, UNKNOWN)
    assert found is not None
    geometry = dataclasses.replace(
        geometry_of(x1, x2, found.F), noise_px=np.full(len(x1), 0.5, np.float32), view1=UNKNOWN, view2=UNKNOWN
    )
    fitted = dataclasses.replace(geometry, lens1=found.K1, lens2=found.K2)
    strict = {"max_row_error_px": 1e-6}
    errors = []
    for g in (geometry, fitted):
        refused = rectify(g, None, None, **strict)  # type: ignore[arg-type]
        assert isinstance(refused, Rejected)
        errors.append(refused.figures["row_error_px"])
    assert errors[1] < errors[0]
    assert isinstance(rectify(fitted, None, None, max_row_error_px=2 * errors[1]), Rectification)

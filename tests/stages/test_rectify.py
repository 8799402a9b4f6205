"""Rectification of exact geometry: rows agree, the epipole may be anywhere, and wrong input is rejected with the reason."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.helpers.two_views import HEIGHT, WIDTH, K, geometry_of, looking, scene, seen_by_both, two_views
from wbflow_stages.core.cameras import project
from wbflow_stages.core.epipolar import apply_homography, epipoles, fundamental_from_cameras, homogeneous
from wbflow_stages.rectification.warping import from_rectified, resampling, to_rectified
from wbflow_stages.rectify import rectify
from wbflow_stages.twoview.robust import estimate_fundamental
from wbflow_stages.types import Camera, Geometry, Rectification, Rejected, View

SIDEWAYS = np.array([2.0, 0.1, 0.0])
METHODS = ("congruent", "hartley", "hao2011", "calibrated", "polar")


def rectified(geometry: Geometry, left: Camera | None, right: Camera | None, method: str = "congruent") -> Rectification:
    result = rectify(geometry, left, right, method=method)
    assert isinstance(result, Rectification), result
    return result


def row_errors(result: Rectification, x1: np.ndarray, x2: np.ndarray) -> np.ndarray:
    return np.abs(to_rectified(result, 1, x1)[:, 1] - to_rectified(result, 2, x2)[:, 1])


@pytest.mark.parametrize("method", METHODS)
def test_every_method_puts_a_point_on_one_row_in_both_images(method: str) -> None:
    geometry, left, right = two_views(SIDEWAYS)
    result = rectified(geometry, left, right, method)
    assert result.method == method
    assert row_errors(result, geometry.x1, geometry.x2).max() < 1e-3
    assert result.vertical_p95_px < 1e-3
    assert result.size1[1] == result.size2[1]


@pytest.mark.parametrize("method", METHODS)
def test_disparity_range_and_image_sizes_contain_nearly_all_matches(method: str) -> None:
    geometry, left, right = two_views(SIDEWAYS)
    result = rectified(geometry, left, right, method)
    y1, y2 = to_rectified(result, 1, geometry.x1), to_rectified(result, 2, geometry.x2)
    disparity = y1[:, 0] - y2[:, 0]
    assert np.mean((disparity >= result.disparity_min_px) & (disparity <= result.disparity_max_px)) > 0.99
    for y, size in ((y1, result.size1), (y2, result.size2)):
        assert np.mean((y >= 0).all(axis=1) & (y <= np.array(size) - 1).all(axis=1)) > 0.99


@pytest.mark.parametrize("method", METHODS)
def test_neither_image_is_mirrored_and_pixels_keep_their_size(method: str) -> None:
    geometry, left, right = two_views(SIDEWAYS)
    result = rectified(geometry, left, right, method)
    for side, x in ((1, geometry.x1), (2, geometry.x2)):
        area = resampling(result, side, x)[0]  # type: ignore[arg-type]
        assert area.min() > 0
        assert 0.5 < np.median(area) < 2
    assert 0.7 < result.scale < 1.4
    assert result.kept1 > 0.8


@pytest.mark.parametrize("degrees", [0, 30, 60, 70, 75, 80, 85, 88, 90])
def test_the_epipole_may_lie_anywhere_from_infinity_to_the_image_centre(degrees: float) -> None:
    """The direction of the second camera from the first: sideways (0 degrees) to straight ahead (90)."""
    a = np.radians(degrees)
    geometry, left, right = two_views(2.0 * np.array([np.cos(a), 0.05, np.sin(a)]))
    for cameras in ((left, right), (None, None)):
        result = rectified(geometry, *cameras)
        assert row_errors(result, geometry.x1, geometry.x2).max() < 0.05
        back = from_rectified(result, 2, to_rectified(result, 2, geometry.x2))
        assert np.abs(back - geometry.x2).max() < 1e-4
        assert result.method == "polar" or degrees < 60
        assert result.method == "congruent" or degrees > 20
        assert result.method in ("congruent", "hartley") or "epipole" in result.reason or "infinity" in result.reason


def test_two_views_of_a_dolly_get_right_rows_in_either_order() -> None:
    geometry, left, right = two_views(np.array([0.1, 0.0, 3.0]))
    swapped = dataclasses.replace(geometry, F=geometry.F.T, x1=geometry.x2, x2=geometry.x1)
    for g, cameras in ((geometry, (left, right)), (swapped, (right, left))):
        result = rectified(g, *cameras)
        assert result.method == "polar"
        assert row_errors(result, g.x1, g.x2).max() < 0.05


DOLLY = [np.array([0.1 * np.sin(k), 0.05 * np.cos(2 * k), 0.8 * k]) for k in range(5)]


@pytest.mark.parametrize(("i", "j"), [(i, j) for i in range(5) for j in range(5) if i != j])
def test_any_two_views_of_a_dolly_get_right_rows_from_noisy_matches(i: int, j: int) -> None:
    """The cameras move towards what they see: both epipoles lie in the images."""
    left, right = (looking(place, np.array([0.0, 0.0, 9.0])) for place in (DOLLY[i], DOLLY[j]))
    X = scene()
    x1, x2 = seen_by_both(left, right, X, noise_px=0.3)
    own = estimate_fundamental(x1, x2, 1.0, seed=0)
    assert own is not None
    e1, e2 = (e[:2] / e[2] for e in epipoles(own.F))
    assert all((e >= 0).all() and (e <= [WIDTH, HEIGHT]).all() for e in (e1, e2))
    result = rectified(geometry_of(x1[own.inliers], x2[own.inliers], own.F), None, None)
    assert result.method == "polar"
    errors = row_errors(result, *seen_by_both(left, right, X))
    assert np.percentile(errors, 95) < 0.5


def test_cameras_that_see_each_other_get_rows_in_opposite_directions() -> None:
    """Both epipoles lie inside the images: along a row, the distance from one epipole falls while that from the other rises."""
    left = looking(np.array([-2.5, 0.0, 0.0]), np.array([1.0, 0.3, 2.5]))
    right = looking(np.array([2.5, 0.0, 1.0]), np.array([-1.0, -0.2, 3.5]))
    rng = np.random.default_rng(3)
    x, z = rng.uniform(-2, 2, 4000), rng.uniform(0.5, 6, 4000)
    x1, x2 = seen_by_both(left, right, np.column_stack([x, 0.9 + 0.1 * np.sin(3 * x) * np.cos(z), z]))
    geometry = geometry_of(x1, x2, fundamental_from_cameras(left, right))
    result = rectified(geometry, left, right, "polar")
    assert result.polar1 is not None and result.polar2 is not None
    assert result.polar1.direction == -result.polar2.direction
    assert row_errors(result, x1, x2).max() < 0.05


def test_edges_across_depth_jumps_do_not_shrink_the_congruent_image() -> None:
    """A wall and things far in front of it: plain least squares (`hao2011`) shrinks the first image, robust edges do not."""
    X = scene(1, 1400, (7.0, 10.0))
    wall = X[X[:, 2] > 9]
    left, right = looking(np.zeros(3), np.array([0.0, 0.0, 8.0])), looking(np.array([2.0, 0.0, 0.0]), np.array([0.0, 0.0, 8.0]))
    x1, x2 = seen_by_both(left, right, X)
    geometry = geometry_of(x1, x2, fundamental_from_cameras(left, right))
    robust, literal = rectified(geometry, left, right), rectified(geometry, left, right, "hao2011")
    assert (robust.method, literal.method) == ("congruent", "hao2011")
    on_wall = project(left, wall)[0], project(right, wall)[0]

    def width_ratio(result: Rectification) -> float:
        return float(np.std(to_rectified(result, 1, on_wall[0])[:, 0]) / np.std(to_rectified(result, 2, on_wall[1])[:, 0]))

    assert abs(width_ratio(robust) - 1) < 0.05
    assert abs(width_ratio(literal) - 1) > abs(width_ratio(robust) - 1)


def test_matches_too_scattered_for_a_congruent_net_fall_back_to_hartley() -> None:
    """Points all over a deep volume: neighbours are on no common surface, and the net would shrink the image."""
    rng = np.random.default_rng(0)
    z = rng.uniform(4, 14, 1500)
    X = np.column_stack([*(rng.uniform(-0.5, 0.5, (2, 1500)) * z), z])
    left, right = looking(np.zeros(3), np.array([0.0, 0.0, 8.0])), looking(SIDEWAYS, np.array([0.0, 0.0, 8.0]))
    x1, x2 = seen_by_both(left, right, X)
    result = rectified(geometry_of(x1, x2, fundamental_from_cameras(left, right)), left, right)
    assert result.method == "hartley" and "congruent" in result.reason
    assert result.anisotropy < 2


def test_matches_alone_give_rows_good_to_a_tenth_of_a_pixel() -> None:
    geometry, left, right = two_views(SIDEWAYS, noise_px=0.3)
    result = rectified(geometry, None, None)
    exact, _, _ = two_views(SIDEWAYS)
    assert np.percentile(row_errors(result, exact.x1, exact.x2), 95) < 0.1
    assert np.isnan(result.depth_resolution)
    assert np.isfinite(rectified(geometry, left, right).depth_resolution)


def test_depth_resolution_is_the_depth_of_one_pixel_of_disparity() -> None:
    """Sideways cameras without rotation: dz / z = z / (f b) for one pixel."""
    left = Camera(K, np.eye(3), np.zeros(3), WIDTH, HEIGHT)
    right = Camera(K, np.eye(3), np.array([1.0, 0.0, 0.0]), WIDTH, HEIGHT)
    x1, x2 = seen_by_both(left, right, scene(n=3000, depth=(9.9, 10.1)))
    result = rectified(geometry_of(x1, x2, fundamental_from_cameras(left, right)), left, right)
    assert result.depth_resolution == pytest.approx(10 / 560, rel=0.05)
    assert result.angle_deg == pytest.approx(np.degrees(1 / 10), rel=0.15)


def test_very_few_matches_are_refused_and_few_give_a_warning() -> None:
    geometry, left, right = two_views(SIDEWAYS)
    few = dataclasses.replace(geometry, x1=geometry.x1[:12], x2=geometry.x2[:12], probability=geometry.probability[:12])
    refused = rectify(few, left, right)
    assert isinstance(refused, Rejected) and "too few" in refused.reason and refused.figures["matches"] == 12
    some = dataclasses.replace(geometry, x1=geometry.x1[:40], x2=geometry.x2[:40], probability=geometry.probability[:40])
    assert rectified(some, left, right).warnings == ("few matches",)


def test_clustered_matches_without_cameras_are_refused() -> None:
    geometry, _, _ = two_views(SIDEWAYS, n=60000, noise_px=0.4)
    near = (np.abs(geometry.x1 - np.array([320.0, 288.0])) < 40).all(axis=1)
    assert near.sum() > 100
    clustered = dataclasses.replace(geometry, x1=geometry.x1[near], x2=geometry.x2[near], probability=geometry.probability[near])
    refused = rectify(clustered, None, None)
    assert isinstance(refused, Rejected) and "clustered" in refused.reason
    assert refused.figures["row_error_px"] > 0.5


@pytest.mark.parametrize("method", ["congruent", "calibrated"])
def test_matches_too_close_for_a_net_still_give_right_rows_with_known_cameras(method: str) -> None:
    """All matches are in one cell of the grid of control points."""
    geometry, left, right = two_views(SIDEWAYS, n=60000)
    near = (np.abs(geometry.x1 - np.array([333.0, 280.0])) < 12).all(axis=1)
    assert near.sum() > 20
    close = dataclasses.replace(geometry, x1=geometry.x1[near], x2=geometry.x2[near], probability=geometry.probability[near])
    result = rectified(close, left, right, method)
    assert result.method == "hartley" and "net" in result.reason
    assert row_errors(result, geometry.x1, geometry.x2).max() < 1e-3


def test_the_limit_of_the_row_error_grows_with_the_frame() -> None:
    """The same pair enlarged four times, noise included, is accepted like the original."""
    geometry, _, _ = two_views(SIDEWAYS, n=900, noise_px=0.4)
    rectified(geometry, None, None)
    S = np.array([[4.0, 0.0, 1.5], [0.0, 4.0, 1.5], [0.0, 0.0, 1.0]])
    large = dataclasses.replace(
        geometry,
        F=np.linalg.inv(S).T @ geometry.F @ np.linalg.inv(S),
        x1=4 * geometry.x1 + 1.5,
        x2=4 * geometry.x2 + 1.5,
        view1=View(4 * WIDTH, 4 * HEIGHT),
        view2=View(4 * WIDTH, 4 * HEIGHT),
    )
    rectified(large, None, None)
    refused = rectify(large, None, None, max_row_error_px=0.1)
    assert isinstance(refused, Rejected) and refused.figures["row_error_px"] > 0.5
    assert refused.figures["allowed_px"] == pytest.approx(0.1 * 4 * WIDTH / 768)


def test_exact_matches_among_rough_ones_make_rows_acceptable() -> None:
    geometry, _, _ = two_views(SIDEWAYS)
    rng = np.random.default_rng(0)
    noise = np.where(np.arange(len(geometry.x1)) % 5 == 0, 0.05, 2.0)
    x2 = geometry.x2 + noise[:, None] * rng.normal(size=geometry.x2.shape)
    rough = dataclasses.replace(geometry, x2=x2)
    assert isinstance(rectify(rough, None, None), Rejected)
    rectified(dataclasses.replace(rough, noise_px=noise.astype(np.float32)), None, None)


def test_an_f_that_is_probably_wrong_is_refused_unless_cameras_replace_it() -> None:
    geometry, left, right = two_views(SIDEWAYS)
    doubtful = dataclasses.replace(geometry, score=-0.5, agreement=0.1)
    refused = rectify(doubtful, None, None)
    assert isinstance(refused, Rejected) and "wrong" in refused.reason and refused.figures["score"] == -0.5
    assert row_errors(rectified(doubtful, left, right), geometry.x1, geometry.x2).max() < 1e-3


def test_matches_in_a_strip_do_not_determine_the_rows_of_the_rest() -> None:
    """Matches all over the scene determine its epipolar lines; matches in a strip do not determine those of the rest."""
    geometry, _, _ = two_views(SIDEWAYS, noise_px=0.4)
    rectified(geometry, None, None)
    strip = geometry.x1[:, 1] < 0.2 * HEIGHT
    assert strip.sum() > 100
    part = dataclasses.replace(geometry, x1=geometry.x1[strip], x2=geometry.x2[strip], probability=geometry.probability[strip])
    refused = rectify(part, None, None)
    assert isinstance(refused, Rejected) and "epipolar lines" in refused.reason


def test_almost_no_baseline_is_refused_with_and_without_cameras() -> None:
    geometry, left, right = two_views(np.array([0.05, 0.0, 0.0]))
    known = rectify(geometry, left, right)
    assert isinstance(known, Rejected) and "baseline" in known.reason and known.figures["angle_deg"] < 0.7
    unknown = rectify(geometry, None, None)
    assert isinstance(unknown, Rejected) and "homography" in unknown.reason
    agreed = rectify(dataclasses.replace(geometry, score=-6.0, agreement=0.95, angle_deg=0.3), None, None)
    assert isinstance(agreed, Rejected) and "baseline" in agreed.reason and agreed.figures["angle_deg"] == 0.3


def test_a_flat_scene_is_refused_only_without_known_cameras() -> None:
    left, right = looking(np.zeros(3), np.array([0.0, 0.0, 9.0])), looking(SIDEWAYS, np.array([0.0, 0.0, 9.0]))
    x1, x2 = seen_by_both(left, right, scene(depth=(9.0, 9.0 + 1e-9)))
    geometry = geometry_of(x1, x2, fundamental_from_cameras(left, right))
    refused = rectify(geometry, None, None)
    assert isinstance(refused, Rejected) and "flat" in refused.reason
    assert row_errors(rectified(geometry, left, right), x1, x2).max() < 1e-6


def test_a_mirrored_image_is_refused() -> None:
    """If one photograph is mirrored, rows and the order of x still fit perfectly: only the handedness reveals it."""
    geometry, _, _ = two_views(SIDEWAYS)
    mirror = np.array([[-1.0, 0.0, WIDTH - 1], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    flipped = dataclasses.replace(
        geometry, x2=apply_homography(mirror, geometry.x2), F=np.asarray(np.linalg.inv(mirror).T @ geometry.F)
    )
    for method in ("congruent", "hartley", "polar"):
        refused = rectify(flipped, None, None, method=method)
        assert isinstance(refused, Rejected) and ("mirrored" in refused.reason or "wrong" in refused.reason), (method, refused)
    refused = rectify(flipped, None, None)
    assert isinstance(refused, Rejected) and "mirrored" in refused.reason


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_f_is_refused(seed: int) -> None:
    """Look-alikes: every match obeys F, but its partner is anywhere on the epipolar line."""
    rng = np.random.default_rng(seed)
    geometry, _, _ = two_views(SIDEWAYS)
    x1 = geometry.x1
    line = homogeneous(x1) @ geometry.F.T
    x = rng.uniform(0, WIDTH, len(x1))
    x2 = np.column_stack([x, -(line[:, 0] * x + line[:, 2]) / line[:, 1]])
    inside = (x2[:, 1] > 0) & (x2[:, 1] < HEIGHT)
    result = rectify(geometry_of(x1[inside], x2[inside], geometry.F), None, None)
    assert isinstance(result, Rejected) and "wrong" in result.reason


def test_cameras_that_contradict_the_matches_are_refused() -> None:
    geometry, left, right = two_views(SIDEWAYS)
    turned = dataclasses.replace(right, C=right.C + np.array([0.0, 1.5, 0.0]))
    refused = rectify(geometry, left, turned)
    assert isinstance(refused, Rejected) and "contradict" in refused.reason


def test_the_calibrated_method_needs_cameras() -> None:
    with pytest.raises(ValueError, match="needs left"):
        rectify(two_views(SIDEWAYS)[0], None, None, method="calibrated")


def test_unknown_methods_and_unknown_parameters_are_refused() -> None:
    geometry, left, right = two_views(SIDEWAYS)
    with pytest.raises(ValueError, match="congruent, hao2011, hartley, calibrated, polar"):
        rectify(geometry, left, right, method="foo")
    with pytest.raises(TypeError, match="'congruent' does not read 'tilt'"):
        rectify(geometry, left, right, tilt="never")


def test_a_function_of_the_same_signature_is_used_as_a_method() -> None:
    geometry, left, right = two_views(SIDEWAYS)
    found = rectify(geometry, left, right, method="tests.helpers.plug_ins:shifted", shift_px=11.0)
    assert isinstance(found, Rectification) and found.method == "tests.helpers.plug_ins:shifted"
    assert row_errors(found, geometry.x1, geometry.x2).max() < 1e-3


def test_the_same_input_gives_the_same_bytes() -> None:
    geometry, left, right = two_views(SIDEWAYS, noise_px=0.2)
    first, second = rectified(geometry, left, right), rectified(geometry, left, right)
    assert first.H1 is not None and second.H1 is not None
    assert first.H1.tobytes() == second.H1.tobytes()

"""Dense matching on texture of known disparity, whatever the matcher."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.helpers.dots import as_they_are, frame_of, stereo_pair, texture, true_disparity
from tests.helpers.laser import FOUNTAIN, laser_matches, photograph
from tests.helpers.two_views import geometry_of, looking
from wbflow_stages.core.epipolar import apply_homography, fundamental_from_cameras
from wbflow_stages.disparity import match_dense
from wbflow_stages.fusion.pair_depth import sample_disparity
from wbflow_stages.rectification.warping import disparity_px, from_rectified, to_rectified
from wbflow_stages.rectify import rectify
from wbflow_stages.types import INVALID, Camera, Disparity, Frame, Rectification, Rejected

NAMES = ("sgbm", "patchmatch")


def matched(left: Frame, right: Frame, rectification: Rectification, matcher: str) -> Disparity:
    result = match_dense(left, right, rectification, matcher=matcher)
    assert isinstance(result, Disparity), result
    return result


def case(offset: float = 20.0, slope: float = 0.04) -> tuple[Frame, Frame, Rectification, np.ndarray]:
    left, right = stereo_pair(offset=offset, slope=slope)
    truth = true_disparity(left.shape[0], left.shape[1], offset, slope)
    rectification = as_they_are(left, right, float(np.floor(truth.min() - 3)), float(np.ceil(truth.max() + 3)))
    return frame_of(left), frame_of(right), rectification, truth


def visible(truth: np.ndarray) -> np.ndarray:
    """Pixels whose partner lies well inside the right image."""
    x = np.arange(truth.shape[1]) - truth
    return np.asarray((x > 8) & (x < truth.shape[1] - 9))


@pytest.mark.parametrize("matcher", NAMES)
@pytest.mark.parametrize("offset", [20.0, -15.0, 0.0])
def test_disparity_of_both_views_is_found_to_a_fraction_of_a_pixel(matcher: str, offset: float) -> None:
    left, right, rectification, truth = case(offset)
    found = matched(left, right, rectification, matcher)
    d1, d2 = disparity_px(found, 1), disparity_px(found, 2)
    inside = visible(truth)
    error = np.abs(d1 - truth)[inside]
    assert np.mean(error < 1) > 0.85
    assert np.nanmedian(error) < 0.15
    assert np.nanmean(error > 2) < 0.02
    rows, columns = np.nonzero(~np.isnan(d2))
    x1 = np.rint(columns + d2[rows, columns]).astype(int)
    known = (x1 >= 0) & (x1 < truth.shape[1])
    assert known.mean() > 0.98
    assert np.mean(np.abs(truth[rows[known], x1[known]] - d2[rows[known], columns[known]]) < 1.5) > 0.97
    assert found.density > 0.75


@pytest.mark.parametrize("matcher", NAMES)
def test_masked_and_saturated_pixels_are_never_matched_in_either_image(matcher: str) -> None:
    left, right, rectification, _ = case()
    mask, image = right.mask.copy(), left.image.copy()
    mask[60:100, 80:120] = False
    image[20:40, 100:140] = 255
    found = matched(Frame(image, left.mask, left.view), Frame(right.image, mask, right.view), rectification, matcher)
    assert (found.left[20:40, 100:140] == INVALID).all()
    assert (found.right[60:100, 80:120] == INVALID).all()
    d1, d2 = disparity_px(found, 1), disparity_px(found, 2)
    dark = np.asarray(~(image >= 254).all(axis=2))
    for d, sign, allowed in ((d1, -1, mask), (d2, 1, dark)):
        rows, columns = np.nonzero(~np.isnan(d))
        target = np.rint(columns + sign * d[rows, columns]).astype(int)
        assert allowed[rows, target].all()


@pytest.mark.parametrize("matcher", NAMES)
def test_a_darker_exposure_of_one_camera_does_not_matter(matcher: str) -> None:
    left, right, rectification, truth = case()
    darker = Frame(np.rint(0.6 * right.image + 12).astype(np.uint8), right.mask, right.view)
    inside = visible(truth)
    plain = np.abs(disparity_px(matched(left, right, rectification, matcher), 1) - truth)[inside]
    other = np.abs(disparity_px(matched(left, darker, rectification, matcher), 1) - truth)[inside]
    assert np.mean(other < 1) > np.mean(plain < 1) - 0.03


@pytest.mark.parametrize("matcher", NAMES)
def test_an_object_beyond_the_disparity_range_of_the_matches_is_found(matcher: str) -> None:
    left, right, _, truth = case()
    floor = truth[:, :60]
    narrow = as_they_are(left.image[..., 0], right.image[..., 0], float(np.floor(floor.min())), float(np.ceil(floor.max() + 8)))
    y, x = np.mgrid[0:180, 0:240]
    disc = np.hypot(x - 144, y - 90) < 20
    found = disparity_px(matched(left, right, narrow, matcher), 1)
    assert truth[disc].min() > narrow.disparity_max_px
    assert np.mean(np.abs(found - truth)[disc] < 1) > 0.8


def test_starting_from_another_night_is_as_good_and_finds_new_objects() -> None:
    left, right, rectification, truth = case()
    fresh = matched(left, right, rectification, "patchmatch")
    y, x = np.mgrid[0:180, 0:240]
    disc = np.hypot(x - 144, y - 90) < 20
    level = np.rint(16 * (truth[:, :60].mean() - fresh.offset_px)).astype(np.int16)
    then = replace(fresh, left=np.where(disc, level, fresh.left), right=np.where(disc, level, fresh.right))  # without the disc
    again = match_dense(left, right, rectification, rectification, then)
    assert isinstance(again, Disparity)
    assert not np.array_equal(again.left, fresh.left)
    found, inside = disparity_px(again, 1), visible(truth)
    assert np.mean(np.abs(found - truth)[disc] < 1) > 0.8
    assert np.mean(np.abs(found - truth)[inside] < 1) > 0.85
    assert np.nanmedian(np.abs(found - truth)[inside]) < 0.15


def test_the_disparity_of_a_night_with_other_rows_is_not_used() -> None:
    left, right, rectification, _ = case()
    fresh = matched(left, right, rectification, "patchmatch")
    assert rectification.H1 is not None
    turned = replace(rectification, H1=rectification.H1 @ np.array([[1.0, 0, 2], [0, 1, 0], [0, 0, 1]]))
    again = match_dense(left, right, rectification, turned, fresh)
    assert isinstance(again, Disparity)
    assert np.array_equal(again.left, fresh.left)


@pytest.mark.parametrize("matcher", NAMES)
def test_images_of_different_widths_keep_their_own_sizes(matcher: str) -> None:
    left, right, rectification, truth = case()
    cut = as_they_are(left.image[:, :200, 0], right.image[..., 0], rectification.disparity_min_px, rectification.disparity_max_px)
    found = matched(frame_of(left.image[:, :200, 0]), right, cut, matcher)
    assert found.left.shape == found.confidence_left.shape == (180, 200)
    assert found.right.shape == found.confidence_right.shape == (180, 240)
    assert np.nanmedian(np.abs(disparity_px(found, 1) - truth[:, :200])) < 0.15


@pytest.mark.parametrize("matcher", NAMES)
def test_any_number_of_threads_gives_the_same_bytes(matcher: str) -> None:
    left, right, rectification, _ = case()
    threads = cv2.getNumThreads()
    results = []
    try:
        for n in (1, 4):
            cv2.setNumThreads(n)
            results.append(matched(left, right, rectification, matcher))
    finally:
        cv2.setNumThreads(threads)
    for name in ("left", "right", "confidence_left", "confidence_right"):
        assert getattr(results[0], name).tobytes() == getattr(results[1], name).tobytes()


@pytest.mark.parametrize("matcher", NAMES)
def test_images_that_share_nothing_are_rejected(matcher: str) -> None:
    left, right, rectification, _ = case()
    blank = Frame(np.full_like(right.image, 128), np.zeros_like(right.mask), right.view)
    refused = match_dense(left, blank, rectification, matcher=matcher)
    assert isinstance(refused, Rejected) and refused.figures["density"] < 0.01


def test_confidence_is_zero_exactly_where_disparity_is_unknown() -> None:
    left, right, rectification, _ = case()
    found = matched(left, right, rectification, "sgbm")
    np.testing.assert_array_equal(found.left == INVALID, found.confidence_left == 0)
    np.testing.assert_array_equal(found.right == INVALID, found.confidence_right == 0)


def test_a_function_of_the_same_signature_is_used_with_its_own_parameters() -> None:
    left, right, rectification, truth = case(slope=0.0)
    found = match_dense(left, right, rectification, matcher="tests.helpers.plug_ins:at_its_word")
    assert isinstance(found, Disparity)
    known = disparity_px(found, 1)[visible(truth)]
    assert np.nanmax(np.abs(known - 20)) == 0
    nearer = match_dense(left, right, rectification, matcher="tests.helpers.plug_ins:at_its_word", distance_px=22.0)
    assert isinstance(nearer, Disparity) and np.nanmax(np.abs(disparity_px(nearer, 1)[visible(truth)] - 22)) == 0


def test_unknown_matchers_and_unknown_parameters_are_refused() -> None:
    left, right, rectification, _ = case()
    with pytest.raises(ValueError, match="patchmatch, sgbm, census-sgm"):
        match_dense(left, right, rectification, matcher="foo")
    with pytest.raises(TypeError, match="'patchmatch' does not read 'ratio'"):
        match_dense(left, right, rectification, ratio=0.8)


def test_disparity_without_confidence_is_dropped_but_confirms_the_other_view() -> None:
    left, right, rectification, _ = case(slope=0.0)
    found = match_dense(left, right, rectification, matcher="tests.helpers.plug_ins:half_believed")
    assert isinstance(found, Disparity)
    assert (found.left[:90] == INVALID).all() and (found.left[90:, 40:] != INVALID).all()
    assert (found.right[:, :200] != INVALID).all()


@pytest.mark.parametrize("matcher", NAMES)
def test_a_step_towards_a_wall_is_matched_although_the_epipole_is_in_the_image(matcher: str) -> None:
    """Rows are rays from the epipole; the wall is slanted, and its homography gives its image in the second camera."""
    left = looking(np.zeros(3), np.array([0.0, 0.0, 9.0]))
    right = Camera(left.K, left.R, np.array([0.15, 0.1, 2.0]), left.width, left.height)
    normal, distance = np.array([0.3, 0.0, 1.0]), 9.0  # the wall is the plane normal . X = distance
    onto_right = left.K @ (np.eye(3) - np.outer(right.C, normal) / distance) @ np.linalg.inv(left.K)
    image1 = texture(left.height, left.width)
    image2 = cv2.warpPerspective(image1, onto_right, (left.width, left.height), borderMode=cv2.BORDER_REFLECT)
    y, x = np.mgrid[20:460:20, 20:620:20]
    x1 = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    x2 = apply_homography(onto_right, x1)
    shown = (x2 >= 0).all(axis=1) & (x2 <= np.array([left.width, left.height]) - 1).all(axis=1)
    x1, x2 = x1[shown], x2[shown]
    found = rectify(geometry_of(x1, x2, fundamental_from_cameras(left, right)), left, right)
    assert isinstance(found, Rectification) and found.method == "polar"
    d = disparity_px(matched(frame_of(image1), frame_of(image2), found, matcher), 1)
    at = to_rectified(found, 1, x1)
    values = d[np.rint(at[:, 1]).astype(int), np.rint(at[:, 0]).astype(int)]
    error = np.hypot(*(from_rectified(found, 2, np.column_stack([at[:, 0] - values, at[:, 1]])) - x2).T)
    away = np.hypot(*(x1 - x1.mean(axis=0)).T) > 60  # near the epipole nothing moves
    assert np.mean(~np.isnan(values[away])) > 0.8
    assert np.mean(error[away & ~np.isnan(values)] < 1.5) > 0.95


@pytest.mark.skipif(not FOUNTAIN.exists(), reason=f"no photographs with laser depth at {FOUNTAIN}")
@pytest.mark.parametrize(
    ("pair", "matcher", "bad", "missed"),
    [
        ((5, 4), "patchmatch", 0.009, 0.06),
        ((5, 2), "patchmatch", 0.03, 0.205),
        ((5, 9), "patchmatch", 0.025, 0.32),
        ((5, 4), "sgbm", 0.03, 0.08),
        ((5, 9), "sgbm", 0.085, 0.36),
    ],
)
def test_photographs_are_matched_within_the_measured_error_limits(
    pair: tuple[int, int], matcher: str, bad: float, missed: float
) -> None:
    """Rectified with true cameras and exact matches from laser depth; errors in pixels of image 2, at a quarter of the width."""
    left, right = (photograph(k) for k in pair)
    x1, x2 = laser_matches(left, right)
    few = np.linspace(0, len(x1) - 1, 1500).astype(int)
    view = left.frame.view
    geometry = replace(geometry_of(x1[few], x2[few], fundamental_from_cameras(left.camera, right.camera)), view1=view, view2=view)
    rectification = rectify(geometry, left.camera, right.camera)
    assert isinstance(rectification, Rectification)
    found = matched(left.frame, right.frame, rectification, matcher)
    at = to_rectified(rectification, 1, x1)
    d = sample_disparity(disparity_px(found, 1), at)
    error = np.hypot(*(from_rectified(rectification, 2, np.column_stack([at[:, 0] - d, at[:, 1]])) - x2).T)
    assert np.mean(error[~np.isnan(d)] > 2) < bad
    assert 1 - np.mean(error <= 2) < missed

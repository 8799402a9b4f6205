"""The dense matchers by themselves: slanted planes, wide ranges, faint or noisy images, and the same bytes every time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from tests.helpers.dots import stereo_pair, texture, true_disparity
from wbflow_stages.core.luminance import noise_level
from wbflow_stages.stereo.census import match_census_sgm
from wbflow_stages.stereo.matcher import DenseMatches, RectifiedPair, halved, mirrored
from wbflow_stages.stereo.patchmatch import match_patchmatch
from wbflow_stages.stereo.plane_filter import plane_deviation, smoothed
from wbflow_stages.stereo.rectified import denoised_if_noisy, with_coarse_range
from wbflow_stages.stereo.sgbm import blocks, match_in_one_piece, match_sgbm

Matcher = Callable[[RectifiedPair], DenseMatches]
MATCHERS: list[Matcher] = [match_sgbm, match_census_sgm, match_patchmatch]


def pair_of(left: np.ndarray, right: np.ndarray, low: int, high: int) -> RectifiedPair:
    valid = np.ones(left.shape, dtype=bool)
    return RectifiedPair(left.astype(np.float32), right.astype(np.float32), valid, valid, low, high)


def well_inside(truth: np.ndarray) -> np.ndarray:
    x = np.arange(truth.shape[1]) - truth
    return np.asarray((x > 10) & (x < truth.shape[1] - 11))


@pytest.mark.parametrize("matcher", MATCHERS)
@pytest.mark.parametrize("offset", [-40.0, 0.0, 15.0, 40.0])
def test_disparities_of_any_sign_are_found(matcher: Matcher, offset: float) -> None:
    left, right = stereo_pair(120, 224, offset)
    truth = true_disparity(120, 224, offset)
    found = matcher(pair_of(left, right, int(offset) - 4, int(offset) + 28))
    inside = well_inside(truth)
    assert np.mean(np.abs(found.left - truth)[inside] < 1) > 0.85
    assert found.left.shape == found.right.shape == (120, 224)


@pytest.mark.parametrize("slope", [-0.6, 0.3, 0.5])
def test_patchmatch_is_more_exact_on_slanted_planes_than_sgbm(slope: float) -> None:
    right = texture(160, 256)
    y, x = np.mgrid[0:160, 0:256].astype(np.float64)
    truth = 20 + slope * (x - 128) + 0.4 * (y - 80)
    left = _warped(right, x - truth)
    pair = pair_of(left, right, int(truth.min()) - 2, int(truth.max()) + 2)
    inside = well_inside(truth) & (np.abs(y - 80) < 70)
    errors = [np.abs(matcher(pair).left - truth)[inside] for matcher in (match_patchmatch, match_sgbm)]
    assert np.nanmedian(errors[0]) < 0.08
    assert np.mean(errors[0] < 0.5) > np.mean(errors[1] < 0.5)
    assert np.mean(errors[0] < 0.5) > 0.95


def _warped(right: np.ndarray, columns: np.ndarray) -> np.ndarray:
    rows = np.mgrid[0 : right.shape[0], 0 : right.shape[1]][0].astype(np.float32)
    return np.asarray(cv2.remap(right, columns.astype(np.float32), rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT))


@pytest.mark.parametrize("matcher", MATCHERS)
def test_matching_the_mirrored_pair_gives_the_right_view(matcher: Matcher) -> None:
    left, right = stereo_pair(120, 224)
    pair = pair_of(left, right, 16, 48)
    found, swapped = matcher(pair), matcher(mirrored(pair))
    close = np.abs(found.right - swapped.left[:, ::-1]) < 1
    assert np.mean(close[~np.isnan(found.right)]) > 0.85


def test_patchmatch_gives_the_same_bytes_twice() -> None:
    left, right = stereo_pair(96, 160)
    pair = pair_of(left, right, 16, 44)
    first, second = match_patchmatch(pair), match_patchmatch(pair)
    assert first.left.tobytes() == second.left.tobytes()
    assert first.confidence_right.tobytes() == second.confidence_right.tobytes()


def test_patchmatch_starts_a_large_pair_at_half_size(monkeypatch: pytest.MonkeyPatch) -> None:
    from wbflow_stages.stereo import patchmatch

    left, right = stereo_pair(192, 256)
    truth = true_disparity(192, 256)
    pair = pair_of(left, right, 16, 50)
    monkeypatch.setattr(patchmatch, "_DIRECT_PX", 20000)
    error = np.abs(match_patchmatch(pair).left - truth)[well_inside(truth)]
    assert np.mean(error < 1) > 0.9


def test_the_faint_texture_of_a_white_wall_is_matched() -> None:
    left, right = (240 + (image - 125) / 50 for image in stereo_pair(120, 224))
    truth = true_disparity(120, 224)
    found = match_patchmatch(pair_of(left, right, 16, 44)).left
    assert np.mean(np.abs(found - truth)[well_inside(truth)] < 1) > 0.85


def test_patchmatch_is_confident_only_where_neighbours_agree() -> None:
    """Around the disc the views see different things: pixels with confidence are wrong far less often than those without."""
    left, right = stereo_pair(180, 240)
    truth = true_disparity(180, 240)
    found = match_patchmatch(pair_of(left, right, 16, 50))
    wrong = np.abs(found.left - truth) > 2
    believed = found.confidence_left > 0
    inside = well_inside(truth)
    assert np.mean(wrong[inside & believed]) < 0.005
    assert np.mean(wrong[inside & ~believed]) > 0.08
    assert np.mean(believed[inside]) > 0.9


def test_masked_columns_have_no_disparity_and_do_not_affect_distant_ones() -> None:
    left, right = stereo_pair(120, 224)
    truth = true_disparity(120, 224)
    pair = pair_of(left, right, 16, 44)
    shown = np.ones(left.shape, dtype=bool)
    shown[:, :90] = False
    found = match_sgbm(dataclasses.replace(pair, valid_left=shown)).left
    assert np.isnan(found[:, :80]).all()
    inside = well_inside(truth) & (np.arange(224) > 100)
    assert np.mean(np.abs(found - truth)[inside] < 1) > 0.85
    nothing = dataclasses.replace(pair, valid_left=~shown & shown, valid_right=~shown & shown)
    assert np.isnan(match_sgbm(nothing).left).all()


def near_and_far() -> tuple[RectifiedPair, np.ndarray, np.ndarray]:
    """A wall at 12 px and an object at 150, search range -40 to 220: the pair, its true disparity, and what both views see."""
    wall, thing = texture(192, 524, seed=1), texture(100, 120, seed=2)
    left, right = wall[:, :512].copy(), wall[:, 12:].copy()
    left[50:150, 270:390] = right[50:150, 120:240] = thing
    truth = np.full(left.shape, 12.0)
    truth[50:150, 270:390] = 150
    seen = np.ones(left.shape, dtype=bool)
    seen[:, :20] = False
    seen[50:150, 132:252] = False
    return pair_of(left, right, -40, 220), truth, seen


def test_a_wide_range_is_matched_as_well_in_blocks_as_in_one_piece() -> None:
    pair, truth, seen = near_and_far()
    for part in (seen, seen & (truth > 100)):
        blocked, whole = (np.mean(np.abs(match(pair).left - truth)[part] < 1) for match in (match_sgbm, match_in_one_piece))
        assert blocked > 0.97 and blocked > whole - 0.01


def test_a_wide_range_gives_the_same_bytes_for_any_number_of_threads() -> None:
    pair = near_and_far()[0]
    threads = cv2.getNumThreads()
    found = []
    try:
        for n in (1, 4):
            cv2.setNumThreads(n)
            found.append(match_sgbm(pair))
    finally:
        cv2.setNumThreads(threads)
    assert found[0].left.tobytes() == found[1].left.tobytes()
    assert found[0].right.tobytes() == found[1].right.tobytes()


def test_blocks_cover_the_seen_disparities_and_little_else() -> None:
    """`seen` is disparity at half the size: a slanted wall, an object in front of it, and nothing at the right."""
    height, width, low, high = 160, 320, -300, 300
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    seen = np.where((x > 180) & (x < 230) & (y > 90), np.float32(120), -60 + 0.2 * x)
    seen[:, 240:] = np.nan
    found = blocks(seen, low, high)
    reached = np.zeros((2 * height, 2 * width), dtype=int)
    voxels = 0
    for block in found:
        rows, columns = slice(block.top, block.bottom), slice(block.left, block.right)
        reached[rows, columns] += 1
        voxels += reached[rows, columns].size * (block.high - block.low + 1)
        inside = 2 * seen[block.top // 2 : block.bottom // 2, block.left // 2 : block.right // 2]
        assert low <= block.low <= np.nanmin(inside) and np.nanmax(inside) <= block.high <= high
        assert block.high - block.low + 1 >= 90
    assert reached.max() == 1 and (reached[:, :480] == 1).all() and not reached[:, 512:].any()
    assert voxels < 0.35 * reached.size * (high - low + 1)
    assert blocks(np.full_like(seen, np.nan), low, high) == []


def test_a_range_that_cannot_be_narrowed_is_searched_in_one_block() -> None:
    seen = np.random.default_rng(0).uniform(-140, 140, (96, 128)).astype(np.float32)
    (block,) = blocks(seen, -300, 300)
    assert (block.top, block.bottom, block.left, block.right) == (0, 192, 0, 256)
    assert block.low < -260 and block.high > 260


def test_wrong_planes_are_filtered_and_contradicted_ones_doubted() -> None:
    """A noisy slanted surface of even grey with a wrong patch; speckles and what the other view contradicts are doubted."""
    y, x = np.mgrid[0:60, 0:300].astype(np.float32)
    noise = np.random.default_rng(3).normal(0, 0.2, y.shape).astype(np.float32)
    truth = 20 + 0.2 * x - 0.1 * y
    planes = np.stack([truth + noise, np.full_like(x, 0.2), np.full_like(x, -0.1)])
    planes[0, 20:24, 126:130] += 9
    cost = np.zeros_like(x)
    cost[:, 200:] = 0.7
    found = smoothed(np.full_like(x, 90), planes, cost, 0.6)[0]
    assert np.isnan(found[:, 200:]).all()
    assert np.abs(found - truth)[:, :200].max() < 0.25
    torn = truth + np.where((abs(y - 22) < 2) & (abs(x - 128) < 2), np.float32(9), np.float32(0))
    difference = np.where(x < 250, np.float32(0.5), np.float32(5))
    doubts = plane_deviation(np.stack([torn, planes[1], planes[2]]), difference)
    assert doubts[22, 128] > 3 and np.isinf(doubts[:, 250:]).all()
    assert doubts[5:55, 5:110].max() < 0.2 and doubts[0, 0] < 0.2


def test_a_second_round_of_the_plane_filter_finds_slopes_from_flat_planes() -> None:
    """The start is fronto-parallel, as from semi-global matching, on ground seen at a low angle."""
    y, x = np.mgrid[0:60, 0:120].astype(np.float32)
    truth = 30 + 0.3 * x - 0.4 * y
    flat = np.stack([truth, np.zeros_like(x), np.zeros_like(x)])
    found = smoothed(np.full_like(x, 90), flat, np.zeros_like(x), 0.6, rounds=2)
    inside = (slice(15, -15), slice(15, -15))
    assert np.abs(found[1][inside] - 0.3).max() < 0.1 and np.abs(found[2][inside] + 0.4).max() < 0.1
    assert np.abs(found[0] - truth)[inside].max() < 0.3


def test_halving_a_pair_halves_its_disparity() -> None:
    left, right = stereo_pair(120, 224)
    small = halved(pair_of(left, right, 16, 44))
    assert small.left.shape == (60, 112)
    assert small.disparity_min <= 8 and small.disparity_max >= 22
    truth = true_disparity(120, 224)[::2, ::2] / 2
    found = match_census_sgm(small).left
    assert np.median(np.abs(found - truth)[well_inside(truth)]) < 0.3


def test_the_coarse_match_finds_the_range_and_equalises_exposures() -> None:
    left, right = stereo_pair(240, 320, 30.0)
    truth = true_disparity(240, 320, 30.0)
    pair = pair_of(left, 0.5 * right + 60, 30, 42)
    ready = with_coarse_range(pair)
    assert ready.disparity_min <= truth.min() and ready.disparity_max >= np.percentile(truth, 98)
    assert abs(np.std(ready.right) / np.std(ready.left) - 1) < 0.1
    assert abs(np.mean(ready.right) - np.mean(ready.left)) < 8


def test_blank_images_keep_the_disparity_range_of_the_matches() -> None:
    blank = np.full((80, 160), 128.0)
    pair = dataclasses.replace(pair_of(blank, blank, 3, 17), valid_left=np.zeros((80, 160), dtype=bool))
    ready = with_coarse_range(pair)
    assert (ready.disparity_min, ready.disparity_max) == (3, 17)


@pytest.mark.parametrize("level", [2.0, 6.0])
def test_noise_is_distinguished_from_texture(level: float) -> None:
    smooth = cv2.GaussianBlur(texture(240, 320), (0, 0), 3).astype(np.float32)
    valid = np.ones(smooth.shape, dtype=bool)
    assert noise_level(smooth, valid) < 0.5
    noisy = (smooth + np.random.default_rng(0).normal(0, level, smooth.shape)).astype(np.float32)
    assert noise_level(noisy, valid) == pytest.approx(level, rel=0.15)
    assert noise_level(noisy, np.zeros_like(valid)) == 0


def test_noisy_pictures_are_smoothed_before_matching_and_others_unchanged() -> None:
    left, right = (cv2.GaussianBlur(image, (0, 0), 1.5).astype(np.float32) for image in stereo_pair(160, 256))
    valid = np.ones(left.shape, dtype=bool)
    np.testing.assert_array_equal(denoised_if_noisy(left, valid), left)
    rng = np.random.default_rng(0)
    noisy = [(image + rng.normal(0, 6, image.shape)).astype(np.float32) for image in (left, right)]
    truth = true_disparity(160, 256)
    as_given, smoothed = (
        np.abs(match_patchmatch(pair_of(images[0], images[1], 16, 48)).left - truth)[well_inside(truth)]
        for images in (noisy, [denoised_if_noisy(image, valid) for image in noisy])
    )
    assert np.mean(smoothed < 0.5) > np.mean(as_given < 0.5) + 0.03


@pytest.mark.parametrize(("floor", "expected"), [(-10.0, 0.0), (10.0, 20.0)])
def test_matches_behind_the_floor_are_not_accepted(floor: float, expected: float) -> None:
    """The images match at disparity 0 only; the ground is at 20.  A floor at 10 rules out 0, one at -10 does not."""
    left = texture(100, 160)
    ground, floors = (np.full(left.shape, disparity, np.float32) for disparity in (20.0, floor))
    pair = dataclasses.replace(
        pair_of(left, left, -5, 30), prior_left=ground, prior_right=ground, floor_left=floors, floor_right=floors
    )
    matches = match_patchmatch(pair)
    on = np.abs(matches.left - expected) < 1
    assert on.mean() > 0.8 or (floor > 0 and not (np.abs(matches.left) < 1).any())

"""Pooling many nights lowers the noise of depths, leaves what comes and goes unknown, and gives weak pairs a geometry."""

from __future__ import annotations

import numpy as np

from tests.helpers.two_views import HEIGHT, WIDTH, K, looking, scene, seen_by_both
from wbflow_stages.contracts.reasons import Reason
from wbflow_stages.core.epipolar import symmetric_epipolar_distance
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.other_nights import pool_depths, pool_matches
from wbflow_stages.types import DepthMap, Features, Float64s, Geometry, Matches, Rejected, View

H, W = 40, 60
TRUE = np.asarray(20 + 5 * np.mgrid[0:H, 0:W][1] / W)


def night(seed: int, sigma: float = 0.05, partners: tuple[str, ...] = ("roof",)) -> DepthMap:
    """What one night measures of the true surface."""
    rng = np.random.default_rng(seed)
    depth = (TRUE + sigma * rng.normal(size=TRUE.shape)).astype(np.float32)
    depth[rng.random(TRUE.shape) < 0.1] = np.nan
    flat = np.zeros((H, W), np.float32)
    return DepthMap(
        depth, np.full((H, W), sigma, np.float32), flat, flat, np.ones((H, W), np.uint32), partners, np.isfinite(depth)
    )


def error(depth: DepthMap) -> float:
    return float(np.nanmedian(np.abs(depth.depth - TRUE)))


def test_pooling_nights_reduces_noise_and_fills_gaps() -> None:
    nights = {str(k): night(k) for k in range(8)}
    pooled = pool_depths(nights)
    assert error(pooled) < 0.5 * error(nights["0"])
    assert np.isfinite(pooled.depth).mean() > 0.99
    assert 0.03 < float(np.nanmedian(pooled.sigma)) < 0.05  # an error common to all nights remains
    assert not np.isfinite(pooled.depth[~pooled.sure]).any()


def test_a_vehicle_in_one_night_does_not_affect_the_pooled_depth() -> None:
    nights = {str(k): night(k) for k in range(5)}
    nights["3"].depth[10:20, 10:30] = 12.0
    pooled = pool_depths(nights)
    off = np.abs(pooled.depth - TRUE)[10:20, 10:30]
    assert np.nanpercentile(off, 98) < 0.2
    assert np.isfinite(off).mean() > 0.9


def test_depth_is_unknown_where_nights_disagree() -> None:
    nights = {str(k): night(k) for k in range(4)}
    for k in range(4):
        nights[str(k)].depth[:10] = 8.0 + 3.0 * k
    nights = {k: DepthMap(d.depth, d.sigma, d.slope_x, d.slope_y, d.support, d.partners, d.sure) for k, d in nights.items()}
    assert not np.isfinite(pool_depths(nights, agree=0.1).depth[:10]).any()


def test_exact_nights_get_more_weight_and_all_partners_are_kept() -> None:
    nights = {"sharp": night(0, 0.02, ("roof", "mast")), "hazy": night(1, 0.4, ("mast",)), "haze": night(2, 0.4, ("crane",))}
    pooled = pool_depths(nights)
    assert set(pooled.partners) == {"roof", "mast", "crane"}
    roof, crane = pooled.partners.index("roof"), pooled.partners.index("crane")
    inside = np.isfinite(nights["sharp"].depth) & np.isfinite(pooled.depth)
    off = np.abs(pooled.depth - TRUE)[inside]
    assert float(np.median(off)) < 1.1 * error(nights["sharp"])
    assert ((pooled.support[inside] >> roof) & 1).mean() > 0.9
    assert ((pooled.support >> crane) & 1).any()


LEFT, RIGHT = (looking(np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, 11.0])) for x in (-6.5, 6.5))
"""Cameras whose rays meet at about 55 degrees in the middle of the scene."""
TRUE_MATCHES = seen_by_both(LEFT, RIGHT, scene(n=4000))


def matches_of_night(seed: int, again: int = 16) -> Matches:
    """Matches of a pair in one night: 16 right ones with 0.4 pixels of noise, of which `again` differ from night to night and the
    others are of the same points every night; and 8 wrong ones, the same every night."""
    own, same = np.random.default_rng(seed), np.random.default_rng(0)
    rows = np.concatenate([same.permutation(len(TRUE_MATCHES[0]))[: 16 - again], own.permutation(len(TRUE_MATCHES[0]))[:again]])
    wrong = [same.uniform(0, (WIDTH, HEIGHT), (8, 2)) for _ in "12"]
    x1, x2 = (np.vstack([x[rows] + own.normal(0, 0.4, (16, 2)), w]) for x, w in zip(TRUE_MATCHES, wrong, strict=True))
    probability = np.repeat([0.9, 0.4], [16, 8]).astype(np.float32)
    view = View(WIDTH, HEIGHT, K, focal_known=True)
    return Matches(x1, x2, None, None, probability, None, view, view, "toy")


def geometry(matches: Matches, left: Features | None = None, right: Features | None = None) -> Geometry | Rejected:
    return estimate_geometry(matches, left or keypoints(TRUE_MATCHES[0], 0, 0), right or keypoints(TRUE_MATCHES[1], 0, 0))


def keypoints(x: Float64s, seed: int, count: int = 600) -> Features:
    """Keypoints at the first `count` points, with 0.4 pixels of noise; descriptors are distinct, and equal for equal seeds."""
    rng = np.random.default_rng(seed)
    descriptors = rng.normal(size=(len(x), 32)).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    at = x[:count] + rng.normal(0, 0.4, x[:count].shape)
    frames, plain = np.repeat(3 * np.eye(2)[None], len(at), axis=0), np.zeros(len(at), np.uint8)
    return Features(
        at, frames, descriptors[:count], np.ones(len(at), np.float32), plain, View(WIDTH, HEIGHT, K, focal_known=True)
    )


def test_a_wide_pair_that_single_nights_reject_is_found_from_four_nights() -> None:
    nights = {str(seed): matches_of_night(seed) for seed in range(1, 5)}
    for night in nights.values():
        alone = geometry(night)
        assert isinstance(alone, Rejected) and alone.code == Reason.TOO_FEW_INLIERS
    together = geometry(pool_matches(nights))
    assert isinstance(together, Geometry) and together.score > 0 and 50 < together.angle_deg < 60
    assert float(np.median(symmetric_epipolar_distance(together.F, *TRUE_MATCHES))) < 0.5


def test_matches_repeated_every_night_do_not_count_as_more_evidence() -> None:
    pooled = pool_matches({str(seed): matches_of_night(seed, again=0) for seed in range(1, 5)})
    assert len(pooled.x1) <= 16 + 8 + 4  # noise may separate a few
    assert isinstance(geometry(pooled), Rejected)


def test_keypoints_of_a_night_decide_on_pooled_matches_and_make_them_more_exact() -> None:
    pooled = pool_matches({str(seed): matches_of_night(seed) for seed in range(1, 5)})
    alone, left = geometry(pooled), keypoints(TRUE_MATCHES[0], 5)
    together = geometry(pooled, left, keypoints(TRUE_MATCHES[1], 5))
    assert isinstance(alone, Geometry) and isinstance(together, Geometry)
    off = [float(np.median(symmetric_epipolar_distance(each.F, *TRUE_MATCHES))) for each in (alone, together)]
    assert together.score > 0 and together.inliers > 1.5 * alone.inliers and off[1] < 0.8 * off[0]
    unlike = geometry(pooled, left, keypoints(TRUE_MATCHES[1], 6))  # descriptors of matched keypoints differ
    assert isinstance(unlike, Geometry) and unlike.score < 0


def test_many_nights_of_unrelated_cameras_give_no_geometry() -> None:
    rng = np.random.default_rng(3)
    nothing = {k: matches_of_night(int(k)) for k in map(str, range(30))}
    for night in nothing.values():
        night.x1[:], night.x2[:] = rng.uniform(0, (WIDTH, HEIGHT), (2, 24, 2))
    assert isinstance(geometry(pool_matches(nothing)), Rejected)
    assert isinstance(geometry(pool_matches(nothing, most_per_row=100.0)), Geometry), "by chance: hence the bound"


def test_too_many_pooled_matches_are_reduced_to_well_spread_ones() -> None:
    pooled = pool_matches({str(seed): matches_of_night(seed) for seed in range(1, 40)}, most_per_row=90 / HEIGHT)
    assert len(pooled.x1) == 90
    every = np.vstack([matches_of_night(seed).x1 for seed in range(1, 40)])
    cells = [set(zip(*(x * [12 / WIDTH, 8 / HEIGHT]).astype(int).T, strict=True)) for x in (pooled.x1, every)]
    assert len(cells[0]) >= min(len(cells[1]), 85)

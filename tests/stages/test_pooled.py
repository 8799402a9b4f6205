"""Depth maps of many nights: noise falls, what comes and goes is left unknown."""

from __future__ import annotations

import numpy as np

from wbflow_stages.pooled import pool_depths
from wbflow_stages.types import DepthMap

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


def test_noise_falls_and_more_is_known() -> None:
    nights = {str(k): night(k) for k in range(8)}
    pooled = pool_depths(nights)
    assert error(pooled) < 0.5 * error(nights["0"])
    assert np.isfinite(pooled.depth).mean() > 0.99
    assert 0.03 < float(np.nanmedian(pooled.sigma)) < 0.05  # what errs alike every night stays
    assert not np.isfinite(pooled.depth[~pooled.sure]).any()


def test_a_night_with_a_vehicle_before_the_wall_has_no_say_there() -> None:
    nights = {str(k): night(k) for k in range(5)}
    nights["3"].depth[10:20, 10:30] = 12.0
    pooled = pool_depths(nights)
    off = np.abs(pooled.depth - TRUE)[10:20, 10:30]
    assert np.nanpercentile(off, 98) < 0.2
    assert np.isfinite(off).mean() > 0.9


def test_where_nights_disagree_nothing_is_known() -> None:
    nights = {str(k): night(k) for k in range(4)}
    for k in range(4):
        nights[str(k)].depth[:10] = 8.0 + 3.0 * k
    nights = {k: DepthMap(d.depth, d.sigma, d.slope_x, d.slope_y, d.support, d.partners, d.sure) for k, d in nights.items()}
    assert not np.isfinite(pool_depths(nights, agree=0.1).depth[:10]).any()


def test_better_nights_count_for_more_and_all_partners_are_told() -> None:
    nights = {"sharp": night(0, 0.02, ("roof", "mast")), "hazy": night(1, 0.4, ("mast",)), "haze": night(2, 0.4, ("crane",))}
    pooled = pool_depths(nights)
    assert set(pooled.partners) == {"roof", "mast", "crane"}
    roof, crane = pooled.partners.index("roof"), pooled.partners.index("crane")
    inside = np.isfinite(nights["sharp"].depth) & np.isfinite(pooled.depth)
    off = np.abs(pooled.depth - TRUE)[inside]
    assert float(np.median(off)) < 1.1 * error(nights["sharp"])
    assert ((pooled.support[inside] >> roof) & 1).mean() > 0.9
    assert ((pooled.support >> crane) & 1).any()

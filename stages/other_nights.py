"""Many nights of fixed cameras pooled into one surface and one geometry, which are better than those of any single night.

Pooling the epochs of fixed time-lapse cameras halves the error at best (Blanch et al. 2021): errors that repeat every night
remain.  Coverage grows: 0.89 of a picture is known after seven nights, 0.75 after one.  The same holds for matches: F of a
wide pair is wrong by up to 7 pixels on single nights, and by 0.3 at most on the pooled matches of two to four.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .core.ordering import rank_within
from .sfm.tracks import joined_places
from .types import MOST_PARTNERS, Bools, DepthMap, Float32s, Float64s, Int64s, Matches, View

_LEAST_SIGMA_SHARE = 0.75
"""Least pooled standard deviation, as a share of the best single night's, no unit.  Errors of the nights at a pixel with the
same partners correlate, so more nights do not reduce them as independent ones would (measured: to 0.76 after seven nights)."""
_CELL_COLUMNS = 12
"""Columns of cells into which a view is divided to spread the points."""
_CELL_ROWS = 8
"""Rows of these cells."""


def pool_matches(nights: Mapping[str, Matches], *, same_px: float = 1.5, most_per_row: float = 0.6) -> Matches:
    """Pool the matches that a pair of cameras gave in several nights, each from the same two places.

    A match found in several nights counts once, at the mean of its positions: a wrong match that recurs every night must not
    gain weight.  Nights have only image positions in common, so the result has no keypoints.

    Parameters
    ----------
    nights : matches of one pair, by night.
    same_px : two matches are the same if their four coordinates differ by less (root of the sum of squares), pixels.
    most_per_row : most matches kept for each pixel row of the left view, the most probable of each cell of it.  Among many
        wrong matches a geometry finds inliers by chance: 13 to 19 with 0.6 per row, up to 21 with 1.7, and 20 make a pair.
    """
    newest = list(nights.values())[-1]
    # (n, 4): x, y in the left view, x, y in the right view
    positions = np.concatenate([np.hstack([night.x1, night.x2]) for night in nights.values()])
    probability = np.concatenate([night.probability for night in nights.values()])
    # The most probable match comes first, and is the one that others join.
    order = np.argsort(-probability, kind="stable")
    positions = positions[order]
    probability = probability[order]
    # Each place becomes one match, at the mean of what joined it.
    _, place_index = joined_places(positions, same_px)
    count = np.bincount(place_index)
    mean_columns = [np.bincount(place_index, column) / count for column in positions.T]
    places = np.column_stack(mean_columns).reshape(-1, 4)
    mean_probability = np.bincount(place_index, probability) / count
    most = int(most_per_row * newest.view1.height)
    rows = _spread_rows(places[:, :2], mean_probability, newest.view1, most)
    return Matches(
        x1=places[rows, :2],
        x2=places[rows, 2:],
        i1=None,
        i2=None,
        probability=mean_probability[rows].astype(np.float32),
        affine=None,
        view1=newest.view1,
        view2=newest.view2,
        matcher=newest.matcher,
        tilted=any(night.tilted for night in nights.values()),
        nights=len(nights),
    )


def _spread_rows(x: Float64s, probability: Float64s, view: View, max_count: int) -> Int64s:
    """Rows of the points (n, 2) to keep: the most probable of each cell of the view, then the second of each, and so on."""
    size = np.array([view.width, view.height])
    cells = np.array([_CELL_COLUMNS, _CELL_ROWS])
    column, row = np.clip(x * cells / size, 0, cells - 1).astype(np.int64).T
    cell = row * _CELL_COLUMNS + column
    rank = rank_within(cell, -probability)
    by_rank = np.lexsort((-probability, rank))  # the last key counts first
    return np.sort(by_rank[:max_count])


def pool_depths(nights: Mapping[str, DepthMap], *, agree: float = 3.0, least_share: float = 0.5) -> DepthMap:
    """Pool depth maps that one camera gave in several nights, from one place.

    Each pixel's inverse depth is the mean, weighted by variances, of the nights that agree with their median.

    Parameters
    ----------
    nights : depth maps of one size, by night.
    agree : a night agrees within this many standard deviations, its own or those of the nights' scatter if larger, no unit.
    least_share : more than this share of the nights that know a pixel must agree, otherwise the pixel is left unknown: things
        come and go there.
    """
    maps = list(nights.values())
    # Arrays of the nights are (nights, h, w).  Errors of matches are normal in inverse depth, not in depth.
    inverse = np.stack([1.0 / depth.depth.astype(np.float64) for depth in maps])
    sigma = np.stack([depth.sigma / depth.depth.astype(np.float64) ** 2 for depth in maps])
    known = np.isfinite(inverse) & np.isfinite(sigma) & (sigma > 0)

    # 1. Which nights agree with the median of all?  1.4826 turns the median deviation into a standard deviation.
    median = _median(inverse, known)
    scatter = 1.4826 * _median(np.abs(inverse - median), known)
    agreeing = known & (np.abs(inverse - median) <= agree * np.maximum(sigma, scatter))

    # 2. The weighted mean of these, where they are enough.
    weights = np.where(agreeing, 1.0 / np.where(agreeing, sigma, 1.0) ** 2, 0.0)
    total = weights.sum(axis=0)
    count = known.sum(axis=0)
    usable = (agreeing.sum(axis=0) > least_share * count) & (total > 0)
    pooled = _mean(inverse, weights, total, usable)
    slope_x = _mean(_filled([depth.slope_x for depth in maps]), weights, total, usable)
    slope_y = _mean(_filled([depth.slope_y for depth in maps]), weights, total, usable)

    # 3. Its error, which does not fall without limit: see `_LEAST_SIGMA_SHARE`.
    best_sigma = np.where(agreeing, sigma, np.inf).min(axis=0)
    independent_sigma = 1.0 / np.sqrt(np.where(usable, total, np.nan))
    pooled_sigma = np.maximum(independent_sigma, _LEAST_SIGMA_SHARE * best_sigma)

    # 4. A partner supports a pixel, and a pixel is sure, if that holds in any of the nights that agree.
    all_partners = dict.fromkeys(partner for depth in maps for partner in depth.partners)
    partners = tuple(all_partners)[:MOST_PARTNERS]
    supports = []
    sure_maps = []
    for depth, agrees in zip(maps, agreeing, strict=True):
        supports.append(np.where(agrees, depth.support_of(partners), 0))
        sure_maps.append(depth.sure & agrees)
    support = np.bitwise_or.reduce(supports)
    sure = np.any(sure_maps, axis=0)
    return DepthMap(
        depth=(1.0 / pooled).astype(np.float32),
        sigma=(pooled_sigma / pooled**2).astype(np.float32),
        slope_x=slope_x.astype(np.float32),
        slope_y=slope_y.astype(np.float32),
        support=np.where(usable, support, 0).astype(np.uint32),
        partners=partners,
        sure=sure & usable,
    )


def _filled(slopes: list[Float32s]) -> Float64s:
    """Slopes (nights, h, w), 0 where unknown: these have no weight, but nan times 0 is nan."""
    return np.nan_to_num(np.stack(slopes)).astype(np.float64)


def _median(values: Float64s, known: Bools) -> Float64s:
    """Median over the nights that know a pixel, nan where none does; the lower of two in the middle."""
    ordered = np.sort(np.where(known, values, np.inf), axis=0)
    # Unknown values are inf and sort last, so the middle of the known ones depends on their number at each pixel.
    index = np.maximum(known.sum(axis=0) - 1, 0) // 2
    medians = np.take_along_axis(ordered, index[None], axis=0)[0]
    return np.where(np.isfinite(medians), medians, np.nan)


def _mean(values: Float64s, weights: Float64s, total: Float64s, usable: Bools) -> Float64s:
    """Weighted mean over the nights (first axis), nan where it is not usable; total: sum of the weights."""
    weighted = np.where(weights > 0, values, 0.0) * weights
    mean = weighted.sum(axis=0) / np.where(usable, total, 1.0)
    return np.where(usable, mean, np.nan)

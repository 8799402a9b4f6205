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
from .types import MOST_PARTNERS, Bools, DepthMap, Float64s, Int64s, Matches, View

_LEAST_SIGMA_SHARE = 0.75
"""Least pooled standard deviation, as a share of the best night's: the nights' errors at a pixel with the same partners
correlate.  Seven nights of the demo yard, in different light: median error 0.76 of one night's where all know the pixel."""
_CELLS = (12, 8)
"""Columns and rows of cells into which a view is divided to spread the points."""


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
    positions = np.concatenate([np.hstack([night.x1, night.x2]) for night in nights.values()])
    probability = np.concatenate([night.probability for night in nights.values()])
    order = np.argsort(-probability, kind="stable")
    positions, probability = positions[order], probability[order]
    _, place_index = joined_places(positions, same_px)
    count = np.bincount(place_index)
    places = np.column_stack([np.bincount(place_index, column) / count for column in positions.T]).reshape(-1, 4)
    mean_probability = np.bincount(place_index, probability) / count
    rows = _spread_rows(places[:, :2], mean_probability, newest.view1, int(most_per_row * newest.view1.height))
    return Matches(
        places[rows, :2],
        places[rows, 2:],
        None,
        None,
        mean_probability[rows].astype(np.float32),
        None,
        newest.view1,
        newest.view2,
        newest.matcher,
        any(night.tilted for night in nights.values()),
        len(nights),
    )


def _spread_rows(x: Float64s, probability: Float64s, view: View, max_count: int) -> Int64s:
    """Rows of the points (n, 2) to keep: the most probable of each cell of the view, then the second of each, and so on."""
    size, cells = np.array([view.width, view.height]), np.array(_CELLS)
    column, row = np.clip(x * cells / size, 0, cells - 1).astype(np.int64).T
    cell = row * _CELLS[0] + column
    return np.sort(np.lexsort((-probability, rank_within(cell, -probability)))[:max_count])


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
    inverse = np.stack([1.0 / depth.depth.astype(np.float64) for depth in maps])
    sigma = np.stack([depth.sigma / depth.depth.astype(np.float64) ** 2 for depth in maps])
    known = np.isfinite(inverse) & np.isfinite(sigma) & (sigma > 0)
    median = _median(inverse, known)
    scatter = 1.4826 * _median(np.abs(inverse - median), known)
    agreeing = known & (np.abs(inverse - median) <= agree * np.maximum(sigma, scatter))
    weights = np.where(agreeing, 1.0 / np.where(agreeing, sigma, 1.0) ** 2, 0.0)
    total = weights.sum(axis=0)
    count = known.sum(axis=0)
    usable = (agreeing.sum(axis=0) > least_share * count) & (total > 0)
    pooled = _mean(inverse, weights, total, usable)
    best_sigma = np.where(agreeing, sigma, np.inf).min(axis=0)
    error = np.maximum(1.0 / np.sqrt(np.where(usable, total, np.nan)), _LEAST_SIGMA_SHARE * best_sigma)
    slope_x, slope_y = (
        _mean(np.nan_to_num(np.stack(slopes)).astype(np.float64), weights, total, usable)
        for slopes in ([depth.slope_x for depth in maps], [depth.slope_y for depth in maps])
    )
    partners = tuple(dict.fromkeys(partner for depth in maps for partner in depth.partners))[:MOST_PARTNERS]
    supports = [np.where(agrees, depth.support_of(partners), 0) for depth, agrees in zip(maps, agreeing, strict=True)]
    support = np.bitwise_or.reduce(supports)
    sure = np.any([depth.sure & agrees for depth, agrees in zip(maps, agreeing, strict=True)], axis=0)
    return DepthMap(
        (1.0 / pooled).astype(np.float32),
        (error / pooled**2).astype(np.float32),
        slope_x.astype(np.float32),
        slope_y.astype(np.float32),
        np.where(usable, support, 0).astype(np.uint32),
        partners,
        sure & usable,
    )


def _median(values: Float64s, known: Bools) -> Float64s:
    """Median over the nights that know a pixel, nan where none does; the lower of two in the middle."""
    ordered = np.sort(np.where(known, values, np.inf), axis=0)
    index = np.maximum(known.sum(axis=0) - 1, 0) // 2
    medians = np.take_along_axis(ordered, index[None], axis=0)[0]
    return np.where(np.isfinite(medians), medians, np.nan)


def _mean(values: Float64s, weights: Float64s, total: Float64s, usable: Bools) -> Float64s:
    mean = (np.where(weights > 0, values, 0.0) * weights).sum(axis=0) / np.where(usable, total, 1.0)
    return np.where(usable, mean, np.nan)

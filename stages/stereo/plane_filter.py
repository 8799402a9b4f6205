"""Filters that use the planes around a pixel: a correction of its disparity, a weighted median, and a deviation.

Up to `_BLOCK` pixels of a row are processed at once, so that the compiler can use SIMD instructions; scratch is one flat array
in rows of _BLOCK, so that it can prove that the rows do not overlap.  Conditions in the innermost loops choose between two values
and never skip a store, because a skipped store prevents SIMD instructions.
"""

from __future__ import annotations

import numpy as np

from ..core.jit import helper, kernel
from ..core.ordering import sorting_network
from ..types import Float32s, Float64s

_SIMILARITY_SCALE = 8.0
"""Grey-level difference at which a neighbour gets half the weight; larger values blur across edges."""
_NEAR_RADIUS = 2
"""Radius, in pixels, of the neighbours that correct a plane and that enter its deviation."""
_AGREEMENT_PX = 1.5
"""A neighbour corrects a plane if its disparity lies within this many pixels of the plane, where the plane is level."""
_AGREEMENT_PER_SLOPE = 0.7
"""By how much `_AGREEMENT_PX` grows, in pixels per unit of slope: a row offset between the images shifts a steep plane more."""
_DAMPING = 2.0
"""Weight of the plane's own slopes against those of its neighbours; larger values keep more of the plane's own."""
_MEDIAN_RADIUS = 6
"""Radius, in pixels, of the neighbours whose planes enter the median of a pixel's disparity."""
_MEDIAN_STRIDE = 3
"""Distance, in pixels, between these neighbours."""
_CONFIRMED_PX = 2.0
"""A pixel is confirmed if the disparities of both views differ by at most this many pixels."""
_UNCONFIRMED_PX = 3.0
"""Contribution to the deviation of a neighbour that is not confirmed, pixels; also the most that any neighbour contributes."""
_TORN_WEIGHT = 0.15
"""The deviation grows by this share for each pixel of disparity between the lowest and the highest neighbour."""
_BORDER = _MEDIAN_RADIUS
"""Width of the border around layers, pixels: the largest reach of a filter."""
_BLOCK = 128
"""Pixels of a row that are processed at once."""

# Rows of the scratch array of `_correct`: sums over the neighbours at (x, y) from the pixel, with weight w and residual r.
_W = 0 * _BLOCK  # of w
_WX = 1 * _BLOCK  # of w x
_WY = 2 * _BLOCK  # of w y
_WXX = 3 * _BLOCK  # of w x^2
_WYY = 4 * _BLOCK  # of w y^2
_WXY = 5 * _BLOCK  # of w x y
_WR = 6 * _BLOCK  # of w r
_WRX = 7 * _BLOCK  # of w r x
_WRY = 8 * _BLOCK  # of w r y
_SUMS = 9 * _BLOCK

# Rows of the scratch array of `_plane_deviation`.
_DISTANCES = 0 * _BLOCK  # sum of the neighbours' distances from the plane
_LOWEST = 1 * _BLOCK  # lowest disparity
_HIGHEST = 2 * _BLOCK  # highest disparity
_STATISTICS = 3 * _BLOCK


def smoothed(image: Float32s, planes: Float32s, cost: Float32s, most_cost: float, spacing: int = 1, rounds: int = 1) -> Float32s:
    """Planes (3, h, w) from planes whose `cost` is below `most_cost`, nan elsewhere: disparities are first corrected by their
    neighbours, then replaced by the median of the planes of neighbours farther away.

    Parameters
    ----------
    image : (h, w) grey levels of the view.
    planes, cost : (3, h, w) disparity and its slopes along x and y, and (h, w) their costs.
    most_cost : planes that cost this much or more are ignored.
    spacing : distance between the pixels that were matched; neighbours for the median are farther apart by this factor.
    rounds : each further round starts from the medians of the one before, with slopes fitted to them.
    """
    border = _BORDER * spacing
    inner = slice(border, -border)
    known = np.where(cost < np.float32(most_cost), planes[0], np.float32(np.nan))
    bordered = _bordered(border, known, planes[1], planes[2], image)
    corrected = np.empty((3, *known.shape), dtype=np.float32)

    # The first correction replaces disparities only: slopes stay those that the matcher found.
    _correct(bordered, border, 1, corrected)
    bordered[0, inner, inner] = corrected[0]
    # Further rounds replace disparities by medians, and slopes by those of planes through these medians.
    for _ in range(rounds - 1):
        bordered[0, inner, inner] = _median_filtered(bordered, spacing)
        _correct(bordered, border, _MEDIAN_STRIDE * spacing, corrected)
        bordered[1:3, inner, inner] = corrected[1:]

    corrected[0] = _median_filtered(bordered, spacing)
    corrected[1:] = bordered[1:3, inner, inner]
    return corrected


def plane_deviation(planes: Float32s, difference: Float32s) -> Float32s:
    """(h, w) deviation of the neighbours from each pixel's plane: mean distance of 5x5 pixels, larger where disparity is torn.

    Neighbours that the other view does not confirm (`difference` in pixels) count as far away: where one is wrong, those around
    it are suspect.  Infinite where the pixel itself is not confirmed."""
    confirmed = np.where(difference <= np.float32(_CONFIRMED_PX), planes[0], np.float32(np.nan))
    height, width = difference.shape
    rows = _pixels_inside(height)
    columns = _pixels_inside(width)
    inside = (rows[:, None] * columns).astype(np.float32)
    return _plane_deviation(_bordered(_BORDER, confirmed)[0], planes, inside)


def _pixels_inside(count: int) -> Float64s:
    """(count,) number of pixels of each pixel's window that lie within a line of `count` pixels."""
    window = np.ones(2 * _NEAR_RADIUS + 1)
    return np.convolve(np.ones(count), window, mode="same")[:count]


def _bordered(border: int, *layers: Float32s) -> Float32s:
    """Layers (h, w) stacked, with a border of nan."""
    height, width = layers[0].shape
    stacked = np.full((len(layers), height + 2 * border, width + 2 * border), np.nan, dtype=np.float32)
    for layer, values in zip(stacked, layers, strict=True):
        layer[border:-border, border:-border] = values
    return stacked


@helper
def _all_nan(row: Float32s, n: int) -> bool:
    """Are the first n values all nan?  A loop: numpy's functions for this take longer to compile than the rest of a kernel."""
    for x in range(n):
        if not np.isnan(row[x]):
            return False
    return True


@helper
def _fill(row: Float32s, first: int, last: int, value: np.float32) -> None:
    for x in range(first, last):
        row[x] = value


@kernel
def _correct(bordered: Float32s, border: int, stride: int, out: Float32s) -> None:
    """Write planes (3, h, w) to `out`: each pixel's own, corrected by a least-squares plane through 5x5 neighbours, `stride`
    apart.

    Neighbours must nearly agree with the plane, and are weighted by similarity of grey level.  `bordered` holds disparity, its
    slopes and grey (4, h, w) with a border."""
    height = bordered.shape[1] - 2 * border
    width = bordered.shape[2] - 2 * border
    sums = np.empty(_SUMS, dtype=np.float32)
    for y in range(height):
        row = y + border
        for x0 in range(0, width, _BLOCK):
            n = min(_BLOCK, width - x0)
            column = x0 + border
            if _all_nan(bordered[0, row, column:], n):
                for k in range(3):
                    _fill(out[k, y], x0, x0 + n, np.float32(np.nan))
                continue
            _fill(sums, 0, _SUMS, np.float32(0.0))
            # with few neighbours, slopes stay the plane's own
            _fill(sums, _WXX, _WYY + _BLOCK, np.float32(_DAMPING))
            for j in range(-_NEAR_RADIUS, _NEAR_RADIUS + 1):
                for i in range(-_NEAR_RADIUS, _NEAR_RADIUS + 1):
                    _add_neighbours(bordered, row, column, n, i * stride, j * stride, sums)
            _solve(bordered, row, column, n, sums, out[:, y, x0:])


@helper
def _add_neighbours(bordered: Float32s, row: int, column: int, n: int, dx: int, dy: int, sums: Float32s) -> None:
    """Add the neighbours (dx, dy) of `n` pixels from (column, row) on to the sums of the normal equations."""
    d = bordered[0, row, column:]
    a = bordered[1, row, column:]
    b = bordered[2, row, column:]
    grey = bordered[3, row, column:]
    neighbour_d = bordered[0, row + dy, column + dx :]
    neighbour_grey = bordered[3, row + dy, column + dx :]
    fx = np.float32(dx)
    fy = np.float32(dy)
    inverse_scale = np.float32(1.0 / _SIMILARITY_SCALE)
    for x in range(n):
        residual = neighbour_d[x] - (d[x] + a[x] * fx + b[x] * fy)
        tolerance = np.float32(_AGREEMENT_PX) + np.float32(_AGREEMENT_PER_SLOPE) * (abs(a[x]) + abs(b[x]))
        dissimilarity = (neighbour_grey[x] - grey[x]) * inverse_scale
        w = np.float32(1.0) / (np.float32(1.0) + dissimilarity * dissimilarity)
        agrees = abs(residual) <= tolerance  # False where the neighbour is nan
        w = w if agrees else np.float32(0.0)
        wr = w * (residual if agrees else np.float32(0.0))
        sums[_W + x] += w
        sums[_WX + x] += w * fx
        sums[_WY + x] += w * fy
        sums[_WXX + x] += w * fx * fx
        sums[_WYY + x] += w * fy * fy
        sums[_WXY + x] += w * fx * fy
        sums[_WR + x] += wr
        sums[_WRX + x] += wr * fx
        sums[_WRY + x] += wr * fy


@helper
def _solve(bordered: Float32s, row: int, column: int, n: int, sums: Float32s, out: Float32s) -> None:
    """Write the corrected planes of `n` pixels from (column, row) on to `out` (3, n or more).

    The changes of the disparity and of both slopes solve the normal equations

        | w   wx   wy  |                         | wr  |
        | wx  wxx  wxy |  (change of d, a, b)  = | wrx |
        | wy  wxy  wyy |                         | wry |

    by Cramer's rule; `minor_...` are the 2x2 determinants that the expansions share.
    """
    d = bordered[0, row, column:]
    a = bordered[1, row, column:]
    b = bordered[2, row, column:]
    for x in range(n):
        w = sums[_W + x]
        wx = sums[_WX + x]
        wy = sums[_WY + x]
        xx = sums[_WXX + x]
        yy = sums[_WYY + x]
        xy = sums[_WXY + x]
        r = sums[_WR + x]
        rx = sums[_WRX + x]
        ry = sums[_WRY + x]
        minor = xx * yy - xy * xy
        minor_rx_y = rx * yy - ry * xy
        minor_rx_x = rx * xy - xx * ry
        minor_wx_y = wx * yy - xy * wy
        minor_w_r = wx * ry - rx * wy
        det = w * minor - wx * minor_wx_y + wy * (wx * xy - xx * wy)
        out[0, x] = d[x] + (r * minor - wx * minor_rx_y + wy * minor_rx_x) / det
        out[1, x] = a[x] + (w * minor_rx_y - r * minor_wx_y + wy * minor_w_r) / det
        out[2, x] = b[x] + (w * (xx * ry - rx * xy) - wx * minor_w_r + r * (wx * xy - xx * wy)) / det


_TAPS = ((2 * _MEDIAN_RADIUS) // _MEDIAN_STRIDE + 1) ** 2
"""Number of neighbours that enter a median."""
_NETWORK = sorting_network(_TAPS)
"""(m, 2) pairs to compare.  They do not depend on the values, so that whole rows of pixels are sorted at once."""


@kernel
def _median_filtered(bordered: Float32s, spacing: int) -> Float32s:
    """(h, w) disparity: the median of the neighbours' planes, continued to each pixel and weighted by similarity of grey level.

    This rejects wrong planes and those from beyond an edge; slanted surfaces keep their slant.  `bordered` as in `_correct`."""
    border = _BORDER * spacing
    height = bordered.shape[1] - 2 * border
    width = bordered.shape[2] - 2 * border
    out = np.empty((height, width), dtype=np.float32)
    values = np.zeros((_TAPS, _BLOCK), dtype=np.float32)
    weights = np.zeros((_TAPS, _BLOCK), dtype=np.float32)
    total = np.empty(_BLOCK, dtype=np.float32)
    for y in range(height):
        row = y + border
        for x0 in range(0, width, _BLOCK):
            n = min(_BLOCK, width - x0)
            column = x0 + border
            centre = bordered[0, row, column:]
            if _all_nan(centre, n):
                _fill(out[y], x0, x0 + n, np.float32(np.nan))
                continue
            # 1. each neighbour's value here, and half its weight
            _fill(total, 0, _BLOCK, np.float32(0.0))
            k = 0
            for j in range(-_MEDIAN_RADIUS, _MEDIAN_RADIUS + 1, _MEDIAN_STRIDE):
                for i in range(-_MEDIAN_RADIUS, _MEDIAN_RADIUS + 1, _MEDIAN_STRIDE):
                    _continue_planes(bordered, row, column, n, i * spacing, j * spacing, values[k], weights[k])
                    for x in range(n):
                        total[x] += weights[k, x]
                    k += 1
            # 2. sort the values, with their weights
            for step in range(_NETWORK.shape[0]):
                low, high = _NETWORK[step]
                value1 = values[low]
                value2 = values[high]
                weight1 = weights[low]
                weight2 = weights[high]
                for x in range(_BLOCK):
                    v1 = value1[x]
                    v2 = value2[x]
                    w1 = weight1[x]
                    w2 = weight2[x]
                    swap = v1 > v2
                    value1[x] = v2 if swap else v1
                    value2[x] = v1 if swap else v2
                    weight1[x] = w2 if swap else w1
                    weight2[x] = w1 if swap else w2
            # 3. the value at which half of the total weight is reached
            _pick_medians(values, weights, centre, n, total, out[y, x0:])
    return out


@helper
def _continue_planes(
    bordered: Float32s, row: int, column: int, n: int, dx: int, dy: int, value: Float32s, weight: Float32s
) -> None:
    """The planes of the neighbours (dx, dy) of `n` pixels from (column, row) on, continued to these pixels, and half their
    weights;
    both 0 where the neighbour is unknown."""
    grey = bordered[3, row, column:]
    d = bordered[0, row + dy, column + dx :]
    a = bordered[1, row + dy, column + dx :]
    b = bordered[2, row + dy, column + dx :]
    neighbour_grey = bordered[3, row + dy, column + dx :]
    fx = np.float32(dx)
    fy = np.float32(dy)
    inverse_scale = np.float32(1.0 / _SIMILARITY_SCALE)
    for x in range(n):
        v = d[x] - a[x] * fx - b[x] * fy
        dissimilarity = (neighbour_grey[x] - grey[x]) * inverse_scale
        half_weight = np.float32(0.5) / (np.float32(1.0) + dissimilarity * dissimilarity)
        value[x] = np.float32(0.0) if np.isnan(v) else v
        weight[x] = np.float32(0.0) if np.isnan(v) else half_weight


@helper
def _pick_medians(values: Float32s, weights: Float32s, centre: Float32s, n: int, missing: Float32s, out: Float32s) -> None:
    """Write the weighted medians of sorted `values` (taps, _BLOCK) to the first `n` of `out`; nan where `centre` is unknown.

    missing: the sum of the `weights`, which are half weights; it is used up."""
    for x in range(n):
        out[x] = np.float32(np.nan)
    for k in range(_TAPS):
        value = values[k]
        weight = weights[k]
        # `missing` is the weight still missing to half of the total; it falls to 0 or below once
        for x in range(n):
            previous = missing[x]
            missing[x] = previous - np.float32(2.0) * weight[x]
            if previous > np.float32(0.0) and missing[x] <= np.float32(0.0) and not np.isnan(centre[x]):
                out[x] = value[x]


@kernel
def _plane_deviation(confirmed: Float32s, planes: Float32s, inside: Float32s) -> Float32s:
    """(h, w) as `plane_deviation`, from `confirmed` disparity with a border of `_BORDER`, nan where it is not confirmed.

    inside: (h, w) number of pixels of each window that lie in the image."""
    height, width = inside.shape
    deviation = np.empty((height, width), dtype=np.float32)
    statistics = np.empty(_STATISTICS, dtype=np.float32)
    cap = np.float32(_UNCONFIRMED_PX)
    window_px = np.float32((2 * _NEAR_RADIUS + 1) ** 2)
    for y in range(height):
        row = y + _BORDER
        for x0 in range(0, width, _BLOCK):
            n = min(_BLOCK, width - x0)
            column = x0 + _BORDER
            d = confirmed[row, column:]
            a = planes[1, y, x0:]
            b = planes[2, y, x0:]
            if _all_nan(d, n):
                _fill(deviation[y], x0, x0 + n, np.float32(np.inf))
                continue
            _fill(statistics, _DISTANCES, _DISTANCES + _BLOCK, np.float32(0.0))
            _fill(statistics, _LOWEST, _LOWEST + _BLOCK, np.float32(np.inf))
            _fill(statistics, _HIGHEST, _HIGHEST + _BLOCK, np.float32(-np.inf))
            for dy in range(-_NEAR_RADIUS, _NEAR_RADIUS + 1):
                for dx in range(-_NEAR_RADIUS, _NEAR_RADIUS + 1):
                    neighbours = confirmed[row + dy, column + dx :]
                    fx = np.float32(dx)
                    fy = np.float32(dy)
                    for x in range(n):
                        v = neighbours[x]
                        distance = abs(v - d[x] - a[x] * fx - b[x] * fy)
                        lowest = statistics[_LOWEST + x]
                        highest = statistics[_HIGHEST + x]
                        statistics[_DISTANCES + x] += distance if distance < cap else cap  # `cap` for nan, too
                        statistics[_LOWEST + x] = v if v < lowest else lowest
                        statistics[_HIGHEST + x] = v if v > highest else highest
            for x in range(n):
                # pixels beyond the image's edge were counted as unconfirmed: they are taken out again
                count = inside[y, x0 + x]
                mean_distance = (statistics[_DISTANCES + x] - (window_px - count) * cap) / count
                disparities = statistics[_HIGHEST + x] - statistics[_LOWEST + x]
                torn_factor = np.float32(1.0) + np.float32(_TORN_WEIGHT) * disparities
                deviation[y, x0 + x] = np.float32(np.inf) if np.isnan(d[x]) else mean_distance * torn_factor
    return deviation

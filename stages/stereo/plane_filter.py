"""Filters that use the planes around a pixel: a correction of its disparity, a weighted median, and a deviation.

Up to `_BLOCK` pixels of a row are processed at once, so that the compiler can use SIMD instructions; scratch is one flat array
in rows of _BLOCK, so that it can prove that the rows do not overlap.
"""

from __future__ import annotations

import numpy as np

from ..core.jit import helper, kernel
from ..core.ordering import sorting_network
from ..types import Float32s

_SIMILARITY_SCALE = 8.0
"""Grey-level difference at which a neighbour gets half the weight."""
_NEAR_RADIUS = 2
"""Radius of the neighbours that correct a plane and that enter its deviation, pixels."""
_MEDIAN_RADIUS, _MEDIAN_STRIDE = 6, 3
"""Radius and stride of the neighbours whose planes enter the median of a pixel's disparity, pixels."""
_CONFIRMED_PX = 2.0
"""A pixel is confirmed if the disparities of both views differ by at most this much."""
_UNCONFIRMED_PX = 3.0
"""Contribution to the deviation of a neighbour that is not confirmed; also the most that any neighbour contributes."""
_BORDER = _MEDIAN_RADIUS
_BLOCK = 128


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
    out = np.empty((3, *known.shape), dtype=np.float32)
    _correct(bordered, border, 1, out)
    bordered[0, inner, inner] = out[0]
    for _ in range(rounds - 1):
        bordered[0, inner, inner] = _median_filtered(bordered, spacing)
        _correct(bordered, border, _MEDIAN_STRIDE * spacing, out)
        bordered[1:3, inner, inner] = out[1:]
    out[0] = _median_filtered(bordered, spacing)
    out[1:] = bordered[1:3, inner, inner]
    return out


def plane_deviation(planes: Float32s, difference: Float32s) -> Float32s:
    """(h, w) deviation of the neighbours from each pixel's plane: mean distance of 5x5 pixels, larger where disparity is torn.

    Neighbours that the other view does not confirm (`difference` in pixels) count as far away: where one is wrong, those around
    it are suspect.  Infinite where the pixel itself is not confirmed."""
    confirmed = np.where(difference <= np.float32(_CONFIRMED_PX), planes[0], np.float32(np.nan))
    rows, columns = (np.convolve(np.ones(n), np.ones(2 * _NEAR_RADIUS + 1), mode="same")[:n] for n in difference.shape)
    inside = (rows[:, None] * columns).astype(np.float32)  # number of pixels of each window that lie in the image
    return _plane_deviation(_bordered(_BORDER, confirmed)[0], planes, inside)


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
    known = 0
    for x in range(n):
        known += 0 if np.isnan(row[x]) else 1
    return known == 0


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
    known, image = bordered[0], bordered[3]
    height, width = known.shape[0] - 2 * border, known.shape[1] - 2 * border
    inverse_scale = np.float32(1.0 / _SIMILARITY_SCALE)
    sums = np.empty(9 * _BLOCK, dtype=np.float32)
    zero = np.float32(0.0)
    for y in range(height):
        for x0 in range(0, width, _BLOCK):
            n = min(_BLOCK, width - x0)
            row, column = y + border, x0 + border
            d, a, b, grey = known[row, column:], bordered[1, row, column:], bordered[2, row, column:], image[row, column:]
            if _all_nan(d, n):
                for k in range(3):
                    _fill(out[k, y], x0, x0 + n, np.float32(np.nan))
                continue
            _fill(sums, 0, 9 * _BLOCK, zero)
            _fill(sums, 3 * _BLOCK, 5 * _BLOCK, np.float32(2.0))  # damping: with few neighbours, slopes stay the plane's own
            for j in range(-_NEAR_RADIUS, _NEAR_RADIUS + 1):
                for i in range(-_NEAR_RADIUS, _NEAR_RADIUS + 1):
                    dx, dy = i * stride, j * stride
                    disparity, neighbour_grey = known[row + dy, column + dx :], image[row + dy, column + dx :]
                    fx, fy = np.float32(dx), np.float32(dy)
                    for x in range(n):
                        residual = disparity[x] - (d[x] + a[x] * fx + b[x] * fy)
                        # a row offset between the images shifts a steep plane more
                        agrees = abs(residual) <= np.float32(1.5) + np.float32(0.7) * (abs(a[x]) + abs(b[x]))
                        dissimilarity = (neighbour_grey[x] - grey[x]) * inverse_scale
                        w = np.float32(1.0) / (np.float32(1.0) + dissimilarity * dissimilarity)
                        w = w if agrees else zero
                        v = w * (residual if agrees else zero)
                        sums[x] += w
                        sums[_BLOCK + x] += w * fx
                        sums[2 * _BLOCK + x] += w * fy
                        sums[3 * _BLOCK + x] += w * fx * fx
                        sums[4 * _BLOCK + x] += w * fy * fy
                        sums[5 * _BLOCK + x] += w * fx * fy
                        sums[6 * _BLOCK + x] += v
                        sums[7 * _BLOCK + x] += v * fx
                        sums[8 * _BLOCK + x] += v * fy
            for x in range(n):
                w, wx, wy = sums[x], sums[_BLOCK + x], sums[2 * _BLOCK + x]
                xx, yy, xy = sums[3 * _BLOCK + x], sums[4 * _BLOCK + x], sums[5 * _BLOCK + x]
                v, vx, vy = sums[6 * _BLOCK + x], sums[7 * _BLOCK + x], sums[8 * _BLOCK + x]
                minor = xx * yy - xy * xy
                det = w * minor - wx * (wx * yy - xy * wy) + wy * (wx * xy - xx * wy)
                out[0, y, x0 + x] = d[x] + (v * minor - wx * (vx * yy - xy * vy) + wy * (vx * xy - xx * vy)) / det
                out[1, y, x0 + x] = a[x] + (w * (vx * yy - xy * vy) - v * (wx * yy - xy * wy) + wy * (wx * vy - vx * wy)) / det
                out[2, y, x0 + x] = b[x] + (w * (xx * vy - vx * xy) - wx * (wx * vy - vx * wy) + v * (wx * xy - xx * wy)) / det


_TAPS = ((2 * _MEDIAN_RADIUS) // _MEDIAN_STRIDE + 1) ** 2
_NETWORK = sorting_network(_TAPS)
"""Its comparisons do not depend on the values, so that whole rows of pixels are sorted at once."""


@kernel
def _median_filtered(bordered: Float32s, spacing: int) -> Float32s:
    """(h, w) disparity: the median of the neighbours' planes, continued to each pixel and weighted by similarity of grey level.

    This rejects wrong planes and those from beyond an edge; slanted surfaces keep their slant.  `bordered` as in `_correct`."""
    border = _BORDER * spacing
    height, width = bordered.shape[1] - 2 * border, bordered.shape[2] - 2 * border
    out = np.empty((height, width), dtype=np.float32)
    values = np.zeros((_TAPS, _BLOCK), dtype=np.float32)
    weights = np.zeros((_TAPS, _BLOCK), dtype=np.float32)
    missing = np.empty(_BLOCK, dtype=np.float32)
    inverse_scale = np.float32(1.0 / _SIMILARITY_SCALE)
    for y in range(height):
        for x0 in range(0, width, _BLOCK):
            n = min(_BLOCK, width - x0)
            row, column = y + border, x0 + border
            centre, grey = bordered[0, row, column:], bordered[3, row, column:]
            if _all_nan(centre, n):
                _fill(out[y], x0, x0 + n, np.float32(np.nan))
                continue
            _fill(missing, 0, _BLOCK, np.float32(0.0))
            k = 0
            for j in range(-_MEDIAN_RADIUS, _MEDIAN_RADIUS + 1, _MEDIAN_STRIDE):
                for i in range(-_MEDIAN_RADIUS, _MEDIAN_RADIUS + 1, _MEDIAN_STRIDE):
                    dx, dy = i * spacing, j * spacing
                    fx, fy = np.float32(dx), np.float32(dy)
                    d, neighbour_grey = bordered[0, row + dy, column + dx :], bordered[3, row + dy, column + dx :]
                    a, b = bordered[1, row + dy, column + dx :], bordered[2, row + dy, column + dx :]
                    value, weight = values[k], weights[k]
                    for x in range(n):
                        v = d[x] - a[x] * fx - b[x] * fy
                        value[x] = np.float32(0.0) if np.isnan(v) else v
                        dissimilarity = (neighbour_grey[x] - grey[x]) * inverse_scale
                        w = np.float32(0.5) / (np.float32(1.0) + dissimilarity * dissimilarity)
                        weight[x] = np.float32(0.0) if np.isnan(v) else w
                    for x in range(n):
                        missing[x] += weight[x]
                    k += 1
            for step in range(_NETWORK.shape[0]):
                low, high = _NETWORK[step]
                value1, value2, weight1, weight2 = values[low], values[high], weights[low], weights[high]
                for x in range(_BLOCK):
                    v1, v2, w1, w2 = value1[x], value2[x], weight1[x], weight2[x]
                    swap = v1 > v2
                    value1[x], value2[x] = v2 if swap else v1, v1 if swap else v2
                    weight1[x], weight2[x] = w2 if swap else w1, w1 if swap else w2
            for x in range(n):
                out[y, x0 + x] = np.float32(np.nan)
            for k in range(_TAPS):
                value, weight = values[k], weights[k]
                # `missing` is the weight still missing to half of the total; it falls to 0 or below once
                for x in range(n):
                    previous = missing[x]
                    missing[x] = previous - np.float32(2.0) * weight[x]
                    if previous > np.float32(0.0) and missing[x] <= np.float32(0.0) and not np.isnan(centre[x]):
                        out[y, x0 + x] = value[x]
    return out


@kernel
def _plane_deviation(confirmed: Float32s, planes: Float32s, inside: Float32s) -> Float32s:
    height, width = inside.shape
    deviation = np.empty((height, width), dtype=np.float32)
    stats = np.empty(3 * _BLOCK, dtype=np.float32)
    cap = np.float32(_UNCONFIRMED_PX)
    for y in range(height):
        for x0 in range(0, width, _BLOCK):
            n = min(_BLOCK, width - x0)
            row, column = y + _BORDER, x0 + _BORDER
            d, a, b = confirmed[row, column:], planes[1, y, x0:], planes[2, y, x0:]
            if _all_nan(d, n):
                _fill(deviation[y], x0, x0 + n, np.float32(np.inf))
                continue
            _fill(stats, 0, _BLOCK, np.float32(0.0))  # sum of distances
            _fill(stats, _BLOCK, 2 * _BLOCK, np.float32(np.inf))  # the lowest disparity
            _fill(stats, 2 * _BLOCK, 3 * _BLOCK, np.float32(-np.inf))  # the highest
            for dy in range(-_NEAR_RADIUS, _NEAR_RADIUS + 1):
                for dx in range(-_NEAR_RADIUS, _NEAR_RADIUS + 1):
                    neighbours = confirmed[row + dy, column + dx :]
                    fx, fy = np.float32(dx), np.float32(dy)
                    for x in range(n):
                        v = neighbours[x]
                        distance = abs(v - d[x] - a[x] * fx - b[x] * fy)
                        stats[x] += distance if distance < cap else cap  # `cap` for nan, too
                        stats[_BLOCK + x] = v if v < stats[_BLOCK + x] else stats[_BLOCK + x]
                        stats[2 * _BLOCK + x] = v if v > stats[2 * _BLOCK + x] else stats[2 * _BLOCK + x]
            for x in range(n):
                count = inside[y, x0 + x]
                mean_distance = (stats[x] - (np.float32((2 * _NEAR_RADIUS + 1) ** 2) - count) * cap) / count
                torn_factor = np.float32(1.0) + np.float32(0.15) * (stats[2 * _BLOCK + x] - stats[_BLOCK + x])
                deviation[y, x0 + x] = np.float32(np.inf) if np.isnan(d[x]) else mean_distance * torn_factor
    return deviation

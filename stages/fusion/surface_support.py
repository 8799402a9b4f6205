"""Share of a depth's surroundings that lies on the same surface: isolated depths have little."""

from __future__ import annotations

import numpy as np

from ..core.jit import kernel
from ..types import Bools, DepthMap, Float32s

_REACH = 6
"""Reach of the neighbourhood, in pixels of an image 768 wide; scaled for larger ones."""

_STRIDE = 2
"""Distance between its samples, likewise: neighbouring pixels were matched on nearly the same patch."""


def surface_support(depth: DepthMap, usable: Bools, weight: Float32s | None = None) -> Float32s:
    """(h, w) share of each usable pixel's neighbours that are usable and lie on its plane; 0 elsewhere.

    A neighbour is on the plane if it differs by no more than three sigmas plus 0.2 % of the depth, at most 1.6 %, as when views
    are compared.  It counts by its weight (h, w), 0 to 1, if there are weights.
    """
    spacing = spacing_px(usable.shape)
    inverse = np.where(usable, 1.0 / depth.depth, np.float32(np.nan)).astype(np.float32)
    relative = (depth.sigma / depth.depth).astype(np.float32)
    share = np.zeros(usable.shape, np.float32)
    weights = weight
    if weights is None:
        weights = usable.astype(np.float32)
    _sum_support(inverse, weights, depth.slope_x, depth.slope_y, relative, spacing * _REACH, spacing * _STRIDE, share)
    return share


def surroundings_px(shape: tuple[int, ...]) -> int:
    """Number of pixels in the neighbourhood of one pixel, for an image of this shape."""
    return (2 * spacing_px(shape) * _REACH + 1) ** 2


def spacing_px(shape: tuple[int, ...]) -> int:
    """Pixels of an image of this shape for each pixel of an image 768 wide."""
    return max(1, round(max(shape) / 768))


@kernel
def _sum_support(
    inverse: Float32s, weight: Float32s, slope_x: Float32s, slope_y: Float32s, relative: Float32s, reach: int, stride: int,
    share: Float32s,
) -> None:  # fmt: skip
    """Write the share (h, w), initially 0; loops over a row's pixels are innermost, so that the compiler can vectorise them."""
    h, w = inverse.shape
    neighbours = np.float32((2 * (reach // stride) + 1) ** 2 - 1)
    for y in range(h):
        for dy in range(-reach, reach + 1, stride):
            if not 0 <= y + dy < h:
                continue
            for dx in range(-reach, reach + 1, stride):
                if dx == 0 and dy == 0:
                    continue
                # the pixels of the row whose neighbours are in the image
                first = max(0, -dx)
                last = min(w, w - dx)
                neighbour = inverse[y + dy, first + dx :]
                neighbour_weight = weight[y + dy, first + dx :]
                centre = inverse[y, first:]
                a = slope_x[y, first:]
                b = slope_y[y, first:]
                sigma = relative[y, first:]
                total = share[y, first:]
                fx = np.float32(dx)
                fy = np.float32(dy)
                for x in range(last - first):
                    tolerance = min(np.float32(3.0) * sigma[x] + np.float32(0.002), np.float32(0.016)) * centre[x]
                    on_plane = abs(neighbour[x] - centre[x] - a[x] * fx - b[x] * fy) <= tolerance  # False where either is nan
                    total[x] += neighbour_weight[x] if on_plane else np.float32(0.0)
        for x in range(w):
            share[y, x] /= neighbours

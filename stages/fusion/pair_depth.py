"""Depth of one view from the disparities of its pairs: triangulation, propagated uncertainty, agreement between pairs.

A pixel's sigma combines a match error of `noise_px` in the other image, propagated to depth, with a relative floor for errors
that do not come from pixel noise (calibration, low-frequency matching errors): sigma^2 = (noise_px dz/dpx)^2 + (floor z)^2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..core.cameras import transfer
from ..core.jit import helper, kernel
from ..rectification.placement import frame_grid
from ..rectification.warping import Side, disparity_px, from_rectified, resampling, to_rectified
from ..types import MOST_PARTNERS, Bools, Camera, DepthMap, Disparity, Float32s, Float64s, Rectification, Uint32s

_SMOOTH_PX = 2.5
"""Neighbouring pixels whose disparities differ by no more than this lie on one surface."""

_SCALE_RATIO = 2.0
"""`noise_px` is in rectified pixels if their side, in frame pixels, differs by more than this factor between the two frames."""

_SAME_STEP = 0.3
"""Two successive disparity steps from row to row belong to one slope if they differ by no more than this share."""

_TILES = 5
"""Columns, and rows, of tiles in which `offset_px` compares two pairs."""

_TILE_PIXELS = 40
"""Fewest pixels with both depths in a tile that counts."""

_LEAST_SHARE = 0.02
"""Smallest share of the view's pixels in such tiles: two pairs that share less are not compared."""

_QUARTILE_FACTOR = 3.0
"""The median difference counts up to this multiple of the lower quartile.  A wrong pose acts on nearly all tiles; a pattern that
one pair mistakes for another may decide in most (a warehouse's shelves: 7 px in four of seven tiles, 3 % of a view)."""

_COMPARED_PIXELS = 40_000
"""Approximate number of pixels at which two pairs are compared."""

_SCATTER_SHARE = 0.6
"""Share of the scatter within tiles that noise may leave in the tiles' medians, and that `offset_px` subtracts (measured: at most
0.65 in five rendered scenes with right cameras, counting differences over 0.1 px; 0.82 in a hall at night)."""

_LONG_SIDE = 768
"""Differences are scaled to frames of this long side, pixels: calibration errors are angles, and grow with the resolution."""

_AGREEING_SIGMAS = 3.0
"""Two pairs' depths agree if they differ by no more than this many combined sigmas, and than `_SAME_SURFACE`."""

_SAME_SURFACE = 0.016
"""Largest relative difference of depths on one surface, whatever their sigmas."""

_STEEPEST = 2.75
"""Tangent of 70 degrees: neighbours on a surface that is turned away further are taken for another surface's."""


@dataclass(frozen=True)
class NoiseModel:
    """Expected errors of depth."""

    noise_px: float = 0.35
    """Standard deviation of a match in pixels of the other image; in rectified pixels between unlike views (`_SCALE_RATIO`)."""
    floor: float = 0.0004
    """Relative error of depth that a higher resolution does not reduce."""
    limit: float = 0.006
    """Largest relative sigma at which a depth is still used."""

    def usable(self, depth: Float32s, gain: Float32s) -> Bools:
        """Which depths of a pair, any shape, are exact enough to be fused; False for nan.  gain: |dz/dpixel|."""
        with np.errstate(invalid="ignore"):
            return (self.noise_px * gain) ** 2 + (self.floor * depth) ** 2 <= (self.limit * depth) ** 2


def pair_depth(
    camera: Camera, other: Camera, rectification: Rectification, disparity: Disparity, side: Side
) -> tuple[Float32s, Float32s]:
    """Depth (h, w) float32 of each pixel of one view of a pair, nan where unknown, and |dz/dpixel| in the other image.

    Parameters
    ----------
    camera, other : the view whose depth is computed, and its partner.
    rectification, disparity : of the pair.
    side : 1 if `camera` is the pair's left view, 2 if it is its right one.
    """
    depth = np.full((camera.height, camera.width), np.nan, np.float32)
    gain = np.full_like(depth, np.nan)
    d = disparity_px(disparity, side)
    sign = -1.0 if side == 1 else 1.0
    M, b = transfer(camera, other)
    if side == 1:
        H, H_other = rectification.H1, rectification.H2
    else:
        H, H_other = rectification.H2, rectification.H1
    other_side: Side = 2 if side == 1 else 1
    if H is not None and H_other is not None:
        _by_homographies(d, sign, H, np.linalg.inv(H_other).astype(np.float64), M, b, depth, gain)
    else:
        # no homographies (polar rectification): positions are looked up for all pixels at once
        y, x = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1)
        pixels = np.column_stack([x, y]).astype(np.float64)
        position = to_rectified(rectification, side, pixels)
        position[:, 0] += sign * sample_disparity(d, position)
        partner_pixels = from_rectified(rectification, other_side, position)
        _triangulate(pixels, partner_pixels, M, b, depth.ravel(), gain.ravel())

    # A match error counts in pixels of the partner's frame, but in rectified pixels if these differ much between the two frames.
    other_px = _frame_px(rectification, other_side, other)
    own_px = _frame_px(rectification, side, camera)
    if max(own_px, other_px) > _SCALE_RATIO * min(own_px, other_px):
        gain = gain * np.float32(other_px)
    return depth, gain


def _frame_px(rectification: Rectification, side: Side, camera: Camera) -> float:
    """Side of a rectified pixel in pixels of the frame, median over the part of the frame that the rectified image shows."""
    grid = frame_grid((camera.width, camera.height))
    with np.errstate(divide="ignore", invalid="ignore"):
        position = to_rectified(rectification, side, grid)
        width, height = rectification.size1 if side == 1 else rectification.size2
        shown = ((position > -0.5) & (position < (width - 0.5, height - 0.5))).all(axis=1)
        area = np.abs(resampling(rectification, side, grid[shown])[0])
    if not shown.any():
        return 1.0
    return float(1 / np.sqrt(np.median(area)))


@kernel
def _by_homographies(
    disparity: Float32s, sign: float, H: Float64s, H_back: Float64s, M: Float64s, b: Float64s, depth: Float32s, gain: Float32s
) -> None:
    """Depth and |dz/dpixel| of every pixel; H: to the rectified image, H_back: from the other rectified image to its frame."""
    h, w = depth.shape
    for y in range(h):
        for x in range(w):
            # 1. To the rectified image.
            scale = H[2, 0] * x + H[2, 1] * y + H[2, 2]
            u = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / scale
            v = (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / scale
            # 2. Along the row to the match, and from there to the other frame.
            d = _disparity_at(disparity, u, v)
            if np.isnan(d):
                continue
            u += sign * d
            scale = H_back[2, 0] * u + H_back[2, 1] * v + H_back[2, 2]
            other_u = (H_back[0, 0] * u + H_back[0, 1] * v + H_back[0, 2]) / scale
            other_v = (H_back[1, 0] * u + H_back[1, 1] * v + H_back[1, 2]) / scale
            # 3. Triangulate.
            depth[y, x], gain[y, x] = _depth_at(x, y, other_u, other_v, M, b)


@kernel
def sample_disparity(disparity: Float32s, at: Float64s) -> Float64s:
    """Disparity (n,) at fractional positions (n, 2): linear between pixels of one surface, else the nearest pixel's, so that no
    edge is smeared; nan outside."""
    out = np.empty(len(at))
    for n in range(len(at)):
        out[n] = _disparity_at(disparity, at[n, 0], at[n, 1])
    return out


@helper
def _disparity_at(disparity: Float32s, x: float, y: float) -> float:
    """Disparity at one fractional position, as `sample_disparity` has it."""
    h, w = disparity.shape
    if not (x >= 0.0 and y >= 0.0 and x < w - 1 and y < h - 1):
        return np.nan
    x0 = int(x)
    y0 = int(y)
    fx = x - x0
    fy = y - y0
    nearest_x = x0 + int(fx >= 0.5)
    nearest_y = y0 + int(fy >= 0.5)
    a = disparity[y0, x0]
    b = disparity[y0, x0 + 1]
    c = disparity[y0 + 1, x0]
    d = disparity[y0 + 1, x0 + 1]
    # bilinear on one surface; comparisons with nan are False, so that a hole never takes part
    if abs(a - b) <= _SMOOTH_PX and abs(c - d) <= _SMOOTH_PX:
        above = a * (1 - fx) + b * fx
        below = c * (1 - fx) + d * fx
        if abs(above - below) <= _SMOOTH_PX or _is_on_slope(disparity, nearest_x, y0):
            return float(above * (1 - fy) + below * fy)
    return float(disparity[nearest_y, nearest_x])


@helper
def _is_on_slope(disparity: Float32s, x: int, y: int) -> bool:
    """Whether the step from row y to the next belongs to a slope: on ground seen at a low angle, steps of several pixels repeat
    from row to row; at an edge there is one."""
    step = disparity[y + 1, x] - disparity[y, x]
    if y > 0 and abs(disparity[y, x] - disparity[y - 1, x] - step) <= _SAME_STEP * abs(step):
        return True
    return bool(y + 2 < disparity.shape[0] and abs(disparity[y + 2, x] - disparity[y + 1, x] - step) <= _SAME_STEP * abs(step))


@kernel
def _triangulate(pixels: Float64s, partner: Float64s, M: Float64s, b: Float64s, depth: Float32s, gain: Float32s) -> None:
    """Depth and |dz/dpixel| (n,) of matches: pixels (n, 2) of the view, and of its partner."""
    for n in range(len(pixels)):
        depth[n], gain[n] = _depth_at(pixels[n, 0], pixels[n, 1], partner[n, 0], partner[n, 1], M, b)


@helper
def _depth_at(x: float, y: float, u: float, v: float, M: Float64s, b: Float64s) -> tuple[float, float]:
    """Closed-form least squares on the two linear equations of a match (u, v); depth and |dz/dpixel|, nan behind a camera.

    The pixel p at depth z is seen at z M p + b, so that z a + b' = 0 in both coordinates: z (m0 - u m2) + (b0 - u b2) = 0.
    """
    m0 = M[0, 0] * x + M[0, 1] * y + M[0, 2]
    m1 = M[1, 0] * x + M[1, 1] * y + M[1, 2]
    m2 = M[2, 0] * x + M[2, 1] * y + M[2, 2]
    a1 = m0 - u * m2
    b1 = b[0] - u * b[2]
    a2 = m1 - v * m2
    b2 = b[1] - v * b[2]
    z = -(a1 * b1 + a2 * b2) / (a1 * a1 + a2 * a2)
    w = z * m2 + b[2]
    if not (z > 0 and w > 0):  # also where the partner pixel is nan
        return np.nan, np.nan
    # the match's movement with z, by the quotient rule
    du = (m0 * b[2] - b[0] * m2) / (w * w)
    dv = (m1 * b[2] - b[1] * m2) / (w * w)
    return z, 1.0 / np.sqrt(du * du + dv * dv)


def fuse_pairs(
    camera: Camera, depths: Sequence[Float32s], gains: Sequence[Float32s], partners: Sequence[str], noise: NoiseModel
) -> DepthMap:
    """Fuse the depths of one view's pairs: per pixel the depth that most pairs support, averaged over these by 1 / sigma^2.

    Parameters
    ----------
    depths, gains : (h, w) float32 of each pair, as `pair_depth` returns them; at most `MOST_PARTNERS`.
    partners : the other camera of each pair, in the same order.
    """
    if len(depths) > MOST_PARTNERS:
        raise ValueError(f"{len(depths)} pairs of one view, at most {MOST_PARTNERS} can be fused")
    Z = np.stack(depths)  # (pairs, h, w)
    G = np.stack(gains)
    h, w = Z.shape[1:]
    depth = np.full((h, w), np.nan, np.float32)
    sigma = np.full((h, w), np.nan, np.float32)
    support = np.zeros((h, w), np.uint32)
    _fuse_agreeing(Z, G, noise.noise_px, noise.floor, noise.limit, depth, sigma, support)
    slope_x, slope_y = inverse_depth_slopes(depth, camera.K[0, 0])
    return DepthMap(depth, sigma, slope_x, slope_y, support, tuple(partners), np.isfinite(depth))


@kernel
def _fuse_agreeing(
    Z: Float32s, G: Float32s, noise: float, floor: float, limit: float, depth: Float32s, sigma: Float32s, support: Uint32s
) -> None:
    """Write depth, sigma and support (h, w) from the depths and gains Z, G (n, h, w) of n pairs, as `fuse_pairs` has it."""
    n, h, w = Z.shape
    sigmas = np.empty(n)
    for y in range(h):
        for x in range(w):
            # 1. Sigma of each pair's depth, nan where it is too inexact or unknown.
            for k in range(n):
                sigmas[k] = np.sqrt((noise * G[k, y, x]) ** 2 + (floor * Z[k, y, x]) ** 2)
                if not sigmas[k] <= limit * Z[k, y, x]:
                    sigmas[k] = np.nan
            # 2. Each pair's depth in turn is the hypothesis; the one that most pairs support wins.
            best_score = 0.0
            for k in range(n):
                if np.isnan(sigmas[k]):
                    continue
                z = Z[k, y, x]
                score = 0.0
                total = 0.0
                weights = 0.0
                supporters = np.uint32(0)
                for m in range(n):
                    combined_sigma = np.sqrt(sigmas[k] ** 2 + sigmas[m] ** 2)
                    tolerance = min(_AGREEING_SIGMAS * combined_sigma, _SAME_SURFACE * z)
                    if abs(Z[m, y, x] - z) <= tolerance:  # never true where sigmas[m] is nan
                        weight = 1.0 / sigmas[m] ** 2
                        total += weight * Z[m, y, x]
                        weights += weight
                        score += 1.0 + 0.1 * floor * z / sigmas[m]  # the more exact one wins a tie
                        supporters |= np.uint32(1) << np.uint32(m)
                if score > best_score:
                    best_score = score
                    depth[y, x] = total / weights
                    sigma[y, x] = max(1.0 / np.sqrt(weights), floor * z)
                    support[y, x] = supporters


def inverse_depth_slopes(depth: Float32s, focal: float, radius: int = 3) -> tuple[Float32s, Float32s]:
    """(h, w) float32 each: change of 1/z per pixel in x and in y, from a robust local plane; 0 where depth is unknown."""
    slope_x = np.zeros_like(depth)
    slope_y = np.zeros_like(depth)
    steepest = _STEEPEST / focal  # a surface changes its depth by tan(angle) / focal per pixel, relatively
    _slopes((1.0 / depth).astype(np.float32), radius, steepest, slope_x, slope_y)
    return slope_x, slope_y


@kernel
def _slopes(q: Float32s, radius: int, steepest: float, slope_x: Float32s, slope_y: Float32s) -> None:
    """Least squares through the centre over neighbours on the same surface; the loop over a row's pixels is innermost, so that
    the compiler can vectorise it."""
    h, w = q.shape
    # the normal equations of each pixel of a row
    xx = np.empty(w)
    yy = np.empty(w)
    xy = np.empty(w)
    xq = np.empty(w)
    yq = np.empty(w)
    for y in range(h):
        # ones on the diagonal hold the slope near zero where there are few neighbours
        xx[:] = 1.0
        yy[:] = 1.0
        xy[:] = 0.0
        xq[:] = 0.0
        yq[:] = 0.0
        for j in range(max(0, y - radius), min(h, y + radius + 1)):
            for dx in range(-radius, radius + 1):
                dy = j - y
                if max(abs(dx), abs(dy)) == 0:
                    continue
                first = max(0, -dx)
                last = min(w, w - dx)
                centre = q[y, first:last]
                neighbour = q[j, first + dx : last + dx]
                _add_neighbour(
                    centre, neighbour, float(dx), float(dy), steepest,
                    xx[first:last], yy[first:last], xy[first:last], xq[first:last], yq[first:last],
                )  # fmt: skip
        for x in range(w):
            if not np.isnan(q[y, x]):
                det = xx[x] * yy[x] - xy[x] * xy[x]
                slope_x[y, x] = (xq[x] * yy[x] - yq[x] * xy[x]) / det
                slope_y[y, x] = (yq[x] * xx[x] - xq[x] * xy[x]) / det


@helper
def _add_neighbour(
    centre: Float32s, neighbour: Float32s, dx: float, dy: float, steepest: float,
    xx: Float64s, yy: Float64s, xy: Float64s, xq: Float64s, yq: Float64s,
) -> None:  # fmt: skip
    """Add the neighbours at (dx, dy) of a row of pixels to their normal equations, where they are on the same surface."""
    reach = max(abs(dx), abs(dy))
    for x in range(len(centre)):
        difference = neighbour[x] - centre[x]
        # False where either is nan; adding zeros instead of branching lets the loop vectorise
        same_surface = abs(difference) <= steepest * centre[x] * reach
        xx[x] += dx * dx if same_surface else 0.0
        yy[x] += dy * dy if same_surface else 0.0
        xy[x] += dx * dy if same_surface else 0.0
        xq[x] += dx * difference if same_surface else 0.0
        yq[x] += dy * difference if same_surface else 0.0


def offset_px(depths: Sequence[Float32s], gains: Sequence[Float32s], noise: NoiseModel) -> dict[tuple[int, int], float]:
    """Systematic difference between the depths of each two pairs of a view, in pixels of a frame with a long side of at most 768.

    Each tile has a median difference; the result is the median of its absolute value over all pixels (unless the lower quartile
    is much smaller), less the part that scatter within tiles explains.  Noise differs from patch to patch and nearly cancels in
    such medians.  A partner's wrong pose or lens acts the same way on large parts of the view; along the epipolar lines,
    only the depth of another pair reveals it.

    Parameters
    ----------
    depths, gains : (h, w) float32 of each pair, as `pair_depth` returns them.
    noise : noise model; only pixels that are exact enough to be fused are compared.
    """
    h, w = depths[0].shape
    step = max(1, int(np.sqrt(h * w / _COMPARED_PIXELS)))
    Z = np.stack([depth[::step, ::step] for depth in depths])
    G = np.stack([gain[::step, ::step] for gain in gains])
    Z[~noise.usable(Z, G)] = np.nan
    result = {}
    for a, b in combinations(range(len(Z)), 2):
        gap = (Z[a] - Z[b]) / np.hypot(G[a], G[b])
        tiles = _tiles(gap)
        count = [len(tile) for tile in tiles]
        if sum(count) < _LEAST_SHARE * gap.size:
            continue
        # each tile's median difference, and how far its pixels scatter about it (standard deviation of a normal distribution)
        median = [float(np.median(tile)) for tile in tiles]
        scatter = []
        for tile, middle in zip(tiles, median, strict=True):
            scatter.append(1.4826 * float(np.median(np.abs(tile - middle))))
        # over all tiles, each as often as it has pixels
        quartile_px, median_px = np.quantile(np.repeat(np.abs(median), count), (0.25, 0.5))
        systematic_px = min(median_px, _QUARTILE_FACTOR * quartile_px)
        noise_px = _SCATTER_SHARE * np.median(np.repeat(scatter, count))
        result[a, b] = math.sqrt(max(0.0, systematic_px**2 - noise_px**2)) * min(1.0, _LONG_SIDE / max(h, w))
    return result


def _tiles(gap: Float32s) -> list[Float32s]:
    """The known differences (n,) in each tile of a view that has enough of them."""
    tiles = []
    for rows in np.array_split(gap, _TILES):
        for tile in np.array_split(rows, _TILES, axis=1):
            known = tile[np.isfinite(tile)]
            if len(known) >= _TILE_PIXELS:
                tiles.append(known)
    return tiles


def world_normals(camera: Camera, depth: DepthMap, rows: np.ndarray, columns: np.ndarray) -> Float64s:
    """(n, 3) unit normals of the local planes at pixels of a view, turned toward the camera.

    A plane is linear in inverse depth, 1/z = (A, B, c) (x, y, 1), hence (A, B, c) K X = 1 for its points X in camera axes.

    Parameters
    ----------
    camera, depth : of the view.
    rows, columns : (n,) int, pixels that have a depth.
    """
    A = depth.slope_x[rows, columns].astype(np.float64)
    B = depth.slope_y[rows, columns].astype(np.float64)
    c = 1.0 / depth.depth[rows, columns].astype(np.float64) - A * columns - B * rows
    normals = -np.column_stack([A, B, c]) @ camera.K @ camera.R
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True), dtype=np.float64)

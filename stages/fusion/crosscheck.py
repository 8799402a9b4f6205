"""What the other views say about one view's depth: who agrees, and who sees through it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..kernels import kernel
from ..types import Camera, DepthMap, Float32s, Float64s, Uint8s, Uint16s, Uint32s
from .depth import transfer

Uint64s = npt.NDArray[np.uint64]


@dataclass(frozen=True)
class Verdict:
    """Per pixel of a view, (h, w): pairs: distinct pairs that support the depth; cameras: distinct cameras in them;
    visible: other views that have the point in their image and nothing in front of it; agreeing, violating: those among them
    whose own depth agrees, or lies behind, so that they look through the point."""

    pairs: Uint8s
    cameras: Uint16s
    visible: Uint8s
    agreeing: Uint8s
    violating: Uint8s


def nearest_views(name: str, cameras: Mapping[str, Camera], depths: Mapping[str, DepthMap], count: int) -> list[str]:
    """The views that see most of what `name` sees, judged on every 8th pixel; at most `count`, at least 1 % in common."""
    depth = depths[name].depth[4::8, 4::8]
    y, x = np.nonzero(np.isfinite(depth))
    if not len(y):
        return []
    pixels = np.column_stack([8 * x + 4, 8 * y + 4, np.ones(len(x))]).astype(np.float64)
    z = depth[y, x].astype(np.float64)[:, None]
    shares = []
    for other in depths:
        if other == name:
            continue
        M, b = transfer(cameras[name], cameras[other])
        with np.errstate(divide="ignore", invalid="ignore"):
            p = z * (pixels @ M.T) + b
            u, v = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
        inside = (p[:, 2] > 0) & (u >= 0) & (v >= 0) & (u <= cameras[other].width - 1) & (v <= cameras[other].height - 1)
        shares.append((float(inside.mean()), other))
    order = sorted(range(len(shares)), key=lambda k: -shares[k][0])
    return [shares[k][1] for k in order[:count] if shares[k][0] >= 0.01]


def cross_check(name: str, others: Sequence[str], cameras: Mapping[str, Camera], depths: Mapping[str, DepthMap]) -> Verdict:
    """Project every pixel of a view into the other views and compare with the depth found there.

    A view agrees within three sigmas of both and 0.2 % of the depth; it looks through the point when its own depth lies more than
    four times that behind it.
    """
    own = depths[name]
    h, w = own.depth.shape
    pair_index, bits = _pair_bits(name, others, depths)
    pairs = _own_pairs(own.support, bits[name])
    visible, agreeing, violating = (np.zeros((h, w), np.uint8) for _ in range(3))
    for other in others:
        M, b = transfer(cameras[name], cameras[other])
        seen = depths[other]
        _compare(
            *(own.depth, own.sigma, M, b, seen.depth, seen.slope_x, seen.slope_y, seen.sigma, seen.support),
            *(bits[other], visible, agreeing, violating, pairs),
        )
    count, seen_by = np.zeros((h, w), np.uint8), np.zeros((h, w), np.uint16)
    _count(pairs, pair_index, count, seen_by)
    return Verdict(count, seen_by, visible, agreeing, violating)


def _pair_bits(name: str, others: Sequence[str], depths: Mapping[str, DepthMap]) -> tuple[Uint8s, dict[str, Uint8s]]:
    """Number the pairs that can support a point of this view, its own first; at most 64, further ones go uncounted.

    Returns (64, 2) uint8 the two cameras of each pair as small numbers, and for each view the number of each of its partners'
    pairs (255: not counted).
    """
    numbers: dict[frozenset[str], int] = {}
    cameras: dict[str, int] = {}
    pair_index = np.zeros((64, 2), np.uint8)
    bits: dict[str, Uint8s] = {}
    for view in [name, *others]:
        table = np.full(32, 255, np.uint8)
        for k, partner in enumerate(depths[view].partners):
            number = numbers.setdefault(frozenset((view, partner)), len(numbers))
            if number < 64:
                table[k] = number
                pair_index[number] = [cameras.setdefault(end, len(cameras)) for end in (view, partner)]
        bits[view] = table
    return pair_index, bits


@kernel
def _own_pairs(support: Uint32s, bits: Uint8s) -> Uint64s:
    h, w = support.shape
    pairs = np.zeros((h, w), np.uint64)
    for y in range(h):
        for x in range(w):
            for k in range(32):
                if (support[y, x] >> np.uint32(k)) & np.uint32(1) and bits[k] < 64:
                    pairs[y, x] |= np.uint64(1) << np.uint64(bits[k])
    return pairs


@kernel
def _compare(
    depth: Float32s,
    sigma: Float32s,
    M: Float64s,
    b: Float64s,
    other_depth: Float32s,
    slope_x: Float32s,
    slope_y: Float32s,
    other_sigma: Float32s,
    other_support: Uint32s,
    bits: Uint8s,
    visible: Uint8s,
    agreeing: Uint8s,
    violating: Uint8s,
    pairs: Uint64s,
) -> None:
    h, w = depth.shape
    other_h, other_w = other_depth.shape
    for y in range(h):
        for x in range(w):
            own = depth[y, x]
            if np.isnan(own):
                continue
            z = own * (M[2, 0] * x + M[2, 1] * y + M[2, 2]) + b[2]
            if not z > 0:
                continue
            u = (own * (M[0, 0] * x + M[0, 1] * y + M[0, 2]) + b[0]) / z
            v = (own * (M[1, 0] * x + M[1, 1] * y + M[1, 2]) + b[1]) / z
            if not (u > -0.5 and v > -0.5 and u < other_w - 0.5 and v < other_h - 0.5):
                continue
            i, j = int(u + 0.5), int(v + 0.5)
            if np.isnan(other_depth[j, i]):
                visible[y, x] += 1
                continue
            there = 1.0 / (1.0 / other_depth[j, i] + slope_x[j, i] * (u - i) + slope_y[j, i] * (v - j))
            s = np.sqrt(sigma[y, x] ** 2 + other_sigma[j, i] ** 2)
            tolerance = min(3.0 * s + 0.002 * z, 0.016 * z)
            if there < z - tolerance:
                continue  # hidden
            visible[y, x] += 1
            if there <= z + tolerance:
                agreeing[y, x] += 1
                for k in range(32):
                    if (other_support[j, i] >> np.uint32(k)) & np.uint32(1) and bits[k] < 64:
                        pairs[y, x] |= np.uint64(1) << np.uint64(bits[k])
            elif there > z + 4.0 * tolerance:
                violating[y, x] += 1


@kernel
def _count(pairs: Uint64s, pair_index: Uint8s, count: Uint8s, cameras: Uint16s) -> None:
    """Set bits, and distinct cameras of the pairs they stand for."""
    h, w = pairs.shape
    stamp = np.full(256, -1, np.int64)
    for y in range(h):
        for x in range(w):
            if pairs[y, x] == 0:
                continue
            for k in range(64):
                if (pairs[y, x] >> np.uint64(k)) & np.uint64(1):
                    count[y, x] += 1
                    for end in range(2):
                        camera = pair_index[k, end]
                        if stamp[camera] != y * w + x:
                            stamp[camera] = y * w + x
                            cameras[y, x] += 1

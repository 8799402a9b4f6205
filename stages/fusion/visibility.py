"""What the other views say about one view's depth: who agrees, and who sees through it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..core.cameras import transfer
from ..core.jit import kernel
from ..types import Camera, DepthMap, Float32s, Float64s, Uint8s, Uint16s, Uint32s, Uint64s


@dataclass(frozen=True)
class CrossCheck:
    """What other views say of each pixel of a view, (h, w) each."""

    pairs: Uint8s
    """Distinct pairs that support the depth..."""
    cameras: Uint16s
    """...and distinct cameras in them."""
    visible: Uint8s
    """Other views that have the point in their image and nothing in front of it."""
    agreeing: Uint8s
    """Those among them whose own depth agrees."""
    opposing: Float32s
    """Log-likelihood ratio of a right depth to a wrong one, summed over the views that make it less likely: they look through the
    point, as surely as their own depth is right."""
    hiding: Uint8s
    """Views that have something in front of the point."""
    doubted: Float32s
    """Expected number of these pairs that are wrong: the other view of a pair looks through the point, and its own depth is right
    with some probability."""
    apart: Float32s
    """Over those that agree, the sum of logarithms of how far off they put the surface on this view's ray, each over the standard
    deviation that the sigmas of both depths let expect."""
    nearest: Uint8s
    """The nearest camera among those that agree and this view: its place among the others, `ITSELF` for this view."""


@dataclass(frozen=True)
class TrustedDepth:
    """The depth of a view, and how far it is to be believed by itself."""

    depth: DepthMap
    own: Float32s
    """(h, w) log-odds that the depth is right, as far as the view knows itself."""


def probability(logit: Float32s) -> Float32s:
    """(h, w) of log-odds."""
    with np.errstate(over="ignore"):
        return np.asarray(1.0 / (1.0 + np.exp(-logit)), dtype=np.float32)


_UNCOUNTED = 255
"""The number of pairs that go uncounted."""
_SAME_SURFACE = 0.016
"""Depths that differ by no more than this share are of one surface: beyond it nothing agrees."""
_FLOOR = 0.0007
"""What depths of two views differ by beyond their sigmas, as a share."""
ITSELF = 255
_MOST_TRUST = np.float32(0.995)
"""No view is believed more than this."""
_NORMAL = 2.5066
"""What the density of a normal distribution is divided by, beside its standard deviation."""
_LEAST_APART = 0.1
"""Where two views put the surface, as a share of what is expected: nearer to each other is by chance."""


def cross_check(
    name: str, others: Sequence[str], cameras: Mapping[str, Camera], view_of: Callable[[str], TrustedDepth]
) -> CrossCheck:
    """Project every pixel of a view into the other views, one at a time, and compare with the depth found there.

    A view agrees within three sigmas of both and 0.2 % of the depth.  A pair whose other view has something in front of the point
    does not support it; one whose other view looks through the point does as far as that view's depth is wrong.

    How much a view's depth says follows from its standard deviation and from the probability t that it is right: beside a right
    depth it is normally distributed, beside a wrong one, as when it is wrong itself, it may be anything up to twice as far.  One
    that lies behind the point, where it should have seen it, has the likelihood ratio 1 - t: what is not sure itself rules
    nothing out.

    Parameters
    ----------
    name : the view.
    others : views to compare it with, in the order in which pairs are numbered.
    cameras : of all these views.
    view_of : loads a view's depth; asked once for each.
    """
    own = view_of(name).depth
    h, w = own.depth.shape
    numbers: dict[tuple[str, ...], int] = {}
    pairs = _own_pairs(own.support, _numbers_of(name, own, numbers))
    visible, agreeing, hiding = (np.zeros((h, w), np.uint8) for _ in range(3))
    apart, reach, opposing, doubted = (np.zeros((h, w), np.float32) for _ in range(4))
    nearest = np.full((h, w), ITSELF, np.uint8)
    for place, other in enumerate(others):
        M, b = transfer(cameras[name], cameras[other])
        view = view_of(other)
        seen = view.depth
        theirs = _numbers_of(other, seen, numbers)
        words = max(1, -(-min(len(numbers), _UNCOUNTED) // 64))  # of 64 bits each
        if words > len(pairs):
            pairs = np.concatenate([pairs, np.zeros((words - len(pairs), h, w), np.uint64)])
        # (4,) g and s: the square of a point's distance from the other camera, less that from its own, is s - depth g (x, y, 1)
        c = cameras[name].R @ (cameras[other].C - cameras[name].C)
        farther = np.append(2.0 * np.linalg.solve(cameras[name].K.T, c), c @ c)
        pair, rank = min(numbers.get(tuple(sorted((name, other))), _UNCOUNTED), _UNCOUNTED), min(place, ITSELF)
        surface = own.depth, own.sigma, M, b, seen.depth, seen.slope_x, seen.slope_y, seen.sigma, seen.support
        found = visible, agreeing, hiding, opposing, doubted, pairs
        _compare(*surface, probability(view.own), theirs, pair, *found, rank, farther, apart, nearest, reach)
    number: dict[str, int] = {}
    ends = [[number.setdefault(end, len(number)) for end in two] for two in [*numbers][:_UNCOUNTED]]
    count, seen_by = np.zeros((h, w), np.uint8), np.zeros((h, w), np.uint16)
    _count(pairs, np.array(ends, np.uint16).reshape(-1, 2), count, seen_by)
    return CrossCheck(count, seen_by, visible, agreeing, opposing, hiding, doubted, apart, nearest)


def _numbers_of(view: str, depth: DepthMap, numbers: dict[tuple[str, ...], int]) -> Uint8s:
    """(n,) the number of the pair with each of a view's n partners, as pairs are met; 255: not counted.

    Seventeen views that all have 32 pairs could meet twice as many, but a point that has more than a hundred needs no further.
    """
    pairs = (tuple(sorted((view, partner))) for partner in depth.partners)
    return np.array([min(numbers.setdefault(pair, len(numbers)), _UNCOUNTED) for pair in pairs], np.uint8)


@kernel
def _own_pairs(support: Uint32s, bits: Uint8s) -> Uint64s:
    """(words, h, w): bit k of word m is set where the pair of number 64 m + k supports the depth; a view has one word full."""
    h, w = support.shape
    pairs = np.zeros((1, h, w), np.uint64)
    for y in range(h):
        for x in range(w):
            for k in range(len(bits)):
                if (support[y, x] >> np.uint32(k)) & np.uint32(1) and bits[k] < 64:
                    pairs[0, y, x] |= np.uint64(1) << np.uint64(bits[k])
    return pairs


@kernel
def _compare(
    depth: Float32s, sigma: Float32s, M: Float64s, b: Float64s, other_depth: Float32s, slope_x: Float32s, slope_y: Float32s,
    other_sigma: Float32s, other_support: Uint32s, trust: Float32s, bits: Uint8s, number: int, visible: Uint8s, agreeing: Uint8s,
    hiding: Uint8s, opposing: Float32s, doubted: Float32s, pairs: Uint64s, place: int, farther_by: Float64s, apart: Float32s,
    nearest: Uint8s, reach: Float32s,
) -> None:  # fmt: skip
    h, w = depth.shape
    other_h, other_w = other_depth.shape
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = M[0, 0], M[0, 1], M[0, 2], M[1, 0], M[1, 1], M[1, 2], M[2, 0], M[2, 1], M[2, 2]
    b0, b1, b2 = b
    last = min(64 * len(pairs), _UNCOUNTED)
    common = np.uint64(1) << np.uint64(number % 64) if number < last else np.uint64(0)
    common_word = number // 64 if number < last else 0
    for y in range(h):
        for x in range(w):
            own = depth[y, x]
            if np.isnan(own):
                continue
            z = own * (m20 * x + m21 * y + m22) + b2
            if not z > 0:
                continue
            u = (own * (m00 * x + m01 * y + m02) + b0) / z
            v = (own * (m10 * x + m11 * y + m12) + b1) / z
            if not (u > -0.5 and v > -0.5 and u < other_w - 0.5 and v < other_h - 0.5):
                continue
            i, j = int(u + 0.5), int(v + 0.5)
            if np.isnan(other_depth[j, i]):
                visible[y, x] += 1
                continue
            there = 1.0 / (1.0 / other_depth[j, i] + slope_x[j, i] * (u - i) + slope_y[j, i] * (v - j))
            spread = np.sqrt(sigma[y, x] ** 2 + other_sigma[j, i] ** 2) + _FLOOR * z
            tolerance = min(3.0 * spread, _SAME_SURFACE * z)
            if there < z - tolerance:  # hidden: then that view cannot have seen it
                pairs[common_word, y, x] &= ~common
                hiding[y, x] += 1
                continue
            visible[y, x] += 1
            t, off = min(trust[j, i], _MOST_TRUST), (there - z) / spread
            ratio = np.float32(np.log(1.0 - t + t * z / (_NORMAL * spread) * np.exp(-0.5 * off * off)))
            opposing[y, x] += min(ratio, np.float32(0.0))
            if there > z + tolerance:
                if pairs[common_word, y, x] & common:
                    doubted[y, x] += t
            else:
                n0, n1 = slope_x[j, i], slope_y[j, i]  # its plane, linear in places as that camera sees them, on this pixel's ray
                n2 = 1.0 / other_depth[j, i] - n0 * i - n1 * j
                along = own * (n0 * (m00 * x + m01 * y + m02) + n1 * (m10 * x + m11 * y + m12) + n2 * (m20 * x + m21 * y + m22))
                farther = (1.0 - n0 * b0 - n1 * b1 - n2 * b2) / along - 1.0
                expected = np.sqrt((sigma[y, x] / own) ** 2 + (other_sigma[j, i] / (z * along)) ** 2)
                apart[y, x] += np.float32(np.log(max(abs(farther) / expected, _LEAST_APART)))
                beyond = farther_by[3] - own * (farther_by[0] * x + farther_by[1] * y + farther_by[2])
                if beyond < reach[y, x]:
                    reach[y, x], nearest[y, x] = beyond, place
                agreeing[y, x] += 1
                for k in range(len(bits)):
                    if (other_support[j, i] >> np.uint32(k)) & np.uint32(1) and bits[k] < last:
                        pairs[bits[k] // 64, y, x] |= np.uint64(1) << np.uint64(bits[k] % 64)


@kernel
def _count(pairs: Uint64s, pair_index: Uint16s, count: Uint8s, cameras: Uint16s) -> None:
    """Set bits, and distinct cameras of the pairs they stand for."""
    words, h, w = pairs.shape
    stamp = np.full(2 * len(pair_index) + 1, -1, np.int64)
    for y in range(h):
        for x in range(w):
            for m in range(words):
                if pairs[m, y, x] == 0:
                    continue
                for k in range(64 * m, min(64 * m + 64, len(pair_index))):
                    if (pairs[m, y, x] >> np.uint64(k - 64 * m)) & np.uint64(1):
                        count[y, x] += 1
                        for end in range(2):
                            camera = pair_index[k, end]
                            if stamp[camera] != y * w + x:
                                stamp[camera] = y * w + x
                                cameras[y, x] += 1

"""Cross-check of one view's depth against the other views: which of them agree, and which look through it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..core.cameras import transfer
from ..core.jit import kernel
from ..types import Camera, DepthMap, Float32s, Float64s, Uint8s, Uint16s, Uint32s, Uint64s


@dataclass(frozen=True)
class CrossCheck:
    """Result of the cross-check for each pixel of a view, (h, w) each."""

    pairs: Uint8s
    """Number of distinct pairs that support the depth."""
    cameras: Uint16s
    """Number of distinct cameras in these pairs."""
    visible: Uint8s
    """Number of other views that have the point in their image and nothing in front of it."""
    agreeing: Uint8s
    """Number of `visible` views whose own depth agrees."""
    opposing: Float32s
    """Sum of the log-likelihood ratios, right depth to wrong depth, of the views for which it is negative: they look through the
    point, and count by the probability that their own depth is right."""
    occluding: Uint8s
    """Number of other views that have something in front of the point."""
    expected_wrong: Float32s
    """Expected number of wrong pairs among `pairs`: the sum, over pairs whose other view looks through the point, of the
    probability that the other view's depth is right."""
    log_gap_sum: Float32s
    """Sum over the agreeing views of the logarithm of a ratio: distance between the two surfaces along this view's ray, over the
    standard deviation expected from the sigmas of both depths."""
    nearest: Uint8s
    """Camera nearest to the point, among the agreeing views and this one: its index in the other views, or `ITSELF`."""


@dataclass(frozen=True)
class TrustedDepth:
    """The depth of a view, and how reliable it is without the other views."""

    depth: DepthMap
    own_logit: Float32s
    """(h, w) log-odds that the depth is right, from the view's own evidence alone."""


def probability(logit: Float32s) -> Float32s:
    """Probability (h, w) that belongs to log-odds."""
    with np.errstate(over="ignore"):
        return np.asarray(1.0 / (1.0 + np.exp(-logit)), dtype=np.float32)


_UNCOUNTED = 255
"""Number given to all pairs beyond the first 255; they are not counted."""
_SAME_SURFACE = 0.016
"""Largest relative difference of depths on one surface: views that differ by more never agree, whatever their sigmas."""
_FLOOR = 0.0007
"""Relative standard deviation of the difference between two views' depths, in addition to their sigmas."""
ITSELF = 255
_MOST_TRUST = np.float32(0.995)
"""Upper limit of the probability that another view's depth is right."""
_ROOT_2_PI = 2.5066
"""Square root of 2 pi, by which the normal density is divided, besides its standard deviation."""
_LEAST_GAP = 0.1
"""Lower limit of the distance between two views' surfaces over the expected one: smaller distances are due to chance."""


def cross_check(
    name: str, others: Sequence[str], cameras: Mapping[str, Camera], view_of: Callable[[str], TrustedDepth]
) -> CrossCheck:
    """Project every pixel of a view into the other views, one at a time, and compare with the depth found there.

    A view agrees within three combined sigmas plus 0.2 % of the depth, at most 1.6 %.  A pair does not support the point if its
    other view has something in front of it.  If that view looks through it, the pair counts as partly wrong (`expected_wrong`).

    The weight of a view's depth follows from its standard deviation and from the probability t that it is right.  If both depths
    are right, their difference is normally distributed; if either is wrong, the other view's depth may be anything up to twice
    the point's.  A depth far behind the point thus has the likelihood ratio 1 - t: a view that is unsure of its own depth does
    not rule the point out.

    Parameters
    ----------
    name : the view.
    others : views to compare it with, in the order in which pairs are numbered.
    cameras : cameras of all these views.
    view_of : loads a view's depth; called once for each view.
    """
    own = view_of(name).depth
    h, w = own.depth.shape
    numbers: dict[tuple[str, ...], int] = {}
    pairs = _own_pairs(own.support, _pair_numbers(name, own, numbers))
    visible, agreeing, occluding = (np.zeros((h, w), np.uint8) for _ in range(3))
    log_gap_sum, least_extra, opposing, expected_wrong = (np.zeros((h, w), np.float32) for _ in range(4))
    nearest = np.full((h, w), ITSELF, np.uint8)
    for k, other in enumerate(others):
        M, b = transfer(cameras[name], cameras[other])
        view = view_of(other)
        partner, trust = view.depth, probability(view.own_logit)
        partner_pairs = _pair_numbers(other, partner, numbers)
        words = max(1, -(-min(len(numbers), _UNCOUNTED) // 64))  # of 64 bits each
        if words > len(pairs):
            pairs = np.concatenate([pairs, np.zeros((words - len(pairs), h, w), np.uint64)])
        # (4,) g and s: a point's squared distance to the other camera, minus that to its own, is s - depth g (x, y, 1)
        baseline = cameras[name].R @ (cameras[other].C - cameras[name].C)
        farther_by = np.append(2.0 * np.linalg.solve(cameras[name].K.T, baseline), baseline @ baseline)
        pair, index = min(numbers.get(tuple(sorted((name, other))), _UNCOUNTED), _UNCOUNTED), min(k, ITSELF)
        surface = own.depth, own.sigma, M, b, partner.depth, partner.slope_x, partner.slope_y, partner.sigma, partner.support
        results = visible, agreeing, occluding, opposing, expected_wrong, pairs
        _compare(*surface, trust, partner_pairs, pair, *results, index, farther_by, log_gap_sum, nearest, least_extra)
    camera_numbers: dict[str, int] = {}
    pair_cameras = [[camera_numbers.setdefault(end, len(camera_numbers)) for end in two] for two in [*numbers][:_UNCOUNTED]]
    pair_count, camera_count = np.zeros((h, w), np.uint8), np.zeros((h, w), np.uint16)
    _count_pairs_and_cameras(pairs, np.array(pair_cameras, np.uint16).reshape(-1, 2), pair_count, camera_count)
    return CrossCheck(pair_count, camera_count, visible, agreeing, opposing, occluding, expected_wrong, log_gap_sum, nearest)


def _pair_numbers(view: str, depth: DepthMap, numbers: dict[tuple[str, ...], int]) -> Uint8s:
    """(n,) number of the pair with each of a view's n partners, in order of first occurrence; 255: not counted.

    Seventeen views with 32 pairs each could have twice as many pairs, but a point with more than a hundred needs no more.
    """
    pairs = (tuple(sorted((view, partner))) for partner in depth.partners)
    return np.array([min(numbers.setdefault(pair, len(numbers)), _UNCOUNTED) for pair in pairs], np.uint8)


@kernel
def _own_pairs(support: Uint32s, pair_numbers: Uint8s) -> Uint64s:
    """(words, h, w): bit k of word m is set where pair number 64 m + k supports the depth; one word holds a view's own pairs."""
    h, w = support.shape
    pairs = np.zeros((1, h, w), np.uint64)
    for y in range(h):
        for x in range(w):
            for k in range(len(pair_numbers)):
                if (support[y, x] >> np.uint32(k)) & np.uint32(1) and pair_numbers[k] < 64:
                    pairs[0, y, x] |= np.uint64(1) << np.uint64(pair_numbers[k])
    return pairs


@kernel
def _compare(
    depth: Float32s, sigma: Float32s, M: Float64s, b: Float64s, other_depth: Float32s, slope_x: Float32s, slope_y: Float32s,
    other_sigma: Float32s, other_support: Uint32s, trust: Float32s, pair_numbers: Uint8s, common_number: int,
    visible: Uint8s, agreeing: Uint8s, occluding: Uint8s, opposing: Float32s, expected_wrong: Float32s, pairs: Uint64s,
    view_index: int, farther_by: Float64s, log_gap_sum: Float32s, nearest: Uint8s, least_extra: Float32s,
) -> None:  # fmt: skip
    h, w = depth.shape
    other_h, other_w = other_depth.shape
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = M[0, 0], M[0, 1], M[0, 2], M[1, 0], M[1, 1], M[1, 2], M[2, 0], M[2, 1], M[2, 2]
    b0, b1, b2 = b
    counted = min(64 * len(pairs), _UNCOUNTED)
    common = np.uint64(1) << np.uint64(common_number % 64) if common_number < counted else np.uint64(0)
    common_word = common_number // 64 if common_number < counted else 0
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
            surface_z = 1.0 / (1.0 / other_depth[j, i] + slope_x[j, i] * (u - i) + slope_y[j, i] * (v - j))
            sigma_z = np.sqrt(sigma[y, x] ** 2 + other_sigma[j, i] ** 2) + _FLOOR * z
            tolerance = min(3.0 * sigma_z, _SAME_SURFACE * z)
            if surface_z < z - tolerance:  # the point is hidden there, so the pair with that view cannot support it
                pairs[common_word, y, x] &= ~common
                occluding[y, x] += 1
                continue
            visible[y, x] += 1
            t, deviation = min(trust[j, i], _MOST_TRUST), (surface_z - z) / sigma_z
            ratio = np.float32(np.log(1.0 - t + t * z / (_ROOT_2_PI * sigma_z) * np.exp(-0.5 * deviation * deviation)))
            opposing[y, x] += min(ratio, np.float32(0.0))
            if surface_z > z + tolerance:
                if pairs[common_word, y, x] & common:
                    expected_wrong[y, x] += t
            else:
                n0, n1 = slope_x[j, i], slope_y[j, i]  # the other view's plane, intersected with this pixel's ray
                n2 = 1.0 / other_depth[j, i] - n0 * i - n1 * j
                along = own * (n0 * (m00 * x + m01 * y + m02) + n1 * (m10 * x + m11 * y + m12) + n2 * (m20 * x + m21 * y + m22))
                relative_gap = (1.0 - n0 * b0 - n1 * b1 - n2 * b2) / along - 1.0
                expected = np.sqrt((sigma[y, x] / own) ** 2 + (other_sigma[j, i] / (z * along)) ** 2)
                log_gap_sum[y, x] += np.float32(np.log(max(abs(relative_gap) / expected, _LEAST_GAP)))
                extra_distance = farther_by[3] - own * (farther_by[0] * x + farther_by[1] * y + farther_by[2])
                if extra_distance < least_extra[y, x]:
                    least_extra[y, x], nearest[y, x] = extra_distance, view_index
                agreeing[y, x] += 1
                for k in range(len(pair_numbers)):
                    if (other_support[j, i] >> np.uint32(k)) & np.uint32(1) and pair_numbers[k] < counted:
                        pairs[pair_numbers[k] // 64, y, x] |= np.uint64(1) << np.uint64(pair_numbers[k] % 64)


@kernel
def _count_pairs_and_cameras(pairs: Uint64s, pair_cameras: Uint16s, count: Uint8s, cameras: Uint16s) -> None:
    """Count the set bits, and the distinct cameras of the pairs that they represent."""
    words, h, w = pairs.shape
    stamp = np.full(2 * len(pair_cameras) + 1, -1, np.int64)
    for y in range(h):
        for x in range(w):
            for m in range(words):
                if pairs[m, y, x] == 0:
                    continue
                for k in range(64 * m, min(64 * m + 64, len(pair_cameras))):
                    if (pairs[m, y, x] >> np.uint64(k - 64 * m)) & np.uint64(1):
                        count[y, x] += 1
                        for end in range(2):
                            camera = pair_cameras[k, end]
                            if stamp[camera] != y * w + x:
                                stamp[camera] = y * w + x
                                cameras[y, x] += 1

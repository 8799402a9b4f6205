"""Cross-check of one view's depth against the other views: which of them agree, which look through it, and their colours."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..core.cameras import transfer
from ..core.jit import kernel
from ..types import Bools, Camera, DepthMap, Float32s, Float64s, Frame, Int32s, Uint8s, Uint16s, Uint32s, Uint64s
from .colour_evidence import colour_evidence


class CrossCheck(NamedTuple):
    """Result of the cross-check for each pixel of a view, (h, w) each."""

    pairs: Uint8s
    """Number of distinct pairs that support the depth."""
    cameras: Uint16s
    """Number of distinct cameras in these pairs."""
    agreeing: Uint8s
    """Number of other views whose own depth agrees."""
    opposing: Float32s
    """Sum of the log-likelihood ratios, right depth to wrong depth, of the views for which it is negative: they look through the
    point, and count by the probability that their own depth is right."""
    colours: Float32s
    """Sum of the `colour_evidence` of the views that have the point in their frame and nothing in front of it."""
    log_gap_sum: Float32s
    """Sum over the agreeing views of the logarithm of a ratio: distance between the two surfaces along this view's ray, over the
    standard deviation expected from the sigmas of both depths."""
    nearest: Uint8s
    """Camera nearest to the point, among the agreeing views and this one: its index in the other views, or `ITSELF`."""


@dataclass(frozen=True)
class TrustedDepth:
    """The frame of a view, its depth, and how reliable that is without the other views."""

    frame: Frame
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
    other view has something in front of it.

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
    camera, own_view = cameras[name], view_of(name)
    own, shape = own_view.depth, own_view.depth.depth.shape
    numbers: dict[tuple[str, ...], int] = {}
    _pair_numbers(name, own, numbers)  # a view's own pairs come first: their numbers are those of the bits of `support`
    pairs = own.support.astype(np.uint64)[None]
    pair_count, agreeing = (np.zeros(shape, np.uint8) for _ in range(2))
    opposing, colours, log_gap_sum, least_extra = (np.zeros(shape, np.float32) for _ in range(4))
    camera_count, nearest = np.zeros(shape, np.uint16), np.full(shape, ITSELF, np.uint8)
    check = CrossCheck(pair_count, camera_count, agreeing, opposing, colours, log_gap_sum, nearest)
    for k, other in enumerate(others):
        view = view_of(other)
        partner_pairs = _pair_numbers(other, view.depth, numbers)
        words = -(-min(len(numbers), _UNCOUNTED) // 64)
        if words > len(pairs):
            pairs = np.concatenate([pairs, np.zeros((words - len(pairs), *shape), np.uint64)])
        M, b = transfer(camera, cameras[other])
        baseline = camera.R @ (cameras[other].C - camera.C)
        partner = _Partner(
            *(M, b, view.depth.depth, view.depth.slope_x, view.depth.slope_y, view.depth.sigma, view.depth.support),
            trust=probability(view.own_logit),
            pair_numbers=partner_pairs,
            common_pair=min(numbers.get(tuple(sorted((name, other))), _UNCOUNTED), _UNCOUNTED),
            number=min(k, ITSELF),
            farther_by=np.append(2.0 * np.linalg.solve(camera.K.T, baseline), baseline @ baseline),
        )
        seen, agrees = np.full(shape, -1, np.int32), np.zeros(shape, np.bool_)
        _compare(own.depth, own.sigma, partner, check, pairs, least_extra, seen, agrees)
        points = np.flatnonzero((seen >= 0) & view.frame.mask.ravel()[seen])
        rgb1, rgb2 = own_view.frame.image.reshape(-1, 3)[points], view.frame.image.reshape(-1, 3)[seen.ravel()[points]]
        check.colours.ravel()[points] += colour_evidence(rgb1, rgb2, agrees.ravel()[points])
    camera_numbers: dict[str, int] = {}
    pair_cameras = [[camera_numbers.setdefault(end, len(camera_numbers)) for end in two] for two in [*numbers][:_UNCOUNTED]]
    _count_pairs_and_cameras(pairs, np.array(pair_cameras, np.uint16).reshape(-1, 2), check.pairs, check.cameras)
    return check


def _pair_numbers(view: str, depth: DepthMap, numbers: dict[tuple[str, ...], int]) -> Uint8s:
    """(n,) number of the pair with each of a view's n partners, in order of first occurrence; 255: not counted.

    Seventeen views with 32 pairs each could have twice as many pairs, but a point with more than a hundred needs no more.
    """
    pairs = (tuple(sorted((view, partner))) for partner in depth.partners)
    return np.array([min(numbers.setdefault(pair, len(numbers)), _UNCOUNTED) for pair in pairs], np.uint8)


class _Partner(NamedTuple):
    """A view with which another one is compared."""

    M: Float64s
    b: Float64s
    """Pixel p of the compared view at depth z projects to z M p + b."""
    depth: Float32s
    slope_x: Float32s
    slope_y: Float32s
    sigma: Float32s
    support: Uint32s
    trust: Float32s
    """(h, w) probability that the depth is right."""
    pair_numbers: Uint8s
    """Numbers of the pairs that are the bits of `support`."""
    common_pair: int
    """Number of the pair of both views."""
    number: int
    """Place among the other views."""
    farther_by: Float64s
    """(4,) g and s: a point's squared distance to this camera, minus that to the compared view's, is s - depth g (x, y, 1)."""


@kernel
def _compare(
    depth: Float32s,
    sigma: Float32s,
    other: _Partner,
    check: CrossCheck,
    pairs: Uint64s,
    least_extra: Float32s,
    seen: Int32s,
    agrees: Bools,
) -> None:
    """Add one partner to the check of a view's depth and sigma (h, w).

    pairs: (words, h, w), bit k of word m is set where pair number 64 m + k supports the depth; least_extra: (h, w), a point's
    squared distance to the nearest camera so far, minus that to the view's own; seen, agrees: (h, w), set to the index of the
    partner's pixel that shows the point, unless something is in front of it, and to whether the partner's depth agrees.
    """
    h, w = depth.shape
    other_h, other_w = other.depth.shape
    M, b0, b1, b2 = other.M, other.b[0], other.b[1], other.b[2]
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = M[0, 0], M[0, 1], M[0, 2], M[1, 0], M[1, 1], M[1, 2], M[2, 0], M[2, 1], M[2, 2]
    is_counted = other.common_pair < _UNCOUNTED
    common = np.uint64(1) << np.uint64(other.common_pair % 64) if is_counted else np.uint64(0)
    common_word = other.common_pair // 64 if is_counted else 0
    for y in range(h):
        for x in range(w):
            own = depth[y, x]
            if np.isnan(own):
                continue
            ray0, ray1, ray2 = m00 * x + m01 * y + m02, m10 * x + m11 * y + m12, m20 * x + m21 * y + m22
            z = own * ray2 + b2
            if not z > 0:
                continue
            u, v = (own * ray0 + b0) / z, (own * ray1 + b1) / z
            if not (u > -0.5 and v > -0.5 and u < other_w - 0.5 and v < other_h - 0.5):
                continue
            i, j = int(u + 0.5), int(v + 0.5)
            seen[y, x] = j * other_w + i
            if np.isnan(other.depth[j, i]):
                continue
            slope_x, slope_y = other.slope_x[j, i], other.slope_y[j, i]
            surface_z = 1.0 / (1.0 / other.depth[j, i] + slope_x * (u - i) + slope_y * (v - j))
            sigma_z = np.sqrt(sigma[y, x] ** 2 + other.sigma[j, i] ** 2) + _FLOOR * z
            tolerance = min(3.0 * sigma_z, _SAME_SURFACE * z)
            if surface_z < z - tolerance:  # the point is hidden there, so the pair with that view cannot support it
                pairs[common_word, y, x] &= ~common
                seen[y, x] = -1
                continue
            trust, deviation = min(other.trust[j, i], _MOST_TRUST), (surface_z - z) / sigma_z
            likelihood = 1.0 - trust + trust * z / (_ROOT_2_PI * sigma_z) * np.exp(-0.5 * deviation * deviation)
            check.opposing[y, x] += min(np.float32(np.log(likelihood)), np.float32(0.0))
            if surface_z > z + tolerance:  # the other view looks through the point
                continue
            check.agreeing[y, x] += 1
            agrees[y, x] = True
            # the other view's plane, intersected with this pixel's ray
            constant = 1.0 / other.depth[j, i] - slope_x * i - slope_y * j
            along = own * (slope_x * ray0 + slope_y * ray1 + constant * ray2)
            relative_gap = (1.0 - slope_x * b0 - slope_y * b1 - constant * b2) / along - 1.0
            expected = np.sqrt((sigma[y, x] / own) ** 2 + (other.sigma[j, i] / (z * along)) ** 2)
            check.log_gap_sum[y, x] += np.float32(np.log(max(abs(relative_gap) / expected, _LEAST_GAP)))
            extra = other.farther_by[3] - own * (other.farther_by[0] * x + other.farther_by[1] * y + other.farther_by[2])
            if extra < least_extra[y, x]:
                least_extra[y, x], check.nearest[y, x] = extra, other.number
            for k in range(len(other.pair_numbers)):
                pair = other.pair_numbers[k]
                if (other.support[j, i] >> np.uint32(k)) & np.uint32(1) and pair < _UNCOUNTED:
                    pairs[pair // 64, y, x] |= np.uint64(1) << np.uint64(pair % 64)


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

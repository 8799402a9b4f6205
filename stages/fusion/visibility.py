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


_SIGMAS = 3.0
"""Combined standard deviations up to which two views' depths agree."""

_UNCOUNTED = 255
"""Number given to all pairs beyond the first 255; they are not counted."""

_SAME_SURFACE = 0.016
"""Largest relative difference of depths on one surface: views that differ by more never agree, whatever their sigmas."""

_FLOOR = 0.0007
"""Relative standard deviation of the difference between two views' depths, in addition to their sigmas."""

ITSELF = 255
"""`CrossCheck.nearest` where no other camera is nearer than the view's own."""

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
    camera = cameras[name]
    own_view = view_of(name)
    own = own_view.depth
    shape = own.depth.shape
    numbers: dict[tuple[str, ...], int] = {}
    _pair_numbers(name, own, numbers)  # a view's own pairs come first: their numbers are those of the bits of `support`
    pairs = own.support.astype(np.uint64)[None]  # (words, h, w), 64 pairs in each word
    least_extra = np.zeros(shape, np.float32)
    check = CrossCheck(
        pairs=np.zeros(shape, np.uint8),
        cameras=np.zeros(shape, np.uint16),
        agreeing=np.zeros(shape, np.uint8),
        opposing=np.zeros(shape, np.float32),
        colours=np.zeros(shape, np.float32),
        log_gap_sum=np.zeros(shape, np.float32),
        nearest=np.full(shape, ITSELF, np.uint8),
    )
    for k, other in enumerate(others):
        view = view_of(other)
        partner = _partner(k, (name, camera), (other, cameras[other]), view, numbers)
        words = -(-min(len(numbers), _UNCOUNTED) // 64)  # rounded up
        if words > len(pairs):
            pairs = np.concatenate([pairs, np.zeros((words - len(pairs), *shape), np.uint64)])

        # 1. Depths: what agrees, what looks through the point, and where the other view shows it.
        seen = np.full(shape, -1, np.int32)
        agrees = np.zeros(shape, np.bool_)
        _compare(own.depth, own.sigma, partner, check, pairs, least_extra, seen, agrees)

        # 2. Colours, wherever the point is in the other frame with nothing in front of it.
        points = np.flatnonzero((seen >= 0) & view.frame.mask.ravel()[seen])
        own_rgb = own_view.frame.image.reshape(-1, 3)[points]
        other_rgb = view.frame.image.reshape(-1, 3)[seen.ravel()[points]]
        check.colours.ravel()[points] += colour_evidence(own_rgb, other_rgb, agrees.ravel()[points])
    _count_pairs_and_cameras(pairs, _camera_numbers(list(numbers)[:_UNCOUNTED]), check.pairs, check.cameras)
    return check


def _partner(
    number: int, own: tuple[str, Camera], other: tuple[str, Camera], view: TrustedDepth, numbers: dict[tuple[str, ...], int]
) -> _Partner:
    """Another view, prepared for the comparison; its pairs get numbers.

    Parameters
    ----------
    number : its place among the other views.
    own, other : ids and cameras of the compared view, and of the other.
    view : depth of the other view.
    numbers : numbers of the pairs so far; changed.
    """
    own_name, camera = own
    other_name, other_camera = other
    pair_numbers = _pair_numbers(other_name, view.depth, numbers)
    common_pair = numbers.get(tuple(sorted((own_name, other_name))), _UNCOUNTED)
    M, b = transfer(camera, other_camera)
    # squared distances of a point X = C + z R' K^-1 p: |X - C_other|^2 - |X - C|^2 = |c|^2 - 2 z c' K^-1 p, with the baseline c
    baseline = camera.R @ (other_camera.C - camera.C)
    return _Partner(
        M=M,
        b=b,
        depth=view.depth.depth,
        slope_x=view.depth.slope_x,
        slope_y=view.depth.slope_y,
        sigma=view.depth.sigma,
        support=view.depth.support,
        trust=probability(view.own_logit),
        pair_numbers=pair_numbers,
        common_pair=min(common_pair, _UNCOUNTED),
        number=min(number, ITSELF),
        farther_by=np.append(2.0 * np.linalg.solve(camera.K.T, baseline), baseline @ baseline),
    )


def _camera_numbers(pairs: Sequence[tuple[str, ...]]) -> Uint16s:
    """(n, 2) numbers of the cameras of n pairs, in order of first occurrence."""
    numbers: dict[str, int] = {}
    pair_cameras = []
    for pair in pairs:
        pair_cameras.append([numbers.setdefault(camera, len(numbers)) for camera in pair])
    return np.array(pair_cameras, np.uint16).reshape(-1, 2)


def _pair_numbers(view: str, depth: DepthMap, numbers: dict[tuple[str, ...], int]) -> Uint8s:
    """(n,) number of the pair with each of a view's n partners, in order of first occurrence; 255: not counted.

    Seventeen views with 32 pairs each could have twice as many pairs, but a point with more than a hundred needs no more.
    """
    own_numbers = []
    for partner in depth.partners:
        pair = tuple(sorted((view, partner)))
        number = numbers.setdefault(pair, len(numbers))
        own_numbers.append(min(number, _UNCOUNTED))
    return np.array(own_numbers, np.uint8)


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
    """Add one partner to the check of a view.

    Parameters
    ----------
    depth, sigma : (h, w) of the view.
    other, check : the partner, and the check of the view so far.
    pairs : (words, h, w), bit k of word m is set where pair number 64 m + k supports the depth.
    least_extra : (h, w) a point's squared distance to the nearest camera so far, minus that to the view's own.
    seen : (h, w) set to the index of the partner's pixel that shows the point, unless something is in front of it.
    agrees : (h, w) set to whether the partner's depth agrees.
    """
    h, w = depth.shape
    other_h, other_w = other.depth.shape
    # scalars, which the compiler keeps in registers
    M = other.M
    m00, m01, m02 = M[0, 0], M[0, 1], M[0, 2]
    m10, m11, m12 = M[1, 0], M[1, 1], M[1, 2]
    m20, m21, m22 = M[2, 0], M[2, 1], M[2, 2]
    b0, b1, b2 = other.b[0], other.b[1], other.b[2]
    # the bit of the pair of both views, and its word; no bit if it is not counted
    common = np.uint64(0)
    common_word = 0
    if other.common_pair < _UNCOUNTED:
        common = np.uint64(1) << np.uint64(other.common_pair % 64)
        common_word = other.common_pair // 64
    for y in range(h):
        for x in range(w):
            own = depth[y, x]
            if np.isnan(own):
                continue
            # 1. Where does the other view show the point, and at what depth?
            ray0 = m00 * x + m01 * y + m02
            ray1 = m10 * x + m11 * y + m12
            ray2 = m20 * x + m21 * y + m22
            z = own * ray2 + b2
            if not z > 0:
                continue
            u = (own * ray0 + b0) / z
            v = (own * ray1 + b1) / z
            if not (u > -0.5 and v > -0.5 and u < other_w - 0.5 and v < other_h - 0.5):
                continue
            i = int(u + 0.5)
            j = int(v + 0.5)
            seen[y, x] = j * other_w + i

            # 2. Is the other view's surface, extended to the exact position, in front of the point?
            if np.isnan(other.depth[j, i]):
                continue
            slope_x = other.slope_x[j, i]
            slope_y = other.slope_y[j, i]
            surface_z = 1.0 / (1.0 / other.depth[j, i] + slope_x * (u - i) + slope_y * (v - j))
            sigma_z = np.sqrt(sigma[y, x] ** 2 + other.sigma[j, i] ** 2) + _FLOOR * z
            tolerance = min(_SIGMAS * sigma_z, _SAME_SURFACE * z)
            if surface_z < z - tolerance:  # the point is hidden there, so the pair with that view cannot support it
                pairs[common_word, y, x] &= ~common
                seen[y, x] = -1
                continue

            # 3. How likely is its depth if the point is right, relative to wrong?  (See `cross_check`; only doubts count here.)
            trust = min(other.trust[j, i], _MOST_TRUST)
            deviation = (surface_z - z) / sigma_z
            likelihood = 1.0 - trust + trust * z / (_ROOT_2_PI * sigma_z) * np.exp(-0.5 * deviation * deviation)
            check.opposing[y, x] += min(np.float32(np.log(likelihood)), np.float32(0.0))
            if surface_z > z + tolerance:  # the other view looks through the point
                continue

            # 4. The depths agree.  How far apart are the surfaces along this view's ray, relative to the expected distance?
            check.agreeing[y, x] += 1
            agrees[y, x] = True
            constant = 1.0 / other.depth[j, i] - slope_x * i - slope_y * j
            along = own * (slope_x * ray0 + slope_y * ray1 + constant * ray2)
            relative_gap = (1.0 - slope_x * b0 - slope_y * b1 - constant * b2) / along - 1.0
            expected = np.sqrt((sigma[y, x] / own) ** 2 + (other.sigma[j, i] / (z * along)) ** 2)
            check.log_gap_sum[y, x] += np.float32(np.log(max(abs(relative_gap) / expected, _LEAST_GAP)))

            # 5. Is that camera the nearest so far?  The pairs that support its depth support the point, too.
            extra = other.farther_by[3] - own * (other.farther_by[0] * x + other.farther_by[1] * y + other.farther_by[2])
            if extra < least_extra[y, x]:
                least_extra[y, x] = extra
                check.nearest[y, x] = other.number
            for k in range(len(other.pair_numbers)):
                pair = other.pair_numbers[k]
                if (other.support[j, i] >> np.uint32(k)) & np.uint32(1) and pair < _UNCOUNTED:
                    pairs[pair // 64, y, x] |= np.uint64(1) << np.uint64(pair % 64)


@kernel
def _count_pairs_and_cameras(pairs: Uint64s, pair_cameras: Uint16s, count: Uint8s, cameras: Uint16s) -> None:
    """Count the set bits, and the distinct cameras of the pairs that they represent.

    Parameters
    ----------
    pairs : (words, h, w), as in `_compare`.
    pair_cameras : (n, 2) numbers of the cameras of each pair.
    count, cameras : (h, w) initially 0; changed in place.
    """
    words, h, w = pairs.shape
    # stamp[c]: the last pixel at which camera c was counted, so that nothing has to be cleared for the next one
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

"""Which views share ground: judged from poses where they are known, from appearance where they aren't.

With poses, rays of each view are projected into the others (`twoview.shared_ground`).

Without poses, the descriptors of each view's *largest* keypoints are compared: a few hundred of them rank the pairs better
than twice as many of the strongest, since large structures survive a change of viewpoint (rank correlation with the angle
between views on two photographed sites: 0.98 and 0.91 against 0.91 and 0.89).  Only mutual and distinctive resemblances count,
since some descriptors always resemble each other.  What is large in the picture of a long lens is small in that of a short
lens: if fields of view are unequal, the largest keypoints are chosen among those whose angular size both views can show, and
the wider view gets more in proportion to its field.  Of many views, only those that look most similar as whole pictures are
compared (`matching.appearance`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from .core.cameras import camera_id, field_ratio
from .matching.appearance import most_similar
from .matching.matcher import plain_rows
from .orientation.observed_placements import with_observed
from .twoview.shared_ground import shared_ground
from .types import Bools, Camera, Features, Float32s, Float64s, Int32s, Int64s, ObservedPoses, Overlap, Placement, View

_MOST_FOR_ALL_PAIRS = 32
"""Up to this many views all pairs are compared."""
_UNEQUAL_RATIO = 2.0
"""If the areas that two views see differ by at least this factor, only keypoints of sizes that both can show are compared."""
_LARGEST_QUANTILE = 0.98
"""Quantile that counts as the largest keypoint size of a view: a few keypoints are as large as the picture."""


def estimate_overlap(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    features: Mapping[str, Features],
    observed: ObservedPoses | None = None,
    *,
    descriptors: int = 800,
    ratio: float = 0.85,
    candidates: int = 24,
) -> Overlap:
    """Estimate for every pair of cameras how much of one view the other sees.

    The result has a row for each pair with some evidence, but none for two views of one camera, nor, among more than 32 views,
    for posed pairs that share nothing.  `source` is "poses", "appearance" or "mixed".

    Parameters
    ----------
    views : the pinhole of every camera that has a frame, in the order of the site.
    placements : poses where known.
    features : keypoints of each camera; used for pairs in which a pose or the intrinsics are missing.
    observed : poses from observations of things, if there are any.
    descriptors : number of each view's largest keypoints that are compared.
    ratio : a resemblance counts if its distance is below this share of the second nearest's, both ways.
    candidates : among more than 32 views, a pair without both poses is compared only if one view is among this many that look
        most like the other.
    """
    # 1. Views with poses: by the ground that they share.  Views are numbered by their position in the site.
    known = with_observed(views, placements, observed)
    views = known.views
    placements = known.placements
    cameras: dict[int, Camera] = {}
    keypoints: dict[int, _Keypoints] = {}
    for i, (name, view) in enumerate(views.items()):
        camera = _camera(view, placements.get(name))
        if camera is not None:
            cameras[i] = camera
        if name in features:
            keypoints[i] = _Keypoints.of(features[name], view)
    posed = np.array(list(cameras), np.int64)
    pairs, angle, shared = shared_ground(list(cameras.values()))
    posed_pairs = posed[pairs]
    keep = _of_two_cameras(views, posed_pairs)

    # 2. The others: by appearance, which tells no angle.
    largest = {i: view.largest(descriptors) for i, view in keypoints.items()}
    compared_pairs = _pairs_to_compare(largest, cameras, candidates)
    compared_pairs = compared_pairs[_of_two_cameras(views, compared_pairs)]
    likeness = np.zeros(len(compared_pairs))
    for row, (i, j) in enumerate(compared_pairs.tolist()):
        likeness[row] = _likeness(keypoints[i], keypoints[j], descriptors, ratio)

    # 3. Both together, by the first view of a pair and then by the second.
    all_pairs = np.concatenate([posed_pairs[keep], compared_pairs])
    all_angles = np.concatenate([angle[keep], np.full(len(compared_pairs), np.nan)])
    all_shares = np.concatenate([shared[keep], likeness])
    order = np.lexsort(all_pairs.T[::-1])
    if not keep.any():
        source = "appearance"
    else:
        source = "mixed" if len(compared_pairs) else "poses"
    return Overlap(tuple(views), all_pairs[order].astype(np.int32), np.degrees(all_angles[order]), all_shares[order], source)


def _camera(view: View, placement: Placement | None) -> Camera | None:
    """The camera of a view whose pose and intrinsics, known or guessed, are there."""
    if placement is None or placement.R is None or placement.C is None or view.K is None:
        return None
    return Camera(view.K, placement.R, placement.C, view.width, view.height)


def _of_two_cameras(views: Mapping[str, View], pairs: Int64s) -> Bools:
    """(m,) which pairs (m, 2) of positions are of two cameras: two views of one camera give no depth."""
    camera = np.array([camera_id(name, view) for name, view in views.items()])
    return np.asarray(camera[pairs[:, 0]] != camera[pairs[:, 1]])


def _pairs_to_compare(descriptors: Mapping[int, Float32s], posed: Mapping[int, Camera], candidates: int) -> Int64s:
    """(m, 2) positions of the views to compare by appearance: pairs without both poses, among many views the most similar."""
    positions = list(descriptors)
    if len(positions) <= _MOST_FOR_ALL_PAIRS:
        pairs: Sequence[tuple[int, int]] = list(combinations(range(len(positions)), 2))
    else:
        pairs = most_similar(list(descriptors.values()), candidates)
    wanted = []
    for a, b in pairs:
        i = positions[a]
        j = positions[b]
        if i not in posed or j not in posed:
            wanted.append((i, j))
    return np.array(wanted, np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class _Keypoints:
    """The keypoints of a frame's plain view, the largest first."""

    descriptors: Float32s
    """(n, d)"""
    size: Float64s
    """(n,) tangent of the angle that each keypoint subtends; pixels if the lens is not known."""
    view: View

    @classmethod
    def of(cls, features: Features, view: View) -> _Keypoints:
        """The keypoints of the plain view among all of a frame."""
        plain = plain_rows(features)
        area = np.abs(np.linalg.det(features.frames[plain]))
        order = np.argsort(-area, kind="stable")
        pixel_size = 1.0 if view.K is None else 1 / float(view.K[0, 0])
        return cls(features.descriptors[plain[order]], np.sqrt(area[order]) * pixel_size, view)

    def largest(self, count: float, below: float = np.inf) -> Float32s:
        """(m, d) descriptors of the `count` largest keypoints that are no larger than `below`."""
        first = int(np.searchsorted(-self.size, -below))
        return self.descriptors[first : first + round(count)]


def _likeness(left: _Keypoints, right: _Keypoints, count: int, ratio: float) -> float:
    """Share of the keypoints comparable in both views that resemble each other, 0 to 1."""
    factor = field_ratio(left.view, right.view)
    are_equal = 1 / _UNEQUAL_RATIO < factor < _UNEQUAL_RATIO
    if are_equal or len(left.size) == 0 or len(right.size) == 0:
        return _resemblance(left.largest(count), right.largest(count), ratio)
    # both views can show keypoints up to the largest ones of the longer lens; the wider view gets more, by its larger field
    limit = min(float(np.quantile(keypoints.size, _LARGEST_QUANTILE)) for keypoints in (left, right))
    left_largest = left.largest(count * max(factor, 1), limit)
    right_largest = right.largest(count * max(1 / factor, 1), limit)
    return _resemblance(left_largest, right_largest, ratio)


def _resemblance(left: Float32s, right: Float32s, ratio: float) -> float:
    """Share of the descriptors with a mutual and distinctive nearest neighbour, 0 to 1."""
    fewer = min(len(left), len(right))
    if fewer < 3:
        return 0.0
    similarity = left @ right.T
    forward, is_clear_forward = _distinctive(similarity, ratio)
    # the transpose is copied, since the search along columns would take three times as long
    backward, is_clear_backward = _distinctive(np.ascontiguousarray(similarity.T), ratio)
    is_mutual = backward[forward] == np.arange(len(left))
    return float((is_mutual & is_clear_forward & is_clear_backward[forward]).sum() / fewer)


def _distinctive(similarity: Float32s, ratio: float) -> tuple[Int32s, Bools]:
    """Per row the best column, and whether its distance is below `ratio` times the second's; leaves `similarity` unchanged."""
    rows = np.arange(len(similarity))
    best = similarity.argmax(axis=1)
    first = similarity[rows, best]
    similarity[rows, best] = -1.0
    second = similarity.max(axis=1)
    similarity[rows, best] = first
    # descriptors have unit length, so squared distances are 2 - 2 times the similarity
    is_distinctive = (2 - 2 * first) < ratio**2 * (2 - 2 * second)
    return best.astype(np.int32), np.asarray(is_distinctive)

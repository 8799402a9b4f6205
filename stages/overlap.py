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
from .twoview.shared_ground import shared_ground
from .types import Bools, Camera, Features, Float32s, Float64s, Int32s, Int64s, Overlap, Placement, View

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
    descriptors : number of each view's largest keypoints that are compared.
    ratio : a resemblance counts if its distance is below this share of the second nearest's, both ways.
    candidates : among more than 32 views, a pair without both poses is compared only if one view is among this many that look
        most like the other.
    """
    names = tuple(views)
    cameras = {i: camera for i, name in enumerate(names) if (camera := _camera(views[name], placements.get(name))) is not None}
    posed = np.array(list(cameras), np.int64)
    pairs, angle, shared = shared_ground(list(cameras.values()))
    different = _of_two_cameras(views, posed[pairs])
    pairs, angle, shared = posed[pairs][different], angle[different], shared[different]
    keypoints = {i: _Keypoints.of(features[name], view) for i, (name, view) in enumerate(views.items()) if name in features}
    to_compare = _pairs_to_compare({i: view.largest(descriptors) for i, view in keypoints.items()}, cameras, candidates)
    to_compare = to_compare[_of_two_cameras(views, to_compare)]
    likeness = np.array([_likeness(keypoints[i], keypoints[j], descriptors, ratio) for i, j in to_compare.tolist()], np.float64)
    source = "mixed" if len(pairs) and len(to_compare) else "poses" if len(pairs) else "appearance"
    all_pairs = np.concatenate([pairs, to_compare])
    order = np.lexsort(all_pairs.T[::-1])
    angle, shared = np.concatenate([angle, np.full(len(to_compare), np.nan)]), np.concatenate([shared, likeness])
    return Overlap(names, all_pairs[order].astype(np.int32), np.degrees(angle[order]), shared[order], source)


def _of_two_cameras(views: Mapping[str, View], pairs: Int64s) -> Bools:
    """(m,) which pairs (m, 2) of positions are of two cameras: two views of one camera give no depth."""
    camera = np.array([camera_id(name, view) for name, view in views.items()])
    return np.asarray(camera[pairs[:, 0]] != camera[pairs[:, 1]])


def _pairs_to_compare(descriptors: Mapping[int, Float32s], posed: Mapping[int, Camera], candidates: int) -> Int64s:
    """(m, 2) positions of the views to compare by appearance: pairs without both poses, among many views the most similar."""
    if len(descriptors) <= _MOST_FOR_ALL_PAIRS:
        pairs: Sequence[tuple[int, int]] = list(combinations(descriptors, 2))
    else:
        positions = list(descriptors)
        pairs = [(positions[i], positions[j]) for i, j in most_similar([descriptors[i] for i in positions], candidates)]
    return np.array([(i, j) for i, j in pairs if not (i in posed and j in posed)], np.int64).reshape(-1, 2)


def _camera(view: View, placement: Placement | None) -> Camera | None:
    if placement is None or placement.R is None or placement.C is None or view.K is None:
        return None
    return Camera(view.K, placement.R, placement.C, view.width, view.height)


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
        plain = np.flatnonzero(features.tilts == 0)
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
    if 1 / _UNEQUAL_RATIO < factor < _UNEQUAL_RATIO or not min(len(left.size), len(right.size)):
        return _resemblance(left.largest(count), right.largest(count), ratio)
    limit = min(float(np.quantile(keypoints.size, _LARGEST_QUANTILE)) for keypoints in (left, right))
    return _resemblance(left.largest(count * max(factor, 1), limit), right.largest(count * max(1 / factor, 1), limit), ratio)


def _resemblance(left: Float32s, right: Float32s, ratio: float) -> float:
    """Share of the descriptors with a mutual and distinctive nearest neighbour, 0 to 1."""
    if min(len(left), len(right)) < 3:
        return 0.0
    similarity = left @ right.T
    forward, ok_forward = _distinctive(similarity, ratio)
    backward, ok_backward = _distinctive(np.ascontiguousarray(similarity.T), ratio)  # along columns it takes three times as long
    mutual = backward[forward] == np.arange(len(left))
    return float((mutual & ok_forward & ok_backward[forward]).sum() / min(len(left), len(right)))


def _distinctive(similarity: Float32s, ratio: float) -> tuple[Int32s, Bools]:
    """Per row the best column, and whether its distance is below `ratio` times the second's; leaves `similarity` unchanged."""
    rows = np.arange(len(similarity))
    best = similarity.argmax(axis=1)
    first = similarity[rows, best]
    similarity[rows, best] = -1.0
    second = similarity.max(axis=1)
    similarity[rows, best] = first
    return best.astype(np.int32), np.asarray((2 - 2 * first) < ratio**2 * (2 - 2 * second))

"""Even regions of an image, and the planes that the depths in each of them define.

A region is connected and has no edges; nearby pixels of its colour belong to it, too.  Planes are found by RANSAC, from the
largest region on, fitted with weights that fall with the error, and shared with the other regions that lie on them: the plaster
between the windows of a façade is many regions and one plane.

References: Fischler, Bolles, Random Sample Consensus, CACM 1981; Beaton, Tukey, The Fitting of Power Series, Technometrics 1974
(weights).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..types import Bools, Float32s, Float64s, Int32s, Int64s, Uint8s

_EVEN = 6
"""Grey levels: 3x3 pixels that differ by no more than this in every colour channel have no edge."""
_BESIDE, _ALIKE = 3, 10
"""Largest distance (in an image 768 wide) and difference (grey levels) from a region's nearest pixel for pixels to join it."""
_SMALLEST = 40
"""Fewest pixels of a region, in an image 768 wide."""
_FEWEST = 15
"""Fewest depths of a region that can define a plane or join one."""
_TRIALS = 64
"""Planes that RANSAC tries."""
_ROUNDS = 4
"""Rounds of fitting a plane and joining regions."""
_AGAIN = 0.2
"""Smallest share of a region's depths, off its first plane, that may define a second: a box before a wall of the same colour."""
_JOIN_PX = 0.1
"""Largest median distance of a region from a plane that it joins, beyond what noise explains, pixels."""
NEAR_PX = 2.0
"""Largest distance of a depth that supports a plane, pixels of a source."""
CORRELATED = 240.0
"""Number of neighbouring pixels with the same error: patches overlap and planes propagate (fitted on the demo's weak yard)."""


@dataclass(frozen=True)
class RegionPlane:
    """A plane in inverse depth, in pixels of a source: (1, x, y) @ plane with x and y from the middle of the image."""

    plane: Float64s
    """(3,)"""
    covariance: Float64s
    """(3, 3) of `plane`."""
    spread: float
    """Robust standard deviation of single depths from the plane."""
    regions: tuple[int, ...]
    """Numbers of the regions that lie on it."""

    def variance(self, at: Float64s) -> Float64s:
        """(n,) variance of the plane's value at positions (n, 3), each (1, x, y)."""
        return np.asarray(np.sum((at @ self.covariance) * at, axis=1), dtype=np.float64)


def textureless_regions(image: Uint8s, usable: Bools, spacing: int) -> Int32s:
    """(h, w) numbers 1, 2, ... of the even regions of an image, 0 for none.

    image, usable : (h, w, 3), and (h, w) where it may be matched.
    spacing : pixels for each pixel of an image 768 wide.
    """
    square = np.ones((3, 3), np.uint8)
    differ = (cv2.dilate(image, square) - cv2.erode(image, square)).max(axis=2)
    even = ((differ <= _EVEN) & usable).astype(np.uint8)
    _, found, stats, _ = cv2.connectedComponentsWithStats(even, connectivity=4)
    kept = stats[:, cv2.CC_STAT_AREA] >= _SMALLEST * spacing**2
    kept[0] = False
    number = np.asarray((np.cumsum(kept) * kept)[found], dtype=np.int32)
    if not kept.any():
        return number
    outside = (number == 0).astype(np.uint8)
    away, nearest = cv2.distanceTransformWithLabels(outside, cv2.DIST_C, 3, labelType=cv2.DIST_LABEL_PIXEL)
    places = np.flatnonzero(number)
    place = np.zeros(int(nearest.max()) + 1, np.int64)
    place[nearest.ravel()[places]] = places
    there = place[nearest]  # flat index of the nearest pixel of a region
    unlike = np.abs(image.astype(np.int16) - image.reshape(-1, 3)[there].astype(np.int16)).max(axis=2)
    belongs = usable & ((away <= 1) | ((away <= _BESIDE * spacing) & (unlike <= _ALIKE)))
    return np.asarray(np.where(belongs, number.ravel()[there], 0), dtype=np.int32)


def planes_of_regions(regions: Int32s, known: Float32s, spacing: int) -> list[RegionPlane]:
    """Planes that depths in even regions define, beginning with the region that has most depths.

    known: (h, w) inverse depths in pixels of a source, nan where there is no reliable one; spacing: as in `textureless_regions`.
    """
    rng = np.random.default_rng(1)
    known_there = (regions > 0) & np.isfinite(known)
    y, x = (spacing * among for among in np.nonzero(known_there[::spacing, ::spacing]))
    of = regions[y, x]
    order = np.argsort(of, kind="stable")
    y, x, of = y[order], x[order], of[order]
    at, d = from_middle(x, y, known.shape), known[y, x].astype(np.float64)
    ends = np.searchsorted(of, np.arange(1, regions.max() + 2))
    free = {k: np.arange(ends[k - 1], ends[k]) for k in range(1, len(ends))}
    free = {k: mine for k, mine in free.items() if len(mine) >= _FEWEST}
    enough = {k: max(_FEWEST, int(_AGAIN * len(mine))) for k, mine in free.items()}
    seeds = sorted(free, key=lambda k: (-len(free[k]), k))
    found = []
    for seed in (k for k in seeds for _ in range(2)):
        if len(free.get(seed, ())) < enough[seed]:
            continue
        plane = _grown(at, d, free, seed, rng)
        if plane is None:
            continue
        found.append(plane)
        for k in plane.regions:
            left = free.pop(k)
            left = left[np.abs(d[left] - at[left] @ plane.plane) > NEAR_PX]
            if len(left) >= enough[k]:
                free[k] = left
    return found


def from_middle(x: Int64s, y: Int64s, shape: tuple[int, ...]) -> Float64s:
    """(n, 3): 1, x, y from the middle of an image of this shape."""
    return np.column_stack([np.ones(len(x)), x - shape[1] / 2, y - shape[0] / 2])


def _grown(at: Float64s, d: Float64s, free: dict[int, Int64s], seed: int, rng: np.random.Generator) -> RegionPlane | None:
    mine = free[seed]
    start = _tried(at[mine], d[mine], rng)
    plane = None if start is None else _fitted(at[mine], d[mine], start, (seed,))
    for _ in range(_ROUNDS):
        if plane is None:
            return None
        members = {seed} | {k for k, i in free.items() if _joins(at[i], d[i], plane)}
        if members == set(plane.regions):
            break
        i = np.concatenate([free[k] for k in sorted(members)])
        plane = _fitted(at[i], d[i], plane.plane, tuple(sorted(members)))
    return plane


def _tried(at: Float64s, d: Float64s, rng: np.random.Generator) -> Float64s | None:
    """(3,) the best of random planes through three depths each; None if all triples are nearly collinear."""
    triples = rng.integers(0, len(d), (_TRIALS, 3))
    triples = triples[np.abs(np.linalg.det(at[triples])) > 0.02 * len(d)]  # no thin triangles
    if not len(triples):
        return None
    planes = np.linalg.solve(at[triples], d[triples][..., None])[..., 0]
    off = np.abs(at @ planes.T - d[:, None])
    return np.asarray(planes[np.minimum(off, NEAR_PX).sum(axis=0).argmin()], dtype=np.float64)


def _fitted(at: Float64s, d: Float64s, plane: Float64s, regions: tuple[int, ...]) -> RegionPlane | None:
    """Least squares with Tukey's weights, from a first plane; None if too few depths lie near it."""
    inverse, spread = np.eye(3), 0.0
    for _ in range(5):
        off = d - at @ plane
        near = np.abs(off) <= NEAR_PX
        if near.sum() < min(_FEWEST, len(d) / 3):
            return None
        spread = float(1.4826 * np.median(np.abs(off[near])))
        u = np.clip(off / max(4.685 * spread, 1e-3), -1, 1)
        weighted = at * ((1 - u * u) ** 2)[:, None]
        normal = np.einsum("ni,nj->ij", weighted, at)
        if np.linalg.matrix_rank(normal) < 3:
            return None
        inverse = np.linalg.inv(normal)
        plane = inverse @ np.einsum("ni,n->i", weighted, d)
    return RegionPlane(plane, spread**2 * CORRELATED * inverse, spread, regions)


def _joins(at: Float64s, d: Float64s, plane: RegionPlane) -> bool:
    """Do depths (n,) at positions (n, 3) lie on a plane to within noise?"""
    off = d - at @ plane.plane
    variance = float(plane.variance(at.mean(axis=0)[None])[0])
    noise = np.sqrt(variance + plane.spread**2 * min(1.0, CORRELATED / len(d)))
    return bool(abs(np.median(off)) <= noise + _JOIN_PX and np.median(np.abs(off)) <= 1.2 * plane.spread + _JOIN_PX)

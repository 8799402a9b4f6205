"""Textureless regions of an image, and the planes that the depths in each of them define.

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

_MOST_CONTRAST = 6
"""Grey levels; 3 x 3 pixels that differ by no more than this in every colour channel have no edge."""
_JOIN_DISTANCE = 3
"""Largest distance from a region's nearest pixel, in pixels of an image 768 wide, for pixels to join it."""

_JOIN_DIFFERENCE = 10
"""Largest difference from a region's nearest pixel, in grey levels of any channel, for pixels to join it."""

_LEAST_PIXELS = 40
"""Fewest pixels of a region, in an image 768 wide."""

_FEWEST_DEPTHS = 15
"""Fewest depths of a region that can define a plane or join one."""

_TRIALS = 64
"""Planes that RANSAC tries."""

_ROUNDS = 4
"""Rounds of fitting a plane and joining regions."""

_FITS = 5
"""Weighted least-squares fits in a round: the weights follow the errors of the previous one."""

_TUKEY = 4.685
"""Errors beyond this many standard deviations have no weight (95 % efficiency on normal errors)."""

_SECOND_SHARE = 0.2
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
    """(h, w) numbers 1, 2, ... of the textureless regions of an image, 0 for none.

    image, usable : (h, w, 3), and (h, w) where it may be matched.
    spacing : pixels for each pixel of an image 768 wide.
    """
    # 1. Connected pixels without edges, in regions that are large enough; numbered afresh without the others.
    square = np.ones((3, 3), np.uint8)
    contrast = (cv2.dilate(image, square) - cv2.erode(image, square)).max(axis=2)
    textureless = ((contrast <= _MOST_CONTRAST) & usable).astype(np.uint8)
    _, label, stats, _ = cv2.connectedComponentsWithStats(textureless, connectivity=4)
    kept_regions = stats[:, cv2.CC_STAT_AREA] >= _LEAST_PIXELS * spacing**2
    kept_regions[0] = False
    number = np.asarray((np.cumsum(kept_regions) * kept_regions)[label], dtype=np.int32)
    if not kept_regions.any():
        return number

    # 2. Pixels nearby join the nearest region if their colour is nearly that of its nearest pixel.  OpenCV labels each pixel with
    #    its nearest pixel of a region, in an order of its own; `pixel_of_label` gives their flat indices.
    outside = (number == 0).astype(np.uint8)
    distance, nearest = cv2.distanceTransformWithLabels(outside, cv2.DIST_C, 3, labelType=cv2.DIST_LABEL_PIXEL)
    region_pixels = np.flatnonzero(number)
    pixel_of_label = np.zeros(int(nearest.max()) + 1, np.int64)
    pixel_of_label[nearest.ravel()[region_pixels]] = region_pixels
    nearest_pixel = pixel_of_label[nearest]
    nearest_colour = image.reshape(-1, 3)[nearest_pixel]
    difference = np.abs(image.astype(np.int16) - nearest_colour.astype(np.int16)).max(axis=2)
    joins = (distance <= _JOIN_DISTANCE * spacing) & (difference <= _JOIN_DIFFERENCE)
    belongs = usable & ((distance <= 1) | joins)  # direct neighbours belong to it in any colour: they are its border
    return np.asarray(np.where(belongs, number.ravel()[nearest_pixel], 0), dtype=np.int32)


def planes_of_regions(regions: Int32s, known: Float32s, spacing: int) -> list[RegionPlane]:
    """Planes that depths in textureless regions define, beginning with the region that has most depths.

    known: (h, w) inverse depths in pixels of a source, nan where there is no reliable one; spacing: as in `textureless_regions`.
    """
    rng = np.random.default_rng(1)
    # 1. Depths in regions, on a coarser grid in large images, sorted by region.
    has_depth = (regions > 0) & np.isfinite(known)
    y, x = (spacing * index for index in np.nonzero(has_depth[::spacing, ::spacing]))
    region = regions[y, x]
    order = np.argsort(region, kind="stable")
    y, x, region = y[order], x[order], region[order]
    points = from_middle(x, y, known.shape)
    d = known[y, x].astype(np.float64)

    # 2. The rows of each region's depths, and the fewest that may still define a plane.
    ends = np.searchsorted(region, np.arange(1, regions.max() + 2))
    free: dict[int, Int64s] = {}
    fewest: dict[int, int] = {}
    for k in range(1, len(ends)):
        rows = np.arange(ends[k - 1], ends[k])
        if len(rows) >= _FEWEST_DEPTHS:
            free[k] = rows
            fewest[k] = max(_FEWEST_DEPTHS, int(_SECOND_SHARE * len(rows)))

    # 3. At most two planes from each region, the one with most depths first; depths on a plane are free no more.
    planes = []
    for seed in sorted(free, key=lambda k: (-len(free[k]), k)):
        for _ in range(2):
            if len(free.get(seed, ())) < fewest[seed]:
                continue
            plane = _grow(points, d, free, seed, rng)
            if plane is None:
                continue
            planes.append(plane)
            for k in plane.regions:
                remaining = free.pop(k)
                remaining = remaining[np.abs(d[remaining] - points[remaining] @ plane.plane) > NEAR_PX]
                if len(remaining) >= fewest[k]:
                    free[k] = remaining
    return planes


def from_middle(x: Int64s, y: Int64s, shape: tuple[int, ...]) -> Float64s:
    """(n, 3): 1, x, y from the middle of an image of this shape."""
    return np.column_stack([np.ones(len(x)), x - shape[1] / 2, y - shape[0] / 2])


def _grow(points: Float64s, d: Float64s, free: dict[int, Int64s], seed: int, rng: np.random.Generator) -> RegionPlane | None:
    """The plane of a region, and of all other regions that lie on it; None if its depths lie on no plane.

    Parameters
    ----------
    points, d : (n, 3) positions (1, x, y) and (n,) inverse depths of all regions.
    free : rows of the depths of each region that are on no plane yet.
    seed : number of the region.
    rng : random numbers for RANSAC.
    """
    rows = free[seed]
    start = _ransac_plane(points[rows], d[rows], rng)
    plane = None
    if start is not None:
        plane = _fit_plane(points[rows], d[rows], start, (seed,))
    # join regions and fit again, until no region joins or leaves
    for _ in range(_ROUNDS):
        if plane is None:
            return None
        members = {seed}
        for k, region_rows in free.items():
            if _lies_on(points[region_rows], d[region_rows], plane):
                members.add(k)
        if members == set(plane.regions):
            break
        rows = np.concatenate([free[k] for k in sorted(members)])
        plane = _fit_plane(points[rows], d[rows], plane.plane, tuple(sorted(members)))
    return plane


def _ransac_plane(points: Float64s, d: Float64s, rng: np.random.Generator) -> Float64s | None:
    """(3,) the best of random planes through three depths each; None if all triples are nearly collinear."""
    triples = rng.integers(0, len(d), (_TRIALS, 3))
    triples = triples[np.abs(np.linalg.det(points[triples])) > 0.02 * len(d)]  # no thin triangles
    if not len(triples):
        return None
    planes = np.linalg.solve(points[triples], d[triples][..., None])[..., 0]
    # MSAC: errors count up to a limit, so that outliers do not decide
    error = np.abs(points @ planes.T - d[:, None])
    best = np.minimum(error, NEAR_PX).sum(axis=0).argmin()
    return np.asarray(planes[best], dtype=np.float64)


def _fit_plane(points: Float64s, d: Float64s, plane: Float64s, regions: tuple[int, ...]) -> RegionPlane | None:
    """Least squares with Tukey's weights, from a first plane; None if too few depths lie near it."""
    inverse = np.eye(3)
    spread = 0.0
    for _ in range(_FITS):
        error = d - points @ plane
        near = np.abs(error) <= NEAR_PX
        if near.sum() < min(_FEWEST_DEPTHS, len(d) / 3):
            return None
        spread = float(1.4826 * np.median(np.abs(error[near])))  # of a normal distribution with this median error
        u = np.clip(error / max(_TUKEY * spread, 1e-3), -1, 1)
        weighted = points * ((1 - u * u) ** 2)[:, None]
        # normal equations by einsum: the sums' order, and so their last bits, do not depend on the BLAS
        normal = np.einsum("ni,nj->ij", weighted, points)
        if np.linalg.matrix_rank(normal) < 3:
            return None
        inverse = np.linalg.inv(normal)
        plane = inverse @ np.einsum("ni,n->i", weighted, d)
    covariance = spread**2 * CORRELATED * inverse
    return RegionPlane(plane, covariance, spread, regions)


def _lies_on(points: Float64s, d: Float64s, plane: RegionPlane) -> bool:
    """Do depths (n,) at positions (n, 3) lie on a plane to within noise?"""
    error = d - points @ plane.plane
    variance = float(plane.variance(points.mean(axis=0)[None])[0])
    noise = np.sqrt(variance + plane.spread**2 * min(1.0, CORRELATED / len(d)))
    is_near = abs(np.median(error)) <= noise + _JOIN_PX
    is_flat = np.median(np.abs(error)) <= 1.2 * plane.spread + _JOIN_PX
    return bool(is_near and is_flat)

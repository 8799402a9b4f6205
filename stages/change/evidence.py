"""Evidence of change at each point of a night's surface, compared with the other night.

A point of tonight is new if it lies in front of the earlier surface by more than the uncertainty of both, or if earlier cameras
saw through its place; an earlier point has vanished by the same rule with the nights swapped.  Where no camera of the other
night could see, the state is unknown.  A place that looks the same to a fixed camera has not changed, whatever the depths.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from ..core.cameras import project
from ..types import Bools, Camera, Cloud, DepthMap, Float32s, Float64s, Frame, Int64s
from .cloud_distance import CONFIDENCE, MeasuredCloud, cloud_distances, count_near, index_points, mean_normals, one_of_each_cell
from .free_space import Sight, look_at
from .ncc import ncc

RADIUS = 3.0
"""Radius of the M3C2 cylinders, in spacings of the cloud: larger ones average more noise, and blur edges."""
REACH = 15.0
"""Half length of these cylinders, in spacings: larger distances are not measured."""
CORE = 2.0
"""Distance of core points, in spacings."""
_UNCHANGED_SHARE = 0.9
"""Share of the surface that is assumed unchanged."""
_NORMAL_SIGMAS = 1.645
"""Standard deviations that hold `_UNCHANGED_SHARE` of normal errors."""
_MOST_NOISE = 3.0
"""Largest factor by which distances may exceed their standard deviations (`noise_of`); if they seem to exceed them by more, the
site has changed as a whole (measured: 1.4 to 1.7 on nights of the demo yard)."""
_LEAST_SHIFT_PX = 2.0
"""Smallest displacement of a surface in the image, in pixels, at which its old place no longer looks the same."""
_NEAR = 4.0
"""Core points closer than this many spacings are neighbours."""
_CACHED_MAPS = 4
"""Smallest number of depth maps of a night that are kept in memory, as each is read several times."""
_CACHED_PX = 6_000_000
"""Pixels up to which more of them are kept."""


@dataclass(frozen=True)
class Evidence:
    """Evidence at the core points of a night; arrays are (n,) unless stated otherwise."""

    core: Float64s
    """(n, 3) core points."""
    normals: Float64s
    """(n, 3) unit normals at the core points."""
    rows: Int64s
    """Indices of the core points in the night's cloud."""
    distance: Float64s
    """Distance from the other night's surface: positive if this one is nearer to the cameras; nan if unknown."""
    sigma: Float64s
    """Standard deviation of `distance`."""
    sight: Sight
    """What the cameras of the other night saw at the core points."""
    measured: Bools
    """True where the distance comes from both clouds, not from cameras that saw through the place."""
    ncc: Float32s
    """Median correlation of both nights' images over the cameras that see the point; nan if not computed, or if no camera shows
    texture there."""
    cleared: Float32s
    """Share of the cameras seeing the point that saw through it on the other night, if they could; nan if not computed."""
    changed: Bools
    """The verdict from all evidence."""

    @property
    def significance(self) -> Float64s:
        """Distance over its standard deviation, 0 if unknown."""
        return np.nan_to_num(self.distance / self.sigma)

    @property
    def unknown(self) -> Bools:
        """True where the other night gives neither a distance nor a camera that saw the surface or through it."""
        return np.asarray(~self.measured & (self.sight.through == 0) & (self.sight.agreeing == 0), dtype=np.bool_)


def compare_nights(tonight: Epoch, reference: Epoch, spacing: float, registration: float) -> tuple[Evidence, Evidence]:
    """Distances and visibility of both nights' surfaces, each compared with the other's; `changed` is still False everywhere.

    Parameters
    ----------
    tonight, reference : the nights.
    spacing : of the points of the coarser cloud.
    registration : standard deviation of the position of one night's world relative to the other's.
    """
    edge = 2.0 * RADIUS * spacing
    cloud = MeasuredCloud(tonight.points, tonight.sigma, index_points(tonight.points, edge))
    reference_cloud = MeasuredCloud(reference.points, reference.sigma, index_points(reference.points, edge))
    evidence_tonight = _evidence_on(tonight, cloud, reference, reference_cloud, spacing, registration)
    evidence_reference = _evidence_on(reference, reference_cloud, tonight, cloud, spacing, registration)
    return evidence_tonight, evidence_reference


def _evidence_on(
    own: Epoch, cloud: MeasuredCloud, other: Epoch, other_cloud: MeasuredCloud, spacing: float, registration: float
) -> Evidence:
    """Evidence on one night's surface from the other night; both clouds are indexed."""
    assert cloud.index is not None
    rows = one_of_each_cell(cloud.points, CORE * spacing)
    core = cloud.points[rows]
    radius = RADIUS * spacing
    reach = REACH * spacing
    normals = mean_normals(core, cloud.index, own.cloud.normals, radius)
    # Normals point to the cameras: a distance from the other cloud to this one is positive if this one is nearer to them.
    distances = cloud_distances(core, normals, other_cloud, cloud, radius=radius, reach=reach, registration=registration)
    sight = look_at(core, cloud.sigma[rows], other.cameras, other.seeing, other.depth)
    missing = np.full(len(core), np.nan, np.float32)  # computed by `mark_changed`
    return Evidence(
        core=core,
        normals=normals,
        rows=rows,
        distance=distances.distance,
        sigma=distances.sigma,
        sight=sight,
        measured=np.isfinite(distances.distance),
        ncc=missing,
        cleared=missing,
        changed=np.zeros(len(core), bool),
    )


def noise_of(*sides: Evidence) -> float:
    """Factor by which distances exceed their standard deviations where nothing has changed; at least 1.

    It comes from the 90th percentile: this share is assumed unchanged, and changed light causes outliers (shadows, façades).
    Where most of the surface has moved (the front of a glacier), this would take the change for noise: hence `_MOST_NOISE`.
    """
    ratios = np.concatenate([side.distance[side.measured] / side.sigma[side.measured] for side in sides])
    if not len(ratios):
        return 1.0
    noise = float(np.quantile(np.abs(ratios), _UNCHANGED_SHARE)) / _NORMAL_SIGMAS
    return float(np.clip(noise, 1.0, _MOST_NOISE))


def mark_changed(
    evidence: Evidence, night: Epoch, other: Epoch, spacing: float, *, noise: float, sigmas: float, similar: float
) -> Evidence:
    """The evidence with its verdict, and the distances, correlations and shares on which that rests.

    Parameters
    ----------
    evidence : evidence on one night's surface.
    night, other : that night, and the other.
    spacing : of the points.
    noise : factor on the standard deviations of distances between clouds.
    sigmas : number of standard deviations from which on a distance is a change.
    similar : correlation above which images show the same surface.
    """
    core = evidence.core
    sight = evidence.sight
    sigma = evidence.sigma * noise

    # 1. Points in front of the other night's surface.
    nearer = evidence.measured & (evidence.distance > sigmas * sigma)
    agrees = evidence.measured & (np.abs(evidence.distance) <= CONFIDENCE * sigma)

    # 2. Points through whose place cameras of the other night saw: two of them, unless only one could tell.
    informative = sight.through.astype(int) + sight.agreeing + sight.hidden
    needed = np.minimum(2, np.maximum(informative, 1))
    free = (sight.through >= needed) & sight.is_free & ~agrees
    with np.errstate(invalid="ignore"):  # the gap is nan where no camera saw through
        free &= sight.gap > sigmas * noise * sight.gap_sigma
    by_sight = free & ~nearer
    distance = np.where(by_sight, sight.gap, evidence.distance)
    sigma = np.where(by_sight, noise * sight.gap_sigma, sigma)
    measured = evidence.measured & ~by_sight
    changed = _with_neighbours(core, nearer | free, spacing)

    # 3. Places that look the same have not changed.
    rows = np.flatnonzero(changed)
    row_sigma = night.sigma[evidence.rows[rows]]
    offset = np.where(measured[rows, None], evidence.distance[rows, None] * evidence.normals[rows], np.nan)
    correlation = np.full(len(core), np.nan, np.float32)
    correlation[rows] = _median_correlation(core[rows], offset, row_sigma, night, other, similar)
    with np.errstate(invalid="ignore"):  # nan is no reason against a change
        changed &= ~(correlation > similar)
    changed = _with_neighbours(core, changed, spacing)

    # 4. For what is left: how many cameras that could look there saw through?
    rows = np.flatnonzero(changed)
    row_sigma = night.sigma[evidence.rows[rows]]
    cleared = np.full(len(core), np.nan, np.float32)
    cleared[rows] = _cleared_share(core[rows], row_sigma, nearer[rows], night, other)
    return replace(evidence, distance=distance, sigma=sigma, measured=measured, ncc=correlation, cleared=cleared, changed=changed)


def _cleared_share(X: Float64s, sigma: Float64s, measured: Bools, own: Epoch, other: Epoch) -> Float32s:
    """(n,) of the cameras that saw points X and could look there on the other night, the share that saw through.

    measured (n,): the distance comes from both clouds, so both nights saw a surface nearby.  There, only cameras that saw
    through count: one that cannot separate the surfaces, or has no depth, is left out; if none is left, the share is 1.

    Elsewhere a camera without depth counts as not having seen through: matching windows on lattices and thin things also show
    what is behind, and each night other cameras confuse the two.
    """
    could_look = np.zeros(len(X), np.float32)
    saw_through = np.zeros(len(X), np.float32)
    usable = set(other.seeing) & set(other.cameras)
    for name in own.seeing:
        if name not in usable:
            continue
        sight = look_at(X, sigma, other.cameras, [name], other.depth)
        cannot_separate = measured & (sight.through == 0)
        can_look = seen_by(X, sigma, own, name) & (sight.hidden == 0) & ~cannot_separate
        could_look += can_look
        saw_through += can_look & (sight.through > 0)
    share = saw_through / np.maximum(could_look, 1)
    none_left = measured & (could_look == 0)
    return np.where(none_left, np.float32(1), share).astype(np.float32)


def seen_by(X: Float64s, sigma: Float64s, epoch: Epoch, name: str) -> Bools:
    """(n,) bool: is a point on the surface that a camera saw?

    Parameters
    ----------
    X, sigma : (n, 3) points and (n,) their standard deviations, metres.
    epoch, name : the night with its cameras and depths, and the camera's id.
    """
    sight = look_at(X, sigma, epoch.cameras, [name], epoch.depth)
    return np.asarray(sight.agreeing > 0)


def _median_correlation(X: Float64s, offset: Float64s, sigma: Float64s, own: Epoch, other: Epoch, similar: float) -> Float32s:
    """(n,) median correlation over the cameras that see a point; nan if none is conclusive.

    offset (n, 3): displacement of the surface between the nights, nan if it is another surface.  If this is hardly a pixel in a
    camera's image, high correlation there is inconclusive: a surface that has moved slightly looks the same.
    """
    shared = [name for name in own.seeing if name in other.cameras and name in own.frames and name in other.frames]
    if not shared or not len(X):
        return np.full(len(X), np.nan, np.float32)
    correlations = np.empty((len(shared), len(X)), np.float32)
    for row, name in zip(correlations, shared, strict=True):
        camera = own.cameras[name]
        seen = seen_by(X, sigma, own, name)
        row[:] = ncc(X, seen, camera, own.frames[name], other.cameras[name], other.frames[name])
        x1, _ = project(camera, X)
        x2, _ = project(camera, X - offset)
        with np.errstate(invalid="ignore"):  # nan: another surface, or nothing to compare
            row[(row > similar) & (np.linalg.norm(x1 - x2, axis=1) < _LEAST_SHIFT_PX)] = np.nan
    # Points with no correlation at all are left out: nanmedian would warn of them.
    known = np.isfinite(correlations).any(axis=0)
    medians = np.full(len(X), np.nan, np.float32)
    medians[known] = np.nanmedian(correlations[:, known], axis=0)
    return medians


def _with_neighbours(core: Float64s, changed: Bools, spacing: float) -> Bools:
    """Changed points that have at least three neighbours and at least half of whose neighbourhood has changed."""
    if not changed.any():
        return changed
    queries = core[changed]
    radius = _NEAR * spacing
    # Each point is its own neighbour, hence "> 3".
    n_near = count_near(queries, index_points(core, radius), radius)
    n_changed = count_near(queries, index_points(queries, radius), radius)
    supported = changed.copy()
    supported[changed] = (2 * n_changed >= n_near) & (n_near > 3)
    return supported


@dataclass(frozen=True)
class Epoch:
    """One night: cloud, cameras, frames and depth maps."""

    cloud: Cloud
    cameras: Mapping[str, Camera]
    """Cameras that share the cloud's world."""
    frames: Mapping[str, Frame]
    """Loaded on access."""
    depths: Mapping[str, DepthMap]
    refined: Mapping[str, DepthMap]
    """Depth maps that replace those of `depths`."""

    @cached_property
    def seeing(self) -> list[str]:
        """The cameras with a depth map."""
        return [name for name in self.cameras if name in self.refined or name in self.depths]

    @cached_property
    def depth(self) -> Callable[[str], DepthMap]:
        """Gives the depth map of a camera by its id, from a cache."""
        largest = max((camera.width * camera.height for camera in self.cameras.values()), default=1)

        @lru_cache(maxsize=max(_CACHED_MAPS, _CACHED_PX // largest))
        def depth_of(name: str) -> DepthMap:
            return self.refined[name] if name in self.refined else self.depths[name]

        return depth_of

    @cached_property
    def points(self) -> Float64s:
        """(n, 3) points of the cloud."""
        return np.asarray(self.cloud.points, dtype=np.float64)

    @cached_property
    def sigma(self) -> Float64s:
        """(n,) standard deviations of the cloud's points, world units."""
        return np.asarray(self.cloud.sigma_mm, dtype=np.float64) / 1000.0

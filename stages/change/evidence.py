"""What speaks for a change at each point of a night's surface, seen from the other night.

A point of tonight is new where it stands before the surface of then by more than both are uncertain, or where cameras of then saw
through its place; a point of then has vanished by the same rule the other way round.  Where no camera of the other night could
see, nothing is known.  What looks the same in the pictures of a fixed camera has not changed, whatever the depths say.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial import cKDTree

from ..core.cameras import project
from ..types import Bools, Camera, Cloud, DepthMap, Float32s, Float64s, Frame, Int64s
from .cloud_distance import CONFIDENCE, MeasuredCloud, cloud_distances, index_points, mean_normals, one_of_each_cell
from .free_space import Sight, look_at
from .ncc import Photograph, ncc

RADIUS, REACH, CORE = 3.0, 15.0, 2.0
"""Of the cylinders, half their length, and the distance of core points, in spacings of the cloud."""
_THROUGH = 2.0
"""So many cameras must see through a point for each that sees a surface there."""
_UNCHANGED, _NORMAL = 0.9, 1.645
"""Share of the surface that is as it was, and how many standard deviations this share of normal errors keeps within."""
_MOST_NOISE = 3.0
"""Distances exceed their standard deviations by no more than this factor; where they seem to, the site has changed as a whole
(nights of the demo yard: 1.4 to 1.7)."""
_APART_PX = 2.0
"""A surface that has moved by so many pixels no longer looks the same at its old place."""
_NEAR = 4.0
"""Core points so many spacings apart are neighbours."""


@dataclass(frozen=True)
class Evidence:
    """Of each core point of a night, (n,) each unless said otherwise."""

    core: Float64s
    """(n, 3)"""
    normals: Float64s
    """(n, 3)"""
    rows: Int64s
    """Places of the core points in the night's cloud."""
    distance: Float64s
    """From the other night's surface: positive where this one is nearer to the cameras; nan where unknown."""
    sigma: Float64s
    """Standard deviation of that."""
    sight: Sight
    """What the cameras of the other night saw there."""
    measured: Bools
    """The distance comes from both clouds, not from a camera that saw through."""
    ncc: Float32s
    """Median over the cameras that see the point of the correlation of both nights' pictures; nan where it was not asked, or they
    show nothing."""
    cleared: Float32s
    """Share of the cameras which saw the point, and could look there on the other night, that saw through it then; nan where it
    was not asked."""
    changed: Bools
    """All evidence together."""

    @property
    def significance(self) -> Float64s:
        """Distance over its standard deviation, 0 where nothing is known."""
        return np.nan_to_num(self.distance / self.sigma)

    @property
    def unknown(self) -> Bools:
        """Nobody could tell on the other night."""
        return np.asarray(~self.measured & (self.sight.through == 0) & (self.sight.agreeing == 0), dtype=np.bool_)


def gather(tonight: Epoch, then: Epoch, spacing: float, registration: float) -> tuple[Evidence, Evidence]:
    """Distances and sights of both nights' surfaces, each compared with the other's; nothing is called changed yet.

    Parameters
    ----------
    tonight, then : the nights.
    spacing : of the points of the coarser cloud.
    registration : standard deviation of the position of one night's world against the other's.
    """
    edge = 2.0 * RADIUS * spacing
    clouds = [MeasuredCloud(night.points, night.sigma, index_points(night.points, edge)) for night in (tonight, then)]
    now = _gathered(tonight, clouds[0], then, clouds[1], spacing, registration)
    return now, _gathered(then, clouds[1], tonight, clouds[0], spacing, registration)


def _gathered(
    own: Epoch, cloud: MeasuredCloud, other: Epoch, other_cloud: MeasuredCloud, spacing: float, registration: float
) -> Evidence:
    """The same of one night's surface; its clouds are indexed."""
    assert cloud.index is not None
    rows = one_of_each_cell(cloud.points, CORE * spacing)
    core = cloud.points[rows]
    radius, reach = RADIUS * spacing, REACH * spacing
    normals = mean_normals(core, cloud.index, own.cloud.normals, radius)
    found = cloud_distances(core, normals, other_cloud, cloud, radius=radius, reach=reach, registration=registration)
    sight = look_at(core, cloud.sigma[rows], other.cameras, other.seeing, other.depth)
    measured = np.isfinite(found.distance)
    nothing, unasked = np.zeros(len(core), bool), np.full(len(core), np.nan, np.float32)
    return Evidence(core, normals, rows, found.distance, found.sigma, sight, measured, unasked, unasked, nothing)


def noise_of(*sides: Evidence) -> float:
    """By how much distances exceed their standard deviations where nothing has changed; at least 1.

    By the 90th percentile: so much of a site is taken to be as it was, and other light errs in the tails (shadows, façades).
    Where most of what is seen has moved (the front of a glacier) that would take the change for noise: hence the most.
    """
    ratios = np.concatenate([side.distance[side.measured] / side.sigma[side.measured] for side in sides])
    noise = float(np.quantile(np.abs(ratios), _UNCHANGED)) / _NORMAL if len(ratios) else 1.0
    return float(np.clip(noise, 1.0, _MOST_NOISE))


def judged(side: Evidence, own: Epoch, other: Epoch, spacing: float, *, noise: float, sigmas: float, alike: float) -> Evidence:
    """The same with what has changed.

    Parameters
    ----------
    side : of one night's surface.
    own, other : that night, and the other.
    spacing : of the points.
    noise : factor on the standard deviations of distances between clouds.
    sigmas : so many standard deviations make a change.
    alike : pictures that correlate better show the same.
    """
    sight, sigma = side.sight, side.sigma * noise
    nearer = side.measured & (side.distance > sigmas * sigma)
    same = side.measured & (np.abs(side.distance) <= CONFIDENCE * sigma)
    informative = sight.through.astype(int) + sight.agreeing + sight.hidden
    needed = np.minimum(2, np.maximum(informative, 1))
    free = (sight.through >= needed) & (sight.through > _THROUGH * sight.agreeing) & ~same
    with np.errstate(invalid="ignore"):
        free &= sight.gap > sigmas * noise * sight.doubt
    by_sight = free & ~nearer
    distance = np.where(by_sight, sight.gap, side.distance)
    sigma = np.where(by_sight, noise * sight.doubt, sigma)
    changed = _with_neighbours(side.core, nearer | free, spacing)
    like = np.full(len(side.core), np.nan, np.float32)
    rows = np.flatnonzero(changed)
    offset = np.where((side.measured & ~by_sight)[rows, None], side.distance[rows, None] * side.normals[rows], np.nan)
    like[rows] = _likeness(side.core[rows], offset, own.sigma[side.rows[rows]], own, other, alike)
    with np.errstate(invalid="ignore"):
        changed &= ~(like > alike)
    changed = _with_neighbours(side.core, changed, spacing)
    cleared, rows = np.full(len(side.core), np.nan, np.float32), np.flatnonzero(changed)
    cleared[rows] = _cleared(side.core[rows], own.sigma[side.rows[rows]], nearer[rows], own, other)
    measured = side.measured & ~by_sight
    return replace(side, distance=distance, sigma=sigma, measured=measured, ncc=like, cleared=cleared, changed=changed)


def _cleared(X: Float64s, sigma: Float64s, measured: Bools, own: Epoch, other: Epoch) -> Float32s:
    """(n,) share of the cameras that saw points X which saw through their places on the other night, of those that could look.

    measured (n,): the clouds say how far the surface lies off, as both nights saw it nearby; there a camera that does not tell
    the two apart, or knows no depth of its own, does not count, and where none is left the share is 1.

    Elsewhere a camera that knows no depth has not seen through: of lattices and other thin things a window shows what is behind,
    too, and each night it is another camera that takes the one for the other.
    """
    saw, through = np.zeros(len(X), np.float32), np.zeros(len(X), np.float32)
    asked = set(other.seeing) & set(other.cameras)
    for name in (n for n in own.seeing if n in asked):
        sight = look_at(X, sigma, other.cameras, [name], other.depth)
        looked = seen_by(X, sigma, own, name) & (sight.hidden == 0) & ~(measured & (sight.through == 0))
        saw += looked
        through += looked & (sight.through > 0)
    return np.where(measured & (saw == 0), np.float32(1), through / np.maximum(saw, 1)).astype(np.float32)


def seen_by(X: Float64s, sigma: Float64s, epoch: Epoch, name: str) -> Bools:
    """(n,) bool: is a point on the surface that a camera saw?

    Parameters
    ----------
    X, sigma : (n, 3) points and (n,) their standard deviations, metres.
    epoch, name : cameras and depths of a night, and the camera.
    """
    sight = look_at(X, sigma, epoch.cameras, [name], epoch.depth)
    return np.asarray(sight.agreeing > 0)


def _likeness(X: Float64s, offset: Float64s, sigma: Float64s, own: Epoch, other: Epoch, alike: float) -> Float32s:
    """(n,) the median over the cameras that see a point; nan where none can tell.

    offset (n, 3): by which the surface is said to have moved, nan where it is another one.  A camera in whose picture that is
    hardly a pixel can't tell what is alike from what has moved a little.
    """
    both = [name for name in own.seeing if name in other.cameras and name in own.frames and name in other.frames]
    if not both or not len(X):
        return np.full(len(X), np.nan, np.float32)
    similarities = np.stack([ncc(X, seen_by(X, sigma, own, n), own.photograph(n), other.photograph(n)) for n in both])
    for row, name in zip(similarities, both, strict=True):
        (here, _), (there, _) = project(own.cameras[name], X), project(own.cameras[name], X - offset)
        with np.errstate(invalid="ignore"):
            row[(row > alike) & (np.linalg.norm(here - there, axis=1) < _APART_PX)] = np.nan
    known = np.isfinite(similarities).any(axis=0)
    found = np.full(len(X), np.nan, np.float32)
    found[known] = np.nanmedian(similarities[:, known], axis=0)
    return found


def _with_neighbours(core: Float64s, changed: Bools, spacing: float) -> Bools:
    """Changed points half of whose neighbours have changed, too."""
    if not changed.any():
        return changed
    asked = core[changed]
    around, like = (cKDTree(of).query_ball_point(asked, _NEAR * spacing, return_length=True) for of in (core, asked))
    found = changed.copy()
    found[changed] = (2 * like >= around) & (around > 3)
    return found


_IN_MEMORY, _IN_MEMORY_PX = 4, 6_000_000
"""Depth maps of a night kept at hand, at least, and more while they are small: each is asked several times."""


@dataclass(frozen=True)
class Epoch:
    """A night."""

    cloud: Cloud
    cameras: Mapping[str, Camera]
    """Those that share the cloud's world."""
    frames: Mapping[str, Frame]
    """Loaded when they are asked for."""
    depths: Mapping[str, DepthMap]
    refined: Mapping[str, DepthMap]
    """Taken instead of `depths` where there is one."""

    @cached_property
    def seeing(self) -> list[str]:
        """The cameras with a depth map."""
        return [name for name in self.cameras if name in self.refined or name in self.depths]

    @cached_property
    def depth(self) -> Callable[[str], DepthMap]:
        """What a camera saw, by its name."""
        largest = max((camera.width * camera.height for camera in self.cameras.values()), default=1)

        @lru_cache(maxsize=max(_IN_MEMORY, _IN_MEMORY_PX // largest))
        def depth_of(name: str) -> DepthMap:
            return self.refined[name] if name in self.refined else self.depths[name]

        return depth_of

    def photograph(self, name: str) -> Photograph:
        """A camera with its frame."""
        return self.cameras[name], self.frames[name]

    @cached_property
    def points(self) -> Float64s:
        """(n, 3) of the cloud."""
        return np.asarray(self.cloud.points, dtype=np.float64)

    @cached_property
    def sigma(self) -> Float64s:
        """(n,) of the cloud's points, world lengths."""
        return np.asarray(self.cloud.sigma_mm, dtype=np.float64) / 1000.0

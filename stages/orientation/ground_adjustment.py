"""Stated poses adjusted within their standard deviations to the ground, where keypoints do not determine them.

On repetitive paving, keypoints match wrong stones, and several such solutions are within the uncertainty of the poses.  For each
plane that may be the ground, patches of one view are searched in the others where this plane and the poses predict them
(`mvs.ground_prior`).  The poses are adjusted to the patches found and to the keypoints that are not below the plane.  The plane
is the ground if large patches then look the same on it, and on no other plane.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..core.cameras import backproject
from ..core.epipolar import triangulate_depth
from ..mvs.ground import count_similar_patches, fit_nearby_plane, halved, likely_planes
from ..mvs.ground_prior import ground_matches
from ..types import Camera, Float32s, Float64s, Geometry, Int64s, Pair
from .pose_check import Sigma
from .pose_prior_adjustment import MIN_MATCHES, AdjustedPoses, adjust_within_priors

_MOST_PLANES = 4
"""Largest number of planes that are examined closely."""
_SAME_HEIGHT = 0.06
"""Planes whose heights differ by at most this share are the same."""
_FINE_REACH_PX = 6.0
"""Search radius for patches once the poses have been adjusted roughly, pixels."""
_REACH_SIGMAS = 2.0
"""Search radius for patches under the stated poses, in standard deviations of the pixels."""
_WIDEST_REACH_PX = 24.0
"""Limit of this radius, pixels: the wider the search, the fewer patches have no look-alike within it."""
_REACH_HEIGHTS = 4.0
"""Distance of the patches for this radius, in heights of the camera above the plane."""
_BELOW_SHARE = 0.1
"""Matches farther below the plane than this share of the camera's height above it are look-alikes."""
_ROUGH_MATCHES = 80
"""Largest number of matches of a pair in the rough adjustment."""
_FINE_MATCHES = 200
"""Largest number of matches of a pair in the fine adjustment, of each kind."""
_FEWEST_PATCHES = 12
"""Fewest large patches that must look the same on the ground."""
_LEAST_RATIO = 1.5
"""Smallest ratio of large patches that look the same on the ground to those on any other plane, for more than two views."""
_LEAST_RATIO_FOR_TWO = 3.0
"""The same for two views, in which chance agreement is likelier."""


@dataclass(frozen=True)
class _Fit:
    """Cameras adjusted to a plane."""

    adjusted: AdjustedPoses
    plane: Float64s
    share: float
    """Share of the patches that look alike on the plane."""


def adjust_to_ground(
    images: Mapping[str, Float32s], known: Mapping[str, Camera], sigmas: Mapping[str, Sigma], pairs: Mapping[Pair, Geometry]
) -> AdjustedPoses | None:
    """The cameras adjusted to the ground; None if no plane stands out.

    Parameters
    ----------
    images : (h, w) float32 grey frame of each camera.
    known, sigmas : the same cameras as stated, and their standard deviations.
    pairs : pairs of these cameras, with their keypoint matches.
    """
    site = _Site({name: images[name] for name in known if name in images}, known, sigmas, pairs)

    # 1. Adjust roughly to each plane that may be the ground, in images of half size.
    rough_fits = []
    for plane in _planes(site):
        matches = site.matches(known, plane, 1, _ROUGH_MATCHES)
        if matches:
            rough_fits.append(_fit_to(site, matches, plane))

    # 2. Adjust finely to the best of them; some may have become the same plane.
    rough_fits.sort(key=lambda fit: -fit.share)
    distinct: list[_Fit] = []
    for fit in rough_fits:
        if _is_apart(fit.plane, [earlier.plane for earlier in distinct], known, _SAME_HEIGHT):
            distinct.append(fit)
    fits = [_fit_finely(site, fit) for fit in distinct[:_MOST_PLANES]]
    if not fits:
        return None

    # 3. Does one plane stand out, by the large patches that look the same on it?
    counts = [count_similar_patches(site.views(fit.adjusted.cameras, 2), fit.plane) for fit in fits]
    best, *other_counts = sorted(counts, reverse=True)
    least_ratio = _LEAST_RATIO if len(site.images) > 2 else _LEAST_RATIO_FOR_TWO
    if best < max(_FEWEST_PATCHES, least_ratio * max(other_counts, default=0)):
        return None
    return fits[counts.index(best)].adjusted


@dataclass(frozen=True)
class _Site:
    """What `adjust_to_ground` knows."""

    images: Mapping[str, Float32s]
    known: Mapping[str, Camera]
    sigmas: Mapping[str, Sigma]
    pairs: Mapping[Pair, Geometry]

    def views(self, cameras: Mapping[str, Camera], times: int) -> list[tuple[Float32s, Camera]]:
        """Images and cameras, halved `times` times."""
        halved_views = [(image, cameras[name]) for name, image in self.images.items()]
        for _ in range(times):
            halved_views = [halved(*view) for view in halved_views]
        return halved_views

    def matches(
        self, cameras: Mapping[str, Camera], plane: Float64s, times: int, most: int, reach_px: float | None = None
    ) -> dict[Pair, Geometry]:
        """Matches of the pairs on a plane, in images halved `times` times; reach_px: search radius, None to use the sigmas."""
        views = dict(zip(self.images, self.views(cameras, times), strict=True))
        matched = {}
        for pair, geometry in self.pairs.items():
            if not set(pair) <= set(views):
                continue
            image1, camera1 = views[pair[0]]
            image2, camera2 = views[pair[1]]
            reach = reach_px or self._reach_px(pair, plane)
            x1, x2 = ground_matches((image1, image2), (camera1, camera2), plane, reach / 2**times)
            rows = _thinned_rows(len(x1), most)
            if len(rows) >= MIN_MATCHES:
                # Back to pixels of the full image: centres of pixels have integer coordinates.
                centre = 0.5 * (2**times - 1)
                matched[pair] = _with_matches(geometry, 2.0**times * x1[rows] + centre, 2.0**times * x2[rows] + centre)
        return matched

    def _reach_px(self, pair: Pair, plane: Float64s) -> float:
        """Search radius in pixels for patches of a plane, at some distance from the cameras (`_REACH_HEIGHTS`)."""
        # Errors of both cameras move the patch.
        variance = 0.0
        for name in pair:
            camera = self.known[name]
            sigma = self.sigmas.get(name, Sigma())
            distance = _REACH_HEIGHTS * abs(float(plane[:3] @ camera.C + plane[3]))
            variance += sigma.pixels(camera, distance) ** 2
        return min(_REACH_SIGMAS * float(np.sqrt(variance)), _WIDEST_REACH_PX)


def _planes(site: _Site) -> list[Float64s]:
    """Planes that may be the ground: those on which, in small images, the stated poses are right to a pixel or two."""
    planes: list[Float64s] = []
    # The smaller the images, the larger the errors of poses at which patches still agree.
    for times in (1, 2):
        for plane in likely_planes(site.views(site.known, times)):
            if _is_apart(plane, planes, site.known, 0.5 * _SAME_HEIGHT):
                planes.append(plane)
    return planes


def _is_apart(plane: Float64s, others: list[Float64s], cameras: Mapping[str, Camera], share: float) -> bool:
    """Is a plane higher or lower than all others, by more than a share of the height of the lowest camera above it?"""
    # Heights are compared below the middle of the cameras: planes that differ only in tilt there are the same.
    height = min(float(plane[:3] @ camera.C + plane[3]) for camera in cameras.values())
    centre = np.mean([camera.C for camera in cameras.values()], axis=0)
    differences = [abs(float((plane[:3] - other[:3]) @ centre + plane[3] - other[3])) for other in others]
    return all(difference / max(height, 1e-9) > share for difference in differences)


def _fit_finely(site: _Site, fit: _Fit) -> _Fit:
    """The cameras adjusted to patches of the full images, and to the keypoints that are not below the plane."""
    cameras = fit.adjusted.cameras
    patches = site.matches(cameras, fit.plane, 0, _FINE_MATCHES, _FINE_REACH_PX)
    combined: dict[Pair, Geometry] = {}
    for pair, geometry in site.pairs.items():
        # Keypoints tie the cameras to things above the ground, patches to the ground.
        x1, x2 = _not_below(geometry, cameras[pair[0]], cameras[pair[1]], fit.plane)
        if pair in patches:
            x1 = np.concatenate([x1, patches[pair].x1])
            x2 = np.concatenate([x2, patches[pair].x2])
        if len(x1):
            combined[pair] = _with_matches(geometry, x1, x2)
    return _fit_to(site, combined, fit.plane)


def _fit_to(site: _Site, matches: Mapping[Pair, Geometry], plane: Float64s) -> _Fit:
    """The cameras adjusted to matches on a plane, and the plane near it on which most patches then look alike."""
    adjusted = adjust_within_priors(site.known, site.sigmas, matches, trusted=True)
    share, nearby_plane = fit_nearby_plane(site.views(adjusted.cameras, 1), plane)
    return _Fit(adjusted, nearby_plane, share)


def _not_below(geometry: Geometry, left: Camera, right: Camera, plane: Float64s) -> tuple[Float64s, Float64s]:
    """A sample of the matches of a pair that are not below a plane."""
    depth, _ = triangulate_depth(left, right, geometry.x1, geometry.x2)
    height = backproject(left, geometry.x1, depth) @ plane[:3] + plane[3]
    camera_height = plane[:3] @ left.C + plane[3]
    above = height > -_BELOW_SHARE * camera_height
    rows = np.flatnonzero(above & (depth > 0))
    rows = rows[_thinned_rows(len(rows), _FINE_MATCHES)]
    return geometry.x1[rows], geometry.x2[rows]


def _thinned_rows(count: int, limit: int) -> Int64s:
    """At most `limit` rows of `count`, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(limit, count)).astype(np.int64))


def _with_matches(geometry: Geometry, x1: Float64s, x2: Float64s) -> Geometry:
    """The geometry with other matches, which count as certain."""
    certain = np.ones(len(x1), dtype=np.float32)
    return replace(geometry, x1=x1, x2=x2, i1=None, i2=None, probability=certain, good_probability=1.0)

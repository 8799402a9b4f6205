"""Disparities of all pairs become one coloured point cloud.

Three passes over the views, one view in hand at a time: depth of each view from all its pairs (`fusion.depth`); what other views
say about it (`fusion.crosscheck`); points that survive, merged on a grid (`fusion.voxels`).  No threshold is a length: all follow
from the pixel's footprint and the depth's propagated error, so a desk and a quarry are treated alike.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .epipolar import backproject
from .fusion.crosscheck import Verdict, cross_check, nearest_views
from .fusion.depth import NoiseModel, fuse_pairs, pair_depth, world_normals
from .fusion.exposure import exposure_gains, thumbnail
from .fusion.voxels import Samples, VoxelGrid
from .rectification.mapping import Side
from .types import Camera, Cloud, DepthMap, Disparity, Float32s, Float64s, Frame, Pair, Rectification, Rejected


def fuse(
    frames: Mapping[str, Frame],
    cameras: Mapping[str, Camera],
    rectifications: Mapping[Pair, Rectification],
    disparities: Mapping[Pair, Disparity],
    refined: Mapping[str, DepthMap] | None = None,
    *,
    component: int = 0,
    strict: int = 1,
    voxel_m: float | None = None,
    noise_px: float = 0.35,
    neighbours: int = 6,
    check_views: int = 16,
) -> Cloud | Rejected:
    """Fuse the disparities of all pairs into one cloud.

    Parameters
    ----------
    frames, cameras
        Of each view; frames are looked at one at a time.
    rectifications, disparities
        Of each pair both of whose cameras are in `cameras`; looked at one at a time.
    refined
        Depth of views refined over all views around them: taken for these instead of their pairs' disparities.
    component
        Only cameras of this component: those that share a world.
    strict
        A point needs so many pairs that agree on it and, from 2 on, so many other views whose depth is the same: 2 trades
        completeness for accuracy.
    voxel_m
        Edge of the voxels in which points are merged, in metres; None: what a pixel covers, or one and a half sigmas of depth.
    noise_px
        Assumed error of a disparity in pixels, standard deviation.
    neighbours
        A point needs so many others within three voxels.
    check_views
        Each view is compared with so many others that see most of the same.
    """
    noise = NoiseModel(noise_px=noise_px)
    cameras = {name: camera for name, camera in cameras.items() if camera.component == component}
    depths: dict[str, DepthMap] = {}
    for name in cameras:
        depth = (refined or {}).get(name) or view_depth(name, cameras, rectifications, disparities, noise)
        if depth is not None:
            depths[name] = depth
    if not any(np.isfinite(depth.depth).any() for depth in depths.values()):
        return Rejected("no pair gave any depth", {"cameras": float(len(cameras)), "pairs": float(len(disparities))})
    near = {name: nearest_views(name, cameras, depths, check_views) for name in depths}
    gains = exposure_gains(cameras, depths, {name: thumbnail(frames[name].image) for name in depths}, near)
    edge = voxel_m or _natural_voxel(cameras, depths)
    centre = np.mean([cameras[name].C for name in depths], axis=0)
    grid = VoxelGrid(edge, edge * np.round(centre / edge))  # a multiple: the same cells whichever cameras took part
    for name, depth in depths.items():
        verdict = cross_check(name, near[name], cameras, depths)
        grid.add(_samples(frames[name], cameras[name], depth, verdict, gains[name], strict))
    merged = grid.merged(neighbours)
    if not len(merged.points):
        return Rejected(f"no point is supported by {strict} pairs and {neighbours} neighbours", {"cameras": float(len(depths))})
    return _cloud(merged)


def view_depth(
    name: str,
    cameras: Mapping[str, Camera],
    rectifications: Mapping[Pair, Rectification],
    disparities: Mapping[Pair, Disparity],
    noise: NoiseModel,
) -> DepthMap | None:
    """Depth of one view from all its pairs, or None when it has none."""
    depths, gains, partners = [], [], []
    for pair in disparities:
        if name not in pair or not (pair[0] in cameras and pair[1] in cameras) or pair not in rectifications:
            continue
        side: Side = 1 if pair[0] == name else 2
        other = pair[2 - side]
        depth, gain = pair_depth(cameras[name], cameras[other], rectifications[pair], disparities[pair], side)
        depths.append(depth)
        gains.append(gain)
        partners.append(other)
    return fuse_pairs(cameras[name], depths, gains, partners, noise) if depths else None


def _natural_voxel(cameras: Mapping[str, Camera], depths: Mapping[str, DepthMap]) -> float:
    """What a pixel covers, or one and a half sigmas if that is more, in the median over all views: finer voxels hold only noise.

    Rounded down to a preferred number, so that the grid stays the same when cameras fail or surfaces change from night to night.
    """
    cells = slice(4, None, 8), slice(4, None, 8)
    edges = [np.fmax(d.depth[cells] / cameras[name].K[0, 0], 1.5 * d.sigma[cells]).ravel() for name, d in depths.items()]
    median = float(np.nanmedian(np.concatenate(edges)))
    decade = 10.0 ** np.floor(np.log10(median))
    return float(decade * max(step for step in _PREFERRED if step <= max(median / decade, 1.0)))


_PREFERRED = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.3, 8.0)
"""Renard's series R10: ten steps to a decade."""


def _samples(frame: Frame, camera: Camera, depth: DepthMap, verdict: Verdict, gains: Float64s, strict: int) -> Samples:
    """The points of one view that its own and the other views' evidence leaves standing.

    A quarter of the views that could see a point, this one included, must have it; and twice as many as look through it.
    """
    supported = frame.mask & (depth.sure | (verdict.agreeing > 0))
    if strict > 1:
        supported &= verdict.agreeing >= strict
    supported &= (verdict.pairs >= strict) & (4 * (verdict.agreeing + 1.0) >= verdict.visible + 1.0)
    y, x = np.nonzero(np.isfinite(depth.depth) & supported & (2 * verdict.violating <= verdict.agreeing))
    z, sigma = depth.depth[y, x].astype(np.float64), depth.sigma[y, x].astype(np.float64)
    return Samples(
        backproject(camera, np.column_stack([x, y]).astype(np.float64), z),
        world_normals(camera, depth, y, x).astype(np.float32),
        (frame.image[y, x] * gains).clip(0, 255).astype(np.float32),
        (1.0 / sigma**2).astype(np.float32),
        _confidence(verdict, depth, y, x),
        verdict.cameras[y, x].astype(np.float32),
        (z / camera.K[0, 0]).astype(np.float32),
    )


def _confidence(verdict: Verdict, depth: DepthMap, y: np.ndarray, x: np.ndarray) -> Float32s:
    """0 to 1: each further pair halves the doubt; views that look through the point add to it."""
    confidence = (1.0 - 0.5 ** verdict.pairs[y, x]) * 0.6 ** verdict.violating[y, x]
    return np.asarray(confidence, dtype=np.float32)


def _cloud(merged: Samples) -> Cloud:
    return Cloud(
        merged.points,
        merged.normals,
        (merged.colors + 0.5).clip(0, 255).astype(np.uint8),
        merged.confidence,
        merged.cameras.astype(np.uint16),
        (1000.0 / np.sqrt(merged.weight)).astype(np.float32),
    )

"""Depths of all views become one coloured point cloud.

Three steps, with few views in memory at a time: views are subsampled (`fusion.planning`) to choose the views to compare,
exposure gains and the voxel size; each depth is compared with those of other views (`fusion.visibility`) and gets a
probability (`fusion.posterior`); probable points are merged on a grid (`fusion.voxels`).  No threshold is a length: all follow
from a pixel's footprint and the propagated error of depth, so a desk and a quarry are treated the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import lru_cache, partial
from threading import Lock
from typing import Any

import numpy as np

from .contracts.reasons import Reason, Rejected
from .core.cameras import backproject
from .core.parallel import parallel_map
from .core.residual_distortion import undistorted_frames
from .fusion.even_regions import usable_pixels
from .fusion.pair_depth import world_normals
from .fusion.planning import exposure_gains, natural_voxel, nearest_views, subsample
from .fusion.posterior import merge_likelier, most_probable, own_logit, posterior
from .fusion.uncertainty import along_nearest_rays, depth_variance
from .fusion.visibility import CrossCheck, TrustedDepth, cross_check
from .fusion.voxels import Samples, VoxelGrid, VoxelSums
from .types import Camera, Cloud, DepthMap, Float32s, Float64s, Frame

_IN_MEMORY = 8
"""Least number of depth maps in memory: successive views are compared with mostly the same ones."""

_IN_MEMORY_PX = 12_000_000
"""Pixels of depth maps up to which more are kept in memory."""


def fuse(
    frames: Mapping[str, Frame],
    cameras: Mapping[str, Camera],
    depths: Mapping[str, DepthMap],
    refined: Mapping[str, DepthMap] | None = None,
    *,
    component: int = 0,
    min_consistent_pairs: int = 1,
    voxel_m: float | None = None,
    confidence: float = 0.6,
    correct_share: float = 0.95,
    check_views: int = 16,
) -> Cloud | Rejected:
    """Fuse the depths of all views into one cloud.

    Parameters
    ----------
    frames, cameras : frames and cameras of the views; frames are loaded one at a time.
    depths : depth maps of the views from their pairs; loaded when needed.
    refined : depth maps refined over all surrounding views; used instead of `depths`, except where they are improbable.
    component : use only cameras of this component (those that share a world).
    min_consistent_pairs : smallest number of pairs that agree on a point and, from 2 on, of other views with the same depth; 2
        trades completeness for accuracy.
    voxel_m : edge of the voxels in which points are merged, in metres; None: the footprint of a pixel.
    confidence : smallest probability that a point is right; higher values trade completeness for accuracy.
    correct_share : share of the points that is expected to be right, by their probabilities: the least probable are left out
        until it is reached, but never more than half.  The true share is 0.91 to 1 on twelve scenes and two sets of photographs
        as they are, and 0.86 to 0.94 behind webs and railings.
    check_views : number of other views that each view is compared with: those that share most with it.
    """
    preferred = refined or {}
    frames = undistorted_frames(frames, cameras)
    with_depth = {*depths, *preferred}
    cameras = {name: one for name, one in cameras.items() if one.component == component and name in with_depth}
    view_of, forget_views = _loader(frames, cameras, depths, preferred)

    # 1. From subsampled depths: which views to compare, exposure gains, the size of voxels.
    subsampled_views = parallel_map(lambda name: subsample(frames[name], view_of(name).depth), cameras)
    subsampled = dict(zip(cameras, subsampled_views, strict=True))
    if not any(np.isfinite(view.depth).any() for view in subsampled.values()):
        return Rejected(Reason.NO_DEPTH, {"cameras": float(len(cameras))})
    neighbours = {name: nearest_views(name, cameras, subsampled, check_views) for name in cameras}
    gains = exposure_gains(cameras, subsampled, neighbours)
    grid = _empty_grid(cameras, voxel_m or natural_voxel(cameras, subsampled))

    def voxels_of(grid: VoxelGrid, name: str) -> tuple[Float32s, VoxelSums]:
        """Squared misfits (n,) of a view's points that are probable enough, and their sums by voxel."""
        view = view_of(name)
        check = cross_check(name, neighbours[name], cameras, view_of)
        probability = _accepted(posterior(view, check), check, confidence, min_consistent_pairs)
        other_cameras = [cameras[other] for other in neighbours[name]]
        samples = _samples(view, cameras[name], check, other_cameras, gains[name], probability)
        return samples.variance * samples.weight, grid.sums_of(samples)

    # 2. Check each view against its neighbours, in parallel; add the results in the order of the views, on which sums depend.
    sample_counts: dict[str, int] = {}
    misfits: dict[str, float] = {}
    for name, (squared_misfits, sums) in zip(cameras, parallel_map(partial(voxels_of, grid), cameras), strict=True):
        sample_counts[name] = len(squared_misfits)
        if len(squared_misfits):
            misfits[name] = float(np.sqrt(np.median(squared_misfits)))
        grid.add(sums)
    forget_views()

    # 3. One point for each voxel; the grid's memory is freed before the parts are joined.
    parts = [_cloud(samples) for samples in grid.merged()]
    del grid
    if not parts:
        return Rejected(Reason.NO_SUPPORTED_POINT, {"cameras": len(cameras), "min_consistent_pairs": min_consistent_pairs})
    return _join(parts, sample_counts, misfits, correct_share)


def _loader(
    frames: Mapping[str, Frame], cameras: Mapping[str, Camera], depths: Mapping[str, DepthMap], preferred: Mapping[str, DepthMap]
) -> tuple[Callable[[str], TrustedDepth], Callable[[], None]]:
    """A function that loads the depth of a view and keeps the last few in memory, and one that forgets these."""
    largest = max((camera.width * camera.height for camera in cameras.values()), default=1)

    @lru_cache(max(_IN_MEMORY, _IN_MEMORY_PX // largest))
    def load_view(name: str) -> TrustedDepth:
        maps = [source[name] for source in (preferred, depths) if name in source]  # the pairs' depth, if any, comes last
        frame = frames[name]
        usable = usable_pixels(frame, maps[-1])  # judged by the pairs' depth: refinement fits planes to the sky, too
        return merge_likelier([TrustedDepth(frame, depth, own_logit(depth, usable)) for depth in maps])

    loading = Lock()  # otherwise two threads that need the same view would both load it

    def view_of(name: str) -> TrustedDepth:
        with loading:
            return load_view(name)

    return view_of, load_view.cache_clear


def _empty_grid(cameras: Mapping[str, Camera], edge: float) -> VoxelGrid:
    """A grid around the cameras.  Its origin is a multiple of the edge: cells don't depend on the cameras that took part."""
    centre = np.mean([camera.C for camera in cameras.values()], axis=0)
    return VoxelGrid(edge, edge * np.round(centre / edge))


def _accepted(probability: Float32s, check: CrossCheck, confidence: float, min_consistent_pairs: int) -> Float32s:
    """(h, w) probability of the depths that are probable enough and confirmed by enough pairs and views; 0 for the others."""
    accepted = (probability >= confidence) & (check.pairs >= min_consistent_pairs)
    if min_consistent_pairs > 1:
        accepted &= check.agreeing >= min_consistent_pairs
    return np.where(accepted, probability, np.float32(0))


def _samples(
    view: TrustedDepth,
    camera: Camera,
    check: CrossCheck,
    other_cameras: Sequence[Camera],
    gains: Float64s,
    probability: Float32s,
) -> Samples:
    """The points of one view.

    Parameters
    ----------
    view, camera, check : the view's depth, its camera, and its cross-check against the other views.
    other_cameras : of the other views, in the order of `CrossCheck.nearest`.
    gains : (3,) exposure gains of the view's colours.
    probability : (h, w) probability that its depths are right, 0 where they are not used.
    """
    frame = view.frame
    depth = view.depth
    y, x = np.nonzero(probability)
    z = depth.depth[y, x].astype(np.float64)
    sigma = depth.sigma[y, x].astype(np.float64)
    points = backproject(camera, np.column_stack([x, y]).astype(np.float64), z)
    normals = world_normals(camera, depth, y, x)
    variance = depth_variance(depth, check, y, x)
    other_centres = np.array([other.C for other in other_cameras]).reshape(-1, 3)
    ray_variance = along_nearest_rays(variance, camera, other_centres, check.nearest[y, x], points, normals)
    return Samples(
        points=points,
        normals=normals.astype(np.float32),
        colors=(frame.image[y, x] * gains).clip(0, 255).astype(np.float32),
        weight=(1.0 / sigma**2).astype(np.float32),
        confidence=probability[y, x],
        cameras=check.cameras[y, x].astype(np.float32),
        footprint=(z / camera.K[0, 0]).astype(np.float32),
        variance=ray_variance.astype(np.float32),
    )


def _cloud(merged: Samples) -> Cloud:
    """Merged samples as points of a cloud, in its units and types."""
    return Cloud(
        points=merged.points,
        normals=merged.normals,
        colors=(merged.colors + 0.5).clip(0, 255).astype(np.uint8),
        confidence=merged.confidence,
        views=merged.cameras.astype(np.uint16),
        sigma_mm=(1000.0 * np.sqrt(merged.variance)).astype(np.float32),
    )


def _join(parts: Sequence[Cloud], sample_counts: dict[str, int], misfits: dict[str, float], correct_share: float) -> Cloud:
    """The most probable points of a cloud given in parts; sample_counts, misfits: see `Cloud`; correct_share: see `fuse`."""
    # 1. Concatenate all arrays, whichever a cloud has.
    arrays: dict[str, Any] = {}
    for field in fields(Cloud):
        if field.name not in ("sample_counts", "misfits", "correct_share"):
            arrays[field.name] = np.concatenate([getattr(part, field.name) for part in parts])

    # 2. Keep the probable points; the mean confidence of these is the share that is expected to be right.
    rows = most_probable(arrays["confidence"], correct_share)
    expected = round(float(arrays["confidence"][rows].mean(dtype=np.float64)), 4)
    kept = {name: values[rows] for name, values in arrays.items()}
    return Cloud(**kept, sample_counts=sample_counts, misfits=misfits, correct_share=expected)

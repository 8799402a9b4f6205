"""Depth of one view refined against all views around it at once: the second pass, after the pairs.

Planes start from the pairs' depth and are improved by the photo-consistency of several photographs (`mvs.propagation`): this
finds matches that no single pair could keep, fills holes from their rims and from other views' depth, and lets depth follow
the view that shows a surface best.  Planes are then moved to where all sources together fit best
(`mvs.photometric_refinement`), and filtered by their neighbours, as those of a pair are: a plane that is cheapest of many
trials by chance is outvoted.  A second move restores detail that the filter has smoothed.  Even surfaces are fitted by planes
over many pixels (`mvs.plane_prior`).

References
----------
Bleyer, Rhemann, Rother, PatchMatch Stereo, BMVC 2011; Galliani, Lasinger, Schindler, Massively Parallel Multiview Stereopsis
by Surface Normal Diffusion, ICCV 2015.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from .contracts.reasons import Reason, Rejected
from .core.cameras import backproject, project, ray_angles, scaled_intrinsics, transfer
from .core.luminance import luminance
from .core.residual_distortion import undistorted_frame, undistorted_frames
from .fusion.pair_depth import NoiseModel
from .mvs.plane_prior import PlanePriors, apply_plane_priors
from .mvs.propagation import Propagation
from .mvs.transferred import transferred_planes, with_transferred
from .stereo.plane_filter import smoothed
from .types import MOST_PARTNERS, Bools, Camera, DepthMap, Float32s, Float64s, Frame, Int32s, Uint8s

_SURE_SECOND_COST = 0.3
"""Cost of the second best source below which a depth is sure, even if no pair had one."""

_SURE_FIRST_COST = 0.05
"""Cost of the best source below which a depth is sure, even if no other source shows it."""

_FEWEST, _WIDE_DEG = 2, 80.0
"""If fewer than `_FEWEST` views see the scene from within the angle limits, views up to `_WIDE_DEG` degrees aside are added."""

_MOST_FINENESS = 2.0
"""Views that see the surface finer than this view by more than this factor are reduced to its resolution."""

_SAME_SIGMAS, _SAME_SHARE = 3.0, 0.002
"""Two depths count as equal if they differ by at most this many sigmas plus this share of the depth."""


def refine(
    frame: Frame,
    camera: Camera,
    depth: DepthMap,
    frames: Mapping[str, Frame],
    cameras: Mapping[str, Camera],
    reference_camera: Camera | None = None,
    reference_depth: DepthMap | None = None,
    depths: Mapping[str, DepthMap] | None = None,
    *,
    radius: int = 3,
    sweeps: int = 3,
    max_sources: int = 6,
    min_angle_deg: float = 4.0,
    max_angle_deg: float = 65.0,
    max_cost: float = 0.4,
    noise_px: float = 0.35,
) -> DepthMap | Rejected:
    """Refine the depth of one view.

    Parameters
    ----------
    frame, camera, depth : of the view itself; refinement starts from its depth.
    frames, cameras : of the views around it, by id; views without a camera in the same world are ignored.
    reference_camera, reference_depth : the reference's, if there is one: the start where tonight's pairs have no depth,
        provided that the camera has not moved.
    depths : of the views around it, from their pairs: the start where this view has no depth and its photographs agree.
    radius : radius of the compared patch in pixels of an image 768 wide; it grows with larger images.
    sweeps : passes over the image, alternately down and up.
    max_sources : most views to compare with, the nearest in angle first.
    min_angle_deg, max_angle_deg : range of angles to this view at which others are used; if fewer than two are in it, up to 80.
    max_cost : keep planes whose best source correlates better than 1 - max_cost.
    noise_px : assumed error of a match, pixels, standard deviation.
    """
    frame, frames = undistorted_frame(frame, camera), undistorted_frames(frames, cameras)
    others = {name: cameras[name] for name in frames if name in cameras}
    y, x = np.nonzero(np.isfinite(depth.depth[::8, ::8]))
    z = depth.depth[::8, ::8][y, x].astype(np.float64)
    surface = backproject(camera, np.column_stack([8.0 * x, 8.0 * y]), z)
    names = _sources(camera, others, surface, min_angle_deg, max_angle_deg)[: min(max_sources, MOST_PARTNERS)]
    if not names:
        return Rejected(Reason.NO_USEFUL_ANGLE, {"views": len(frames)})
    if not _is_unmoved(camera, reference_camera, depth, reference_depth):
        reference_depth = None
    transferred = transferred_planes(camera, others, depths or {})
    views = {name: _reduced(frames[name].image, others[name], _fineness(camera, others[name], surface, z)) for name in names}
    return _refined(frame, camera, depth, reference_depth, transferred, views, radius, sweeps, max_cost, noise_px)


def _refined(
    frame: Frame, camera: Camera, depth: DepthMap, reference: DepthMap | None, transferred: Float32s,
    views: Mapping[str, tuple[Uint8s, Camera]], radius: int, sweeps: int, max_cost: float, noise_px: float,
) -> DepthMap:  # fmt: skip
    """Depth from all of these views at once, started from tonight's depth, else the reference's, else other views'."""
    image, sources = luminance(frame.image), _stack([luminance(picture) for picture, _ in views.values()])
    M, b = (np.stack(part) for part in zip(*(transfer(camera, other) for _, other in views.values()), strict=True))
    spacing = max(1, round(max(image.shape) / 768))
    ring_px = max(2, round(5 * max(image.shape) / 768))
    propagation = Propagation(image, frame.mask, sources, M, b, spacing * _patch_offsets(radius))
    planes = _planes_of(depth)
    if reference is not None:
        planes = np.where(np.isfinite(planes[0]), planes, _planes_of(reference))
    planes = with_transferred(planes, transferred, propagation, max_cost)
    nearest, farthest = np.percentile(planes[0][np.isfinite(planes[0])], [99.8, 0.2])
    cost = propagation.improve(planes, sweeps, ring_px, 0.9 * farthest, 1.1 * nearest, nearly_right=reference is not None)
    scale = _pixels_per_inverse_depth(M, b, planes[0])
    propagation.refine_photometrically(planes, radius)
    planes[0] = smoothed(image, scale * planes, cost, max_cost, spacing)[0] / scale
    propagation.refine_photometrically(planes, radius)
    support = propagation.support(planes, max_cost)
    accepted = frame.mask & (support.first < max_cost)
    depth64 = 1.0 / np.where(accepted, planes[0], np.float32(np.nan)).astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = depth64 * np.sqrt((noise_px * depth64) ** 2 / support.parallax + NoiseModel.floor**2)
    z, sigma = depth64.astype(np.float32), error.astype(np.float32)
    sure = _agrees_with(z, sigma, depth) | (support.second < _SURE_SECOND_COST) | (support.first < _SURE_FIRST_COST)
    if reference is not None:
        sure |= (support.second < max_cost) & reference.sure & _agrees_with(z, sigma, reference)
    rough = DepthMap(z, sigma, planes[1], planes[2], support.sources, tuple(views), accepted & sure)
    return _flattened(rough, planes[0], apply_plane_priors(frame, propagation, planes, support, rough.sure, scale, max_cost))


def _planes_of(depth: DepthMap) -> Float32s:
    """(3, h, w): inverse depth, and how it changes per pixel in x and y; nan where unknown."""
    return np.stack([1.0 / depth.depth, depth.slope_x, depth.slope_y])


def _is_unmoved(camera: Camera, reference: Camera | None, depth: DepthMap, reference_depth: DepthMap | None) -> bool:
    """Has the camera not moved since the reference, so that each pixel shows the same place?"""
    if reference is None or reference_depth is None or depth.depth.shape != reference_depth.depth.shape:
        return False
    return all(np.array_equal(a, b) for a, b in ((camera.K, reference.K), (camera.R, reference.R), (camera.C, reference.C)))


def _agrees_with(z: Float32s, sigma: Float32s, other: DepthMap) -> Bools:
    """(h, w) bool: the depth equals that of another map: the pairs', cross-checked between two views, or the reference's."""
    return np.asarray(np.abs(other.depth - z) <= _SAME_SIGMAS * sigma + _SAME_SHARE * z)


def _flattened(rough: DepthMap, q: Float32s, prior: PlanePriors) -> DepthMap:
    """Depth with even surfaces on their planes, and without depths found by chance.  q: (h, w) inverse depths."""
    flat, nan = np.isfinite(prior.sigma), np.float32(np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(flat, 1.0 / q, np.where(prior.chance, nan, rough.depth))
    sigma = np.where(flat, z * np.hypot(z * prior.sigma, np.float32(NoiseModel.floor)), np.where(prior.chance, nan, rough.sigma))
    return replace(rough, depth=z, sigma=sigma, sure=(rough.sure & ~prior.chance) | flat)


def _sources(
    camera: Camera, others: Mapping[str, Camera], points: Float64s, min_angle_deg: float, max_angle_deg: float
) -> list[str]:
    """Views that see points (n, 3) of this view's surface at angles within the limits, smallest first; wider ones if too few."""
    angles = []
    for name, other in others.items():
        if other.component == camera.component:
            angles.append((float(np.degrees(np.median(ray_angles(camera.C - points, other.C - points)))), name))
    inside = [name for angle, name in sorted(angles) if min_angle_deg <= angle <= max_angle_deg]
    outside = [name for angle, name in sorted(angles) if max(min_angle_deg, max_angle_deg) < angle <= _WIDE_DEG]
    return inside + outside[: max(0, _FEWEST - len(inside))]


def _fineness(camera: Camera, other: Camera, points: Float64s, z: Float64s) -> float:
    """How many times finer another camera sees points (n, 3) of the surface than this one does, at depths z (n,)."""
    other_z = project(other, points)[1]
    visible = other_z > 0
    return float(np.median(z[visible] / other_z[visible]) * other.K[0, 0] / camera.K[0, 0]) if visible.any() else 1.0


def _reduced(image: Uint8s, camera: Camera, fineness: float) -> tuple[Uint8s, Camera]:
    """A picture (h, w, 3) and its camera, reduced by its fineness if it sees the surface much finer."""
    if fineness <= _MOST_FINENESS:
        return image, camera
    width, height = (max(8, round(side / fineness)) for side in (camera.width, camera.height))
    K = scaled_intrinsics(camera.K, width / camera.width, height / camera.height)
    small = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return small, replace(camera, K=K, width=width, height=height)


def _pixels_per_inverse_depth(M: Float64s, b: Float64s, q: Float32s) -> np.float32:
    """Median motion of a pixel per unit of inverse depth, over the sources and a few pixels."""
    y, x = np.nonzero(np.isfinite(q[::16, ::16]))
    p = np.stack([16.0 * x, 16.0 * y, np.ones(len(x))])
    projected = M @ p + b[:, :, None] * q[::16, ::16][y, x]
    motion = (b[:, :2, None] - projected[:, :2] / projected[:, 2:] * b[:, 2:, None]) / projected[:, 2:]
    return np.float32(np.median(np.linalg.norm(motion, axis=1)))


def _stack(images: list[Float32s]) -> Float32s:
    """(s, h, w); smaller images are padded with their edge values, which correlate with nothing."""
    h, w = max(image.shape[0] for image in images), max(image.shape[1] for image in images)
    return np.stack([np.pad(image, ((0, h - image.shape[0]), (0, w - image.shape[1])), mode="edge") for image in images])


def _patch_offsets(radius: int) -> Int32s:
    """(n, 2) offsets (x, y) of every second pixel of a square patch, like the black fields of a chessboard; the centre first."""
    span = range(-radius, radius + 1)
    offsets = sorted(((i, j) for j in span for i in span if (i + j) % 2 == 0), key=lambda at: at != (0, 0))
    return np.array(offsets, np.int32)

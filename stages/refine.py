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

from .contracts.defaults import NOISE_PX, VIEW_ANGLE_DEG
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

_FEWEST = 2
"""If fewer views than this see the scene from within the angle limits, wider ones are added."""

_WIDE_DEG = 80.0
"""Largest angle to this view, in degrees, of views that are added because there are too few."""

_MOST_FINENESS = 2.0
"""Views that see the surface finer than this view by more than this factor are reduced to its resolution."""

_SAME_SIGMAS = 3.0
"""Two depths count as equal if they differ by at most this many sigmas, plus `_SAME_SHARE`."""

_SAME_SHARE = 0.002
"""Share of the depth by which two equal depths may differ beyond `_SAME_SIGMAS`: calibration errors do not show in sigma."""

_STEP = 8
"""Every how many pixels, in both directions, the surface is sampled to choose views."""


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
    min_angle_deg: float = VIEW_ANGLE_DEG,
    max_angle_deg: float = 65.0,
    max_cost: float = 0.4,
    noise_px: float = NOISE_PX,
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
    frame = undistorted_frame(frame, camera)
    frames = undistorted_frames(frames, cameras)
    others = {name: cameras[name] for name in frames if name in cameras}

    # 1. Choose the views that see this view's surface at useful angles.
    sampled_depth = depth.depth[::_STEP, ::_STEP]
    y, x = np.nonzero(np.isfinite(sampled_depth))
    z = sampled_depth[y, x].astype(np.float64)
    surface = backproject(camera, np.column_stack([float(_STEP) * x, float(_STEP) * y]), z)
    names = _sources(camera, others, surface, min_angle_deg, max_angle_deg)
    names = names[: min(max_sources, MOST_PARTNERS)]
    if not names:
        return Rejected(Reason.NO_USEFUL_ANGLE, {"views": len(frames)})

    # 2. Collect what the search starts from where tonight's pairs have no depth.
    if not _is_unmoved(camera, reference_camera, depth, reference_depth):
        reference_depth = None
    transferred = transferred_planes(camera, others, depths or {})

    # 3. Search; pictures that show the surface much finer are reduced first.
    views: dict[str, tuple[Uint8s, Camera]] = {}
    for name in names:
        fineness = _fineness(camera, others[name], surface, z)
        views[name] = _reduced(frames[name].image, others[name], fineness)
    return _refined(frame, camera, depth, reference_depth, transferred, views, radius, sweeps, max_cost, noise_px)


def _refined(
    frame: Frame,
    camera: Camera,
    depth: DepthMap,
    reference: DepthMap | None,
    transferred: Float32s,
    views: Mapping[str, tuple[Uint8s, Camera]],
    radius: int,
    sweeps: int,
    max_cost: float,
    noise_px: float,
) -> DepthMap:
    """Depth from all of these views at once, started from tonight's depth, else the reference's, else other views'."""
    # 1. The views, and how a pixel moves in each with its inverse depth.
    image = luminance(frame.image)
    sources = _stack([luminance(picture) for picture, _ in views.values()])
    transfers = [transfer(camera, other) for _, other in views.values()]
    M = np.stack([matrix for matrix, _ in transfers])
    b = np.stack([shift for _, shift in transfers])
    spacing = max(1, round(max(image.shape) / 768))
    ring_px = max(2, round(5 * max(image.shape) / 768))
    propagation = Propagation(image, frame.mask, sources, M, b, spacing * _patch_offsets(radius))

    # 2. The first planes, and the range of inverse depths that they cover, but for outliers.
    planes = _planes_of(depth)
    if reference is not None:
        planes = np.where(np.isfinite(planes[0]), planes, _planes_of(reference))
    planes = with_transferred(planes, transferred, propagation, max_cost)
    nearest, farthest = np.percentile(planes[0][np.isfinite(planes[0])], [99.8, 0.2])

    # 3. Improve them; move them to the best fit; smooth them; restore the detail that smoothing has cost.
    cost = propagation.improve(planes, sweeps, ring_px, 0.9 * farthest, 1.1 * nearest, nearly_right=reference is not None)
    scale = _pixels_per_inverse_depth(M, b, planes[0])
    propagation.refine_photometrically(planes, radius)
    planes[0] = smoothed(image, scale * planes, cost, max_cost, spacing)[0] / scale
    propagation.refine_photometrically(planes, radius)

    # 4. Depth and sigma: a match error of noise_px in each source that sees the plane, and the relative floor of the noise model.
    #    The pixels that a point moves per unit of inverse depth q add up as information on q, and dz = z^2 dq.
    support = propagation.support(planes, max_cost)
    accepted = frame.mask & (support.first < max_cost)
    depth64 = 1.0 / np.where(accepted, planes[0], np.float32(np.nan)).astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = depth64 * np.sqrt((noise_px * depth64) ** 2 / support.parallax + NoiseModel.floor**2)
    z = depth64.astype(np.float32)
    sigma = error.astype(np.float32)

    # 5. A depth is sure if something else confirms it: the pairs, a second source, a very good fit, or the reference.
    sure = _agrees_with(z, sigma, depth) | (support.second < _SURE_SECOND_COST) | (support.first < _SURE_FIRST_COST)
    if reference is not None:
        sure |= (support.second < max_cost) & reference.sure & _agrees_with(z, sigma, reference)
    rough = DepthMap(z, sigma, planes[1], planes[2], support.sources, tuple(views), accepted & sure)

    # 6. Even surfaces get planes over many pixels; this changes `planes` and the sources of `support`, which `rough` shares.
    prior = apply_plane_priors(frame, propagation, planes, support, rough.sure, scale, max_cost)
    return _flattened(rough, planes[0], prior)


def _planes_of(depth: DepthMap) -> Float32s:
    """(3, h, w): inverse depth, and how it changes per pixel in x and y; nan where unknown."""
    return np.stack([1.0 / depth.depth, depth.slope_x, depth.slope_y])


def _is_unmoved(camera: Camera, reference: Camera | None, depth: DepthMap, reference_depth: DepthMap | None) -> bool:
    """Has the camera not moved since the reference, so that each pixel shows the same place?"""
    if reference is None or reference_depth is None or depth.depth.shape != reference_depth.depth.shape:
        return False
    return (
        np.array_equal(camera.K, reference.K) and np.array_equal(camera.R, reference.R) and np.array_equal(camera.C, reference.C)
    )


def _agrees_with(z: Float32s, sigma: Float32s, other: DepthMap) -> Bools:
    """(h, w) bool: the depth equals that of another map: the pairs', cross-checked between two views, or the reference's."""
    return np.asarray(np.abs(other.depth - z) <= _SAME_SIGMAS * sigma + _SAME_SHARE * z)


def _flattened(rough: DepthMap, q: Float32s, prior: PlanePriors) -> DepthMap:
    """Depth with even surfaces on their planes, and without depths found by chance.  q: (h, w) inverse depths."""
    flat = np.isfinite(prior.sigma)
    nan = np.float32(np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):  # q is zero or nan where there is no plane
        z = np.where(flat, 1.0 / q, np.where(prior.chance, nan, rough.depth))
    plane_sigma = z * np.hypot(z * prior.sigma, np.float32(NoiseModel.floor))
    sigma = np.where(flat, plane_sigma, np.where(prior.chance, nan, rough.sigma))
    sure = (rough.sure & ~prior.chance) | flat
    return replace(rough, depth=z, sigma=sigma, sure=sure)


def _sources(
    camera: Camera, others: Mapping[str, Camera], points: Float64s, min_angle_deg: float, max_angle_deg: float
) -> list[str]:
    """Views that see points (n, 3) of this view's surface at angles within the limits, smallest first; wider ones if too few."""
    angles = []
    for name, other in others.items():
        if other.component == camera.component:
            median_angle = np.median(ray_angles(camera.C - points, other.C - points))
            angles.append((float(np.degrees(median_angle)), name))
    inside = []
    outside = []
    for angle, name in sorted(angles):
        if min_angle_deg <= angle <= max_angle_deg:
            inside.append(name)
        elif max(min_angle_deg, max_angle_deg) < angle <= _WIDE_DEG:
            outside.append(name)
    return inside + outside[: max(0, _FEWEST - len(inside))]


def _fineness(camera: Camera, other: Camera, points: Float64s, z: Float64s) -> float:
    """How many times finer another camera sees points (n, 3) of the surface than this one does, at depths z (n,)."""
    other_z = project(other, points)[1]
    visible = other_z > 0
    if not visible.any():
        return 1.0
    nearness = np.median(z[visible] / other_z[visible])
    return float(nearness * other.K[0, 0] / camera.K[0, 0])


def _reduced(image: Uint8s, camera: Camera, fineness: float) -> tuple[Uint8s, Camera]:
    """A picture (h, w, 3) and its camera, reduced by its fineness if it sees the surface much finer."""
    if fineness <= _MOST_FINENESS:
        return image, camera
    width = max(8, round(camera.width / fineness))
    height = max(8, round(camera.height / fineness))
    K = scaled_intrinsics(camera.K, width / camera.width, height / camera.height)
    small = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return small, replace(camera, K=K, width=width, height=height)


def _pixels_per_inverse_depth(M: Float64s, b: Float64s, q: Float32s) -> np.float32:
    """Median motion of a pixel per unit of inverse depth, over the sources and a few pixels."""
    y, x = np.nonzero(np.isfinite(q[::16, ::16]))
    p = np.stack([16.0 * x, 16.0 * y, np.ones(len(x))])
    projected = M @ p + b[:, :, None] * q[::16, ::16][y, x]  # (sources, 3, n)
    # derivative of projected[:2] / projected[2] in q, by the quotient rule
    motion = (b[:, :2, None] - projected[:, :2] / projected[:, 2:] * b[:, 2:, None]) / projected[:, 2:]
    return np.float32(np.median(np.linalg.norm(motion, axis=1)))


def _stack(images: list[Float32s]) -> Float32s:
    """(s, h, w); smaller images are padded with their edge values, which correlate with nothing."""
    h = max(image.shape[0] for image in images)
    w = max(image.shape[1] for image in images)
    padded = []
    for image in images:
        missing_rows = h - image.shape[0]
        missing_columns = w - image.shape[1]
        padded.append(np.pad(image, ((0, missing_rows), (0, missing_columns)), mode="edge"))
    return np.stack(padded)


def _patch_offsets(radius: int) -> Int32s:
    """(n, 2) offsets (x, y) of every second pixel of a square patch, like the black fields of a chessboard; the centre first."""
    span = range(-radius, radius + 1)
    black_fields = [(i, j) for j in span for i in span if (i + j) % 2 == 0]
    centre_first = sorted(black_fields, key=lambda at: at != (0, 0))
    return np.array(centre_first, np.int32)

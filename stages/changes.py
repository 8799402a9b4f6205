"""What changed since the reference was pinned: new, vanished and moved things, from tonight's surface and the reference's.

Three kinds of evidence are combined (`change.evidence`): distances between the clouds along their normals, with their standard
deviations (M3C2); free space, where cameras of one night saw through points of the other; and the photographs: the cameras are
fixed, so a place that looks the same has not changed.  Connected points that indicate a change become clusters with place,
size and volume (`change.clusters`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np

from .change.cloud_distance import spacing_of
from .change.clusters import ChangeCluster, GroundPoints, find_clusters, paired, points_over_ground
from .change.evidence import Epoch, Evidence, compare_nights, mark_changed, noise_of, seen_by
from .change.volumes import detection_of, is_large_for, volumes
from .contracts.ground_figures import UsedIds
from .core.cameras import camera_id, project
from .core.ground_grid import grid_over, ground_axes, inside_polygon, preferred_above, quantile_by_cell
from .core.residual_distortion import undistorted_frames
from .types import (
    NEW,
    SAME,
    UNKNOWN,
    VANISHED,
    Camera,
    Changes,
    Cloud,
    DepthMap,
    Float32s,
    Float64s,
    Frame,
    GroundGrid,
    Poses,
    Scene,
    Uint8s,
)

_TOP_QUANTILE = 0.9
"""Quantile of the heights in a cell that counts as the height of its surface."""
_LEAST_AREA = 300.0
"""Smallest surface area of a change in squared point spacings, unless `least_area_m2` states one."""
_MOST_DISPLACEMENT = 0.01
"""Largest median displacement of the cameras, as a share of the site's size, at which two nights share a world."""
_CELL = 2.0
"""Smallest edge of a cell, in point spacings, unless `cell_m` states one."""
_STEP = 8
"""Step through the points from which the extent of the ground is found."""
_LEAST_SEEN_SHARE = 0.2
"""A camera sees a change if it sees at least this share of the change's points."""
_CROP_PX = 240
"""Height of the pictures of a change, pixels."""
_CROP_GAP_PX = 4
"""Width of the white gap between both nights' pictures, pixels."""


def find_changes(
    poses: Poses,
    cloud: Cloud,
    frames: Mapping[str, Frame],
    depths: Mapping[str, DepthMap],
    refined: Mapping[str, DepthMap] | None = None,
    reference_poses: Poses | None = None,
    reference_cloud: Cloud | None = None,
    reference_frames: Mapping[str, Frame] | None = None,
    reference_depths: Mapping[str, DepthMap] | None = None,
    reference_refined: Mapping[str, DepthMap] | None = None,
    scene: Scene | None = None,
    previous: Changes | None = None,
    used_ids: UsedIds | None = None,
    *,
    zones: list[dict[str, Any]] | None = None,
    sigmas: float = 3.0,
    registration_m: float = 0.0,
    similar: float = 0.6,
    least_area_m2: float | None = None,
    cell_m: float | None = None,
) -> Changes:
    """Compare tonight with the reference.

    Parameters
    ----------
    poses, cloud, frames, depths, refined : tonight's results; only cameras of the main component are used.
    reference_poses, reference_cloud, reference_frames, reference_depths, reference_refined : the reference's results; None, or
        empty: there is nothing to compare with.
    scene : the ground plane, if it is known.
    previous : the result of the newest earlier night that was compared with the same reference; None if there is none.
    used_ids : ids that other nights gave, and that are not given again; None for none.
    zones : only changes whose centre lies in one of these zones count; each is a mapping of name, polygon (corners x, y on the
        ground) and least_m (smallest length or height of a change that counts, metres).
    sigmas : a surface has changed if its distance exceeds this many standard deviations.
    registration_m : standard deviation in metres between tonight's world and the reference's; nearly 0 for fixed cameras.
    similar : places where the photographs of both nights correlate better than this have not changed, 0 to 1.
    least_area_m2 : surface area of the smallest reported change, square metres; None: the area that about 300 points of the
        cloud cover.
    cell_m : edge of the ground's cells in metres; None: twice the point spacing, rounded up to 1, 2 or 5 times a power of ten.
    """
    # Nights can only be compared in one world, and where both have a surface.
    cameras = poses.main_cameras()
    axes = ground_axes(cameras.values(), scene.ground if scene is not None else None)
    if reference_poses is None or reference_cloud is None or not len(reference_cloud.points) or not len(cloud.points):
        return _no_changes(axes, poses)
    old_cameras = reference_poses.main_cameras()
    if not _same_world(cameras, old_cameras, cloud):
        return _no_changes(axes, poses)
    tonight = Epoch(cloud, cameras, undistorted_frames(frames, cameras), depths, refined or {})
    old_frames = undistorted_frames(reference_frames or {}, old_cameras)
    pinned = Epoch(reference_cloud, old_cameras, old_frames, reference_depths or {}, reference_refined or {})
    spacing = max(spacing_of(tonight.points), spacing_of(pinned.points))
    # The grid holds both clouds, so that cells of both nights are the same.
    sample = np.vstack([tonight.points[::_STEP], pinned.points[::_STEP]])
    grid = grid_over(sample, axes, cell_m or preferred_above(_CELL * spacing))
    least_area = _LEAST_AREA * spacing**2 if least_area_m2 is None else least_area_m2
    limits = _Limits(spacing, sigmas, registration_m, similar, least_area, zones or [])
    given = max(previous.highest_id if previous is not None else 0, used_ids.highest if used_ids is not None else 0)
    found = _compared(tonight, pinned, grid, limits, given)
    return replace(found, metric=poses.metric, crs=poses.crs)


@dataclass(frozen=True)
class _Limits:
    """What counts as a change: see the parameters of `find_changes`."""

    spacing: float
    """Of the points of the coarser cloud, world units."""
    sigmas: float
    registration: float
    similar: float
    least_area: float
    zones: list[dict[str, Any]]


def _compared(tonight: Epoch, pinned: Epoch, grid: GroundGrid, limits: _Limits, given: int) -> Changes:
    """The changes between two nights in one world; given: number of the highest id that other nights gave."""
    # 1. Which points of each night have changed?
    measured_new, measured_old = compare_nights(tonight, pinned, limits.spacing, limits.registration)
    noise = noise_of(measured_new, measured_old)

    def side(measured: Evidence, own: Epoch, other: Epoch) -> _Side:
        evidence = mark_changed(measured, own, other, limits.spacing, noise=noise, sigmas=limits.sigmas, similar=limits.similar)
        return _Side(own, evidence, own.cloud.colors[evidence.rows], points_over_ground(grid, own.points))

    new = side(measured_new, tonight, pinned)
    old = side(measured_old, pinned, tonight)

    # 2. Clusters of these; a new one and a vanished one that are similar are a thing that was moved.
    clusters = [
        *_clusters_on(new, old, grid, limits, vanished=False),
        *_clusters_on(old, new, grid, limits, vanished=True),
    ]
    confirmed = [cluster for cluster in clusters if cluster.confirmed]
    pairs = sorted(paired(confirmed), key=lambda pair: -pair[0].change.volume)

    # 3. Volumes of the ground: all changes count, in zones or not, and unconfirmed ones as uncertainty.
    height_tonight = _surface_heights(grid, new.ground)
    height_before = _surface_heights(grid, old.ground)
    detection = detection_of(
        new.evidence,
        old.evidence,
        sigmas=limits.sigmas,
        registration=limits.registration,
        least_area=limits.least_area,
    )
    counted = []
    for cluster, source in pairs:
        counted.append(cluster)
        if source is not None:
            counted.append(source)
    counted += [cluster for cluster in clusters if not cluster.confirmed]
    total, by_zone = volumes(grid, (height_tonight, height_before), counted, limits.zones, detection)

    # 4. Changes that a zone counts are reported.
    reported = []
    for cluster, source in pairs:
        labelled = _in_zone(cluster, limits.zones, grid.axes)
        if labelled is not None:
            reported.append((labelled, source))
    found = _assembled(grid, height_tonight - height_before, (new, old), reported, given)
    return replace(found, cut_fill=total, zones=by_zone, noise=noise)


def _clusters_on(own: _Side, other: _Side, grid: GroundGrid, limits: _Limits, *, vanished: bool) -> list[ChangeCluster]:
    """The changes that the changed points of one night form."""
    return find_clusters(
        own.evidence,
        own.colors,
        grid,
        other.ground,
        vanished=vanished,
        spacing=limits.spacing,
        least_area=limits.least_area,
        similar=limits.similar,
    )


class _Side(NamedTuple):
    """A night, compared with the other one."""

    night: Epoch
    evidence: Evidence
    colors: Uint8s
    """(n, 3) colours of the evidence's points."""
    ground: GroundPoints


def _same_world(cameras: Mapping[str, Camera], old_cameras: Mapping[str, Camera], cloud: Cloud) -> bool:
    """Are most cameras at their old positions?  Otherwise tonight's world was solved anew, and is another one."""
    displacements = []
    for name in cameras:
        if name in old_cameras:
            displacements.append(float(np.linalg.norm(cameras[name].C - old_cameras[name].C)))
    if not displacements:
        return False
    low_and_high = np.quantile(cloud.points.astype(np.float64), [0.05, 0.95], axis=0)  # without the outermost points
    extent = float(np.linalg.norm(np.ptp(low_and_high, axis=0)))
    return float(np.median(displacements)) <= _MOST_DISPLACEMENT * extent


def _in_zone(cluster: ChangeCluster, zones: list[dict[str, Any]], axes: Float64s) -> ChangeCluster | None:
    """The change, labelled with the zone that contains it; None if no zone counts it."""
    if not zones:
        return cluster
    # The first zone that contains its place and counts a change of its size.
    change = cluster.change
    x, y = axes[:2] @ (change.x, change.y, change.z)
    for zone in zones:
        if inside_polygon(zone["polygon"], x, y) and is_large_for(cluster, zone):
            return replace(cluster, change=replace(change, zone=str(zone.get("name", ""))))
    return None


def _assembled(
    grid: GroundGrid,
    difference: Float32s,
    sides: tuple[_Side, _Side],
    clusters: list[tuple[ChangeCluster, ChangeCluster | None]],
    given: int,
) -> Changes:
    """`Changes` with tonight's points and the reference's vanished or unknown ones; clusters: each with its origin, if moved."""
    new = sides[0].evidence
    old = sides[1].evidence
    # Number in the id of the change that each point of a night belongs to, 0 for none.
    new_blob = np.zeros(len(new.core), np.uint16)
    old_blob = np.zeros(len(old.core), np.uint16)
    changes = {}
    crops = {}
    for number, (cluster, source) in enumerate(clusters, given + 1):
        for part in (cluster, source):
            if part is not None:
                blob = old_blob if part.vanished else new_blob
                blob[part.rows] = number
        # Cameras that see it are those of the night in which it was there.
        side = sides[1] if cluster.vanished else sides[0]
        names = _seeing_cameras(side, cluster)
        camera_ids = dict.fromkeys(camera_id(name, side.night.cameras[name]) for name in names)
        name = f"C{number}"
        changes[name] = replace(cluster.change, id=name, cameras=",".join(camera_ids))
        if names:
            crops[name] = _crop(side.evidence.core[cluster.rows], names[0], sides)
    appeared = new_blob > 0
    vanished = old_blob > 0
    shown = vanished | (old.unknown & ~old.changed)
    new_label = np.where(appeared, NEW, np.where(new.unknown, UNKNOWN, SAME))
    old_label = np.where(vanished, VANISHED, UNKNOWN)
    # Shares are of tonight's known surface and what has vanished from it.
    n_changed = int(appeared.sum() + vanished.sum())
    n_known = int((~new.unknown).sum() + vanished.sum())

    def joined(of_new: Any, of_old: Any, kind: type[np.generic]) -> np.ndarray:
        """Values (n, ...) of tonight's points, then of those of the reference that are shown."""
        return np.concatenate([of_new, of_old[shown]]).astype(kind)

    return Changes(
        True,
        changes,
        points=joined(new.core, old.core, np.float64),
        colors=joined(sides[0].colors, sides[1].colors, np.uint8),
        distance=joined(new.distance, old.distance, np.float32),
        sigma=joined(new.sigma, old.sigma, np.float32),
        significance=joined(new.significance, old.significance, np.float32),
        label=joined(new_label, old_label, np.uint8),
        blob=joined(new_blob, old_blob, np.uint16),
        grid=grid,
        difference=difference,
        crops=crops,
        highest_id=given + len(clusters),
        count=len(changes),
        changed_share=n_changed / max(1, n_known),
        unknown_share=float(np.mean(old.unknown)),
    )


def _seeing_cameras(side: _Side, cluster: ChangeCluster) -> list[str]:
    """The cameras that see a change, the one that shows it largest first."""
    night = side.night
    X = side.evidence.core[cluster.rows]
    sigma = night.sigma[side.evidence.rows[cluster.rows]]
    candidates = []
    for name in night.seeing:
        visible = seen_by(X, sigma, night, name)
        if visible.mean() >= _LEAST_SEEN_SHARE:
            x, _ = project(night.cameras[name], X[visible])
            # Size of its box in the image, less where parts are hidden; negative, so that the largest is first.
            box_px = float(np.prod(np.ptp(x, axis=0) + 1))
            candidates.append((-box_px * float(visible.mean()), name))
    return [name for _, name in sorted(candidates)]


def _crop(X: Float64s, name: str, sides: tuple[_Side, _Side]) -> Uint8s:
    """(h, w, 3) the surroundings of points X in one camera, side by side: the reference's frame, then tonight's."""
    parts: list[Uint8s] = []
    gap = np.full((_CROP_PX, _CROP_GAP_PX, 3), 255, np.uint8)
    for side in reversed(sides):
        night = side.night
        if name not in night.frames or name not in night.cameras:
            continue
        image = night.frames[name].image
        x, _ = project(night.cameras[name], X)
        # The box of most points, with a margin, and at least a pixel of the image.
        low, high = np.quantile(x, [0.02, 0.98], axis=0)
        margin = 0.35 * (high - low) + 8
        size = np.array([image.shape[1], image.shape[0]])
        left, top = np.clip(low - margin, 0, size - 2).astype(int)
        right, bottom = np.clip(high + margin, 2, size).astype(int)
        part = image[top : max(bottom, top + 1), left : max(right, left + 1)]
        width = int(np.clip(round(part.shape[1] * _CROP_PX / part.shape[0]), 1, 4 * _CROP_PX))
        if parts:
            parts.append(gap)
        parts.append(np.asarray(cv2.resize(part, (width, _CROP_PX), interpolation=cv2.INTER_AREA), dtype=np.uint8))
    if not parts:
        return np.zeros((1, 1, 3), np.uint8)
    return np.hstack(parts)


def _surface_heights(grid: GroundGrid, night: GroundPoints) -> Float32s:
    """(rows, columns) heights of a night's surface; nan where unknown."""
    heights = quantile_by_cell(night.cells, night.levels, grid.rows * grid.columns, _TOP_QUANTILE)
    return heights.reshape(grid.rows, grid.columns).astype(np.float32)


def _no_changes(axes: Float64s, poses: Poses) -> Changes:
    """The result if there is nothing to compare with: no points, and a grid without cells."""
    no_values = np.zeros(0, np.float32)
    return Changes(
        False,
        {},
        points=np.zeros((0, 3)),
        colors=np.zeros((0, 3), np.uint8),
        distance=no_values,
        sigma=no_values,
        significance=no_values,
        label=np.zeros(0, np.uint8),
        blob=np.zeros(0, np.uint16),
        grid=GroundGrid(axes, 0.0, 0.0, 1.0, 0, 0),
        difference=np.zeros((0, 0), np.float32),
        metric=poses.metric,
        crs=poses.crs,
    )

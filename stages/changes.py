"""What changed since the reference was pinned: new, vanished and moved things, from tonight's surface and the reference's.

Three kinds of evidence are combined (`change.evidence`): distances between the clouds along their normals, with their standard
deviations (M3C2); free space, where cameras of one night saw through points of the other; and the photographs: the cameras are
fixed, so a place that looks the same has not changed.  Connected points that indicate a change become clusters with place,
size and volume (`change.clusters`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from .change.cloud_distance import spacing_of
from .change.clusters import ChangeCluster, Side, find_clusters
from .change.evidence import Epoch, Evidence, compare_nights, mark_changed, noise_of, seen_by
from .change.ground_points import TOP_QUANTILE, GroundPoints, points_over_ground
from .change.standing import Standing, doubts, known_standing, with_hulls, with_ids
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
    Change,
    Changes,
    Cloud,
    DepthMap,
    Float32s,
    Float64s,
    Frame,
    GroundGrid,
    KnownPlace,
    Poses,
    Scene,
    Uint8s,
)

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
    known = _known_of(previous, used_ids)
    cameras = poses.main_cameras()
    plane = scene.ground if scene is not None else None
    if reference_poses is None or reference_cloud is None or not len(reference_cloud.points) or not len(cloud.points):
        return _no_changes(ground_axes(cameras.values(), plane), poses, known)
    old_cameras = reference_poses.main_cameras()
    axes = ground_axes(old_cameras.values(), plane)  # those of the reference: they are the same every night
    if not _same_world(cameras, old_cameras, cloud):
        return _no_changes(axes, poses, known)
    tonight = Epoch(cloud, cameras, undistorted_frames(frames, cameras), depths, refined or {})
    old_frames = undistorted_frames(reference_frames or {}, old_cameras)
    pinned = Epoch(reference_cloud, old_cameras, old_frames, reference_depths or {}, reference_refined or {})
    spacing = max(spacing_of(tonight.points), spacing_of(pinned.points))
    # The grid holds both clouds, so that cells of both nights are the same.
    sample = np.vstack([tonight.points[::_STEP], pinned.points[::_STEP]])
    grid = grid_over(sample, axes, cell_m or preferred_above(_CELL * spacing))
    least_area = _LEAST_AREA * spacing**2 if least_area_m2 is None else least_area_m2
    limits = _Limits(spacing, sigmas, registration_m, similar, least_area, zones or [])
    found = _compared(tonight, pinned, grid, limits, known)
    return replace(found, metric=poses.metric, crs=poses.crs)


@dataclass(frozen=True)
class _Known:
    """What earlier nights know."""

    places: tuple[KnownPlace, ...]
    highest_id: int
    """Number of the highest id that they gave."""


def _known_of(previous: Changes | None, used_ids: UsedIds | None) -> _Known:
    """What earlier nights know; parameters as for `find_changes`."""
    used = 0 if used_ids is None else used_ids.highest
    if previous is None:
        return _Known((), used)
    return _Known(previous.places, max(previous.highest_id, used))


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


def _compared(tonight: Epoch, pinned: Epoch, grid: GroundGrid, limits: _Limits, known: _Known) -> Changes:
    """The changes between two nights in one world."""
    # 1. Which points of each night have changed?
    measured_new, measured_old = compare_nights(tonight, pinned, limits.spacing, limits.registration)
    noise = noise_of(measured_new, measured_old)

    def side(measured: Evidence, own: Epoch, other: Epoch) -> Side:
        evidence = mark_changed(measured, own, other, limits.spacing, noise=noise, sigmas=limits.sigmas, similar=limits.similar)
        return Side(own, evidence, own.cloud.colors[evidence.rows], points_over_ground(grid, own.points))

    new = side(measured_new, tonight, pinned)
    old = side(measured_old, pinned, tonight)

    # 2. Known changes take the points that belong to them; what is left forms new ones.
    standing_new, unconfirmed_new = _standing(known, new, old, tonight, grid, limits, vanished=False)
    standing_old, unconfirmed_old = _standing(known, old, new, tonight, grid, limits, vanished=True)

    # 3. What may be behind the seen surfaces.
    standing_new = with_hulls(standing_new, new, old, grid, spacing=limits.spacing, similar=limits.similar)
    standing_old = with_hulls(standing_old, old, new, grid, spacing=limits.spacing, similar=limits.similar)
    doubts_new = doubts(unconfirmed_new, standing_new, new, old, grid, spacing=limits.spacing, similar=limits.similar)
    doubts_old = doubts(unconfirmed_old, standing_old, old, new, grid, spacing=limits.spacing, similar=limits.similar)

    # 4. Changes of tonight get ids: a new one and a vanished one that are similar are a thing that was moved, and have one.
    standing, highest_id = with_ids([*standing_new, *standing_old], known.highest_id)

    # 5. Volumes of the ground: all changes count, in zones or not, and unconfirmed ones as uncertainty.
    height_tonight = _surface_heights(grid, new.ground)
    height_before = _surface_heights(grid, old.ground)
    detection = detection_of(
        new.evidence,
        old.evidence,
        sigmas=limits.sigmas,
        registration=limits.registration,
        least_area=limits.least_area,
    )
    counted = [each.cluster for each in standing if each.cluster is not None]
    counted += [*doubts_new, *doubts_old]
    total, by_zone = volumes(grid, (height_tonight, height_before), counted, limits.zones, detection)

    # 6. Changes that a zone counts are reported.
    reported = []
    for change, parts in _by_id(standing):
        labelled = _in_zone(change, limits.zones, grid.axes)
        if labelled is not None:
            reported.append((labelled, parts))
    found = _assembled(grid, height_tonight - height_before, (new, old), reported)
    places = tuple(each.place for each in standing)
    return replace(found, cut_fill=total, zones=by_zone, noise=noise, places=places, highest_id=highest_id)


def _standing(
    known: _Known, own: Side, other: Side, tonight: Epoch, grid: GroundGrid, limits: _Limits, *, vanished: bool
) -> tuple[list[Standing], list[ChangeCluster]]:
    """The changes of one kind that stand tonight, new ones without an id, and clusters that are not confirmed."""
    standing, groups = known_standing(
        known.places,
        own,
        other,
        tonight,
        grid,
        spacing=limits.spacing,
        least_area=limits.least_area,
        vanished=vanished,
    )
    clusters = find_clusters(
        own,
        other.ground,
        grid,
        groups,
        vanished=vanished,
        spacing=limits.spacing,
        least_area=limits.least_area,
        similar=limits.similar,
    )
    standing += [Standing("", vanished, cluster, None) for cluster in clusters if cluster.confirmed]
    return standing, [cluster for cluster in clusters if not cluster.confirmed]


def _by_id(standing: list[Standing]) -> list[tuple[Change, list[Standing]]]:
    """The changes with all their places, the largest first: of a moved thing both, where it is now first."""
    parts: dict[str, list[Standing]] = {}
    for each in sorted(standing, key=lambda each: each.vanished):
        parts.setdefault(each.id, []).append(each)
    changes = []
    for places in parts.values():
        change = places[0].change
        if len(places) > 1:
            origin = places[1].change
            change = replace(change, kind="moved", from_x=origin.x, from_y=origin.y, from_z=origin.z)
        changes.append((change, places))
    return sorted(changes, key=lambda entry: -entry[0].volume)


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


def _in_zone(change: Change, zones: list[dict[str, Any]], axes: Float64s) -> Change | None:
    """The change, labelled with the zone that contains it; None if no zone counts it."""
    if not zones:
        return change
    # The first zone that contains its place and counts a change of its size.
    x, y = axes[:2] @ (change.x, change.y, change.z)
    for zone in zones:
        if inside_polygon(zone["polygon"], x, y) and is_large_for(change, zone):
            return replace(change, zone=str(zone.get("name", "")))
    return None


def _assembled(
    grid: GroundGrid, difference: Float32s, sides: tuple[Side, Side], reported: list[tuple[Change, list[Standing]]]
) -> Changes:
    """`Changes` with tonight's points and the reference's vanished or unknown ones; reported: changes, and all their places."""
    new = sides[0].evidence
    old = sides[1].evidence
    # Number in the id of the change that each point of a night belongs to, 0 for none.
    new_blob = np.zeros(len(new.core), np.uint16)
    old_blob = np.zeros(len(old.core), np.uint16)
    changes = {}
    before: dict[str, Uint8s] = {}
    after: dict[str, Uint8s] = {}
    for change, parts in reported:
        for part in parts:
            if part.cluster is not None:
                blob = old_blob if part.vanished else new_blob
                blob[part.cluster.rows] = int(change.id[1:])
        cluster = parts[0].cluster
        changes[change.id] = change
        if cluster is None or not parts[0].seen:
            continue
        # Cameras that see it are those of the night in which it was there.
        side = sides[1] if cluster.vanished else sides[0]
        names = _seeing_cameras(side.night, cluster)
        camera_ids = dict.fromkeys(camera_id(name, side.night.cameras[name]) for name in names)
        changes[change.id] = replace(change, cameras=",".join(camera_ids))
        # The camera may be missing on the other night.
        for pictures, night in ((after, sides[0].night), (before, sides[1].night)):
            if names and names[0] in night.frames and names[0] in night.cameras:
                pictures[change.id] = _crop(cluster.surface.points, names[0], night)
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
        before=before,
        after=after,
        count=len(changes),
        changed_share=n_changed / max(1, n_known),
        unknown_share=float(np.mean(old.unknown)),
    )


def _seeing_cameras(night: Epoch, cluster: ChangeCluster) -> list[str]:
    """The cameras that see a change, the one that shows it largest first."""
    X = cluster.surface.points
    candidates = []
    for name in night.seeing:
        visible = seen_by(X, cluster.surface.sigma, night, name)
        if visible.mean() >= _LEAST_SEEN_SHARE:
            x, _ = project(night.cameras[name], X[visible])
            # Size of its box in the image, less where parts are hidden; negative, so that the largest is first.
            box_px = float(np.prod(np.ptp(x, axis=0) + 1))
            candidates.append((-box_px * float(visible.mean()), name))
    return [name for _, name in sorted(candidates)]


def _crop(X: Float64s, name: str, night: Epoch) -> Uint8s:
    """(h, w, 3) the surroundings of points X in a camera's frame of a night."""
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
    return np.asarray(cv2.resize(part, (width, _CROP_PX), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _surface_heights(grid: GroundGrid, night: GroundPoints) -> Float32s:
    """(rows, columns) heights of a night's surface; nan where unknown."""
    heights = quantile_by_cell(night.cells, night.levels, grid.rows * grid.columns, TOP_QUANTILE)
    return heights.reshape(grid.rows, grid.columns).astype(np.float32)


def _no_changes(axes: Float64s, poses: Poses, known: _Known) -> Changes:
    """The result if there is nothing to compare with: no points, and a grid without cells; what is known stays known."""
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
        places=known.places,
        highest_id=known.highest_id,
        metric=poses.metric,
        crs=poses.crs,
    )

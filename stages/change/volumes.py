"""Cut and fill: volumes gained and lost by changes on parts of the ground, with standard deviations.

Only detected changes count, beyond the level of detection and confirmed by free space and photographs: height differences alone
reach the size of a container at the edges of walls.  Two kinds of error are kept apart, as they add up differently: errors of
single changes, and the height offset between the nights, which all places share and no averaging reduces (Wheaton, Brasington,
Darby, Sear, Accounting for uncertainty in DEMs from repeat topographic surveys, Earth Surf. Process. Landforms 35, 2010).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ..core.ground_grid import cells_inside
from ..types import Bools, Change, CutFill, Float32s, GroundGrid
from .clusters import SURE_SIGMAS, ChangeCluster
from .evidence import Evidence
from .footprint import UNKNOWN_SHARE_SIGMA
from .ground_points import seen_cells


@dataclass(frozen=True)
class Detection:
    """Detection limits of a comparison of two nights."""

    level: float
    """Level of detection, world units: surfaces that are closer to each other count as the same."""
    common_sigma: float
    """Standard deviation of the height offset between the nights."""
    least_area: float
    """Smallest area of a change that is reported."""


def detection_of(tonight: Evidence, reference: Evidence, *, sigmas: float, registration: float, least_area: float) -> Detection:
    """Detection limits of a comparison, from the places that both nights measured.

    Parameters
    ----------
    tonight, reference : the evidence of both nights, with its changes marked.
    sigmas, registration, least_area : as of `changes.find_changes`.
    """
    sigma = np.concatenate([tonight.sigma[tonight.measured], reference.sigma[reference.measured]])
    if not len(sigma):
        return Detection(0.0, float(np.hypot(registration, 0.0)), least_area)
    # Distances are positive towards the cameras on either side, so those of the reference count the other way.
    offset_tonight = tonight.distance[tonight.measured & ~tonight.changed]
    offset_reference = -1.0 * reference.distance[reference.measured & ~reference.changed]
    shift = float(np.median(np.concatenate([offset_tonight, offset_reference])))
    level = sigmas * float(np.median(sigma))
    return Detection(level, float(np.hypot(registration, shift)), least_area)


def is_large_for(change: Change, zone: Mapping[str, Any]) -> bool:
    """Is a change large enough for a zone (`least_m`)?"""
    return max(change.length, change.height) >= float(zone.get("least_m", 0.0))


def volumes(
    grid: GroundGrid,
    tops: Sequence[Float32s],
    clusters: Sequence[ChangeCluster],
    zones: Sequence[Mapping[str, Any]],
    detection: Detection,
) -> tuple[CutFill, dict[str, CutFill]]:
    """Cut and fill of the whole site, or of all zones together if there are any; and of each zone by name.

    Parameters
    ----------
    grid : of the ground.
    tops : (rows, columns) heights of tonight's surface, and of the earlier night's; nan if unknown.
    clusters : the changes in all places, confirmed or not.
    zones : see `find_changes`.
    detection : detection limits of the comparison.
    """
    seen_tonight = seen_cells(tops[0])
    seen_before = seen_cells(tops[1])
    seen = seen_tonight & seen_before
    if not zones:
        everywhere = np.ones(seen.shape, bool)
        unseen = (seen_tonight ^ seen_before).sum() * grid.cell**2
        return _cut_and_fill(grid, everywhere, seen, unseen, clusters, detection), {}

    by_zone = {}
    zone_masks = []
    for zone in zones:
        inside = cells_inside(grid, zone["polygon"])
        large_enough = [cluster for cluster in clusters if is_large_for(cluster.change, zone)]
        unseen = _unseen_area(grid, zone, inside, seen)
        by_zone[str(zone["name"])] = _cut_and_fill(grid, inside, seen, unseen, large_enough, detection)
        zone_masks.append(inside)

    # All zones together: places in several zones count once.
    large_enough = [cluster for cluster in clusters if any(is_large_for(cluster.change, zone) for zone in zones)]
    unseen = sum(part.unseen for part in by_zone.values())
    anywhere = np.any(zone_masks, axis=0)
    return _cut_and_fill(grid, anywhere, seen, unseen, large_enough, detection), by_zone


def _unseen_area(grid: GroundGrid, zone: Mapping[str, Any], inside: Bools, seen: Bools) -> float:
    """Area of a zone, including any part beyond the grid, that was not seen on both nights."""
    corners = np.array(zone["polygon"], np.float32)
    low = (grid.left, grid.top - grid.rows * grid.cell)
    high = (grid.left + grid.columns * grid.cell, grid.top)
    area_outside = 0.0
    if np.any(corners < low) or np.any(corners > high):
        area_outside = cv2.contourArea(corners) - inside.sum() * grid.cell**2
    # Cells only approximate a polygon, so the difference may be slightly negative.
    return max(0.0, area_outside) + float((inside & ~seen).sum() * grid.cell**2)


def _cut_and_fill(
    grid: GroundGrid, inside: Bools, seen: Bools, unseen: float, clusters: Sequence[ChangeCluster], detection: Detection
) -> CutFill:
    """Cut and fill of the cells inside (rows, columns); seen: on both nights; unseen: area that was not."""
    new = [cluster for cluster in clusters if not cluster.vanished]
    vanished = [cluster for cluster in clusters if cluster.vanished]
    gained = _volume(new, inside, grid, detection)
    lost = _volume(vanished, inside, grid, detection)
    area = float((seen & inside).sum() * grid.cell**2)
    return CutFill(
        gained=gained.volume,
        gained_sigma=gained.sigma,
        lost=lost.volume,
        lost_sigma=lost.sigma,
        gained_least=gained.least,
        gained_most=gained.most,
        lost_least=lost.least,
        lost_most=lost.most,
        level=detection.level,
        common_sigma=detection.common_sigma,
        area=area,
        unseen=float(unseen),
    )


@dataclass(frozen=True)
class _Volume:
    """Volume of the parts of changes that lie inside an area, world units cubed."""

    volume: float
    sigma: float
    """Its standard deviation: at least that of the smallest detectable change."""
    least: float
    most: float


def _volume(clusters: Sequence[ChangeCluster], inside: Bools, grid: GroundGrid, detection: Detection) -> _Volume:
    """Volume of the parts of changes that lie inside.

    An unconfirmed change adds no volume, but uncertainty: it may be real, wholly or in part, with all that it may hide, or not.
    The doubts about several have the same causes (few pixels, few cameras, a lamp), so that they add up and do not average out.
    One of which tonight knows nothing adds the volume of earlier nights, and may be gone.
    """
    volume = 0.0
    area = 0.0
    least = 0.0
    most = 0.0
    variance = 0.0
    doubtful = 0.0
    for cluster in clusters:
        # 1. What was seen of it, as far as it lies inside, and the most that it may be with its unseen parts.
        footprint = cluster.footprint
        change = cluster.change
        share = np.where(inside.ravel()[footprint.cells], footprint.share, 0.0)
        part_volume = float((share * footprint.height).sum() * grid.cell**2)
        part = part_volume / max(change.volume, 1e-9)
        unseen_inside = float(cluster.unseen.volume[inside.ravel()[cluster.unseen.cells]].sum())
        part_most = part * (change.volume_most - float(cluster.unseen.volume.sum())) + unseen_inside
        most += part_most
        if not cluster.confirmed:
            doubtful += part_most
            continue
        volume += part_volume
        area += float(share.sum() * grid.cell**2)

        # 2. Its errors, and the least that it must be.
        variance += (change.volume_sigma * part) ** 2
        if cluster.seen:
            least += part * change.volume_least
        else:
            variance += (UNKNOWN_SHARE_SIGMA * part_volume) ** 2

    # Errors of changes are independent; the height offset is the same everywhere, and counts with the whole area.
    common = float(np.hypot(detection.least_area * detection.level, area * detection.common_sigma))
    return _Volume(
        volume=volume,
        sigma=float(np.linalg.norm([np.sqrt(variance), UNKNOWN_SHARE_SIGMA * doubtful, common])),
        least=max(0.0, least - SURE_SIGMAS * common),
        most=most + SURE_SIGMAS * common,
    )
